"""The suite from Python: `import sfr_loc_map as sfr`. Every name stands in `sfr_loc_map` itself as well."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

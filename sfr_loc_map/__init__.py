"""sfr_loc_map: stereo localisation, terrain mapping and the metrics that evaluate them.

From Python: `import sfr_loc_map as sfr`, then `sfr.open`, `sfr.localise`, `sfr.map`, `sfr.score` (docs/python.md).
These names are loaded at their first use, so that the import itself is fast.
"""

import lazy_loader

__version__ = "0.3.0"
__getattr__, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in _names if name not in ("map", "open")]  # `import *` must not replace builtins

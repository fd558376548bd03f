"""A ray-traced, Mars-like world: terrain, light, drive and sensor, with exact ground truth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

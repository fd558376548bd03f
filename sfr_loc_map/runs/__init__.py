"""A localiser or mapper, ours or one under test, over a complete source: its calls, its results and their files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

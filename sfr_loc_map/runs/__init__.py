"""Runs of a localiser or mapper, of the suite or under test, over a complete source, with a record of each call."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

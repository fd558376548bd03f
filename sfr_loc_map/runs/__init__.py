"""Runs of a localiser or mapper, ours or under test, over a whole source, and the record of each call."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Injected faults: what the node processes survive over real DDS, and which rates they carry."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""From files, or from what is in memory or on topics, to the score with its provenance."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Stereo visual localisation: a trajectory from a sequence of stereo pairs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

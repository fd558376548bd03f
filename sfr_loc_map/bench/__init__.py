"""Benchmarks: our methods beside reference methods on the same images, in the same run, each in its own process."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

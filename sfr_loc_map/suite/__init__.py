"""Suites: many sources, configurations and faults, run on Dask, and what follows from them all."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

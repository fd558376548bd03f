"""Many runs on Dask: suites of sources, configurations and faults, their statistics, and searches."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

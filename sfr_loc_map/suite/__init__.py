"""Many runs: suites of sources, configurations and faults on Dask, what follows from them, and two benchmarks.

The benchmarks of methods and of faults run one source again and again, without Dask.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

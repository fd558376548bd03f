"""Injection of faults into the stereo pairs of any source.

A new kind of fault is a member of `FaultKind` (`kinds.py`) and a function in `CHANGES` (`injector.py`). If the
localiser should detect or tolerate the fault, the kind has a row in `FAULTS` (`bench/fault_benchmark.py`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

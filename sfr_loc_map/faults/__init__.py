"""Injection of faults into the stereo pairs of any source.

To add a kind of fault, add a member to `FaultKind` (`kinds.py`) and a function to `CHANGES` (`injector.py`). If the
localiser should detect or tolerate the fault, also add a row to `FAULTS` (`bench/fault_benchmark.py`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Injection of faults into the stereo pairs of any source.

    source.py                a source whose pairs have faults
      injector.py            selects the affected pairs of each fault, and changes them
        kinds.py             one row for each kind of fault, and the text of a fault
          images.py          changes of images and of the right camera
          views.py           changes of the view: occlusions, dirt, shadows
          stamps_and_rig.py  changes of stamps and of the calibration

To add a kind of fault, add a row to `FaultKind` (`kinds.py`) with its function. If the localiser should detect or
tolerate the fault, also add a row to `FAULTS` (`bench/fault_benchmark.py`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

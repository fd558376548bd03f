"""What runs in the process of a method: `loop.py` and one adapter for each way to call a method.

`loop.py`, `c_library.py` and the peers need nothing of this package: they run in the interpreter that has the method.
"""

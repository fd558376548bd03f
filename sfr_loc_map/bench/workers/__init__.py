"""Worker processes of a benchmark, started as scripts by the interpreter that has the method.

`loop.py` feeds a method; every other file is one method with `open_method(setup)`. `reference_*.py` and `loop.py`
import nothing of this package: an interpreter with NumPy, OpenCV and the method is enough.
"""

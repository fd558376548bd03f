"""What runs in the process of a method: `shut_in.py`, `loop.py`, and an adapter for each way to call a method.

`shut_in.py`, `loop.py` and the adapters of peers (`peer_*.py`) import nothing of this package at run time, because they
run in the interpreter that has the method. The other adapters import its geometry.
"""

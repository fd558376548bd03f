"""An adapter for each way to call a method, which `child/loop.py` loads in the process of the method.

The adapters of peers (`peer_*.py`) import nothing of this package at run time, because they run in the interpreter that
has the method. The other adapters import its geometry.
"""

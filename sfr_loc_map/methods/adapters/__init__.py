"""Adapters, one for each kind of interface of a method; `child/loop.py` loads them in the method's process.

The adapters of peers (`peer_*.py`) do not import this package at run time, because they run in the interpreter of the
method. The other adapters import `sfr_loc_map.geometry`.
"""

"""The programs of a method's process: `shut_in.py` restricts the process, `loop.py` calls the method by an adapter.

Both programs import nothing of this package at run time, because they run in the interpreter that has the method.
"""

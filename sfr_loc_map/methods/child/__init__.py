"""Programs of a method's process: `supervisor.py` restricts the process, `loop.py` calls the method through an adapter.

Neither program imports this package at run time, because both run in the interpreter of the method.
"""

"""Time and memory of calls [4.2.1, 4.2.2, 4.3.1, 4.3.2].

`call_meter` measures one call, `calls` holds the calls of a run as columns, and `call_score` scores them.
"""

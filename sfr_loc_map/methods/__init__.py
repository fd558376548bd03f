"""Localisers and mappers under test, each in its own process.

A method under test (in the documentation also: a candidate) is called through this chain:

    runs, bench/trials.py
      isolated_localiser.py, isolated_mapper.py    one call for a pair or a set: checks the values of the answer
        map_arrays.py                              clouds and disparity images in the answer of a mapper
        isolated_method.py                         decides when a process is started, ended, and started again
          method_process.py                        one process, from its start to its end: its calls and its answers
            scratch_folder.py                      shared images, log, arrays of the answers
            supervised_process.py                  the process with its pipes: messages as lines of JSON, with a timeout
            call_monitor.py                        time and memory from outside, leaks, misstated times
            isolation.py                           files and environment variables that the process may use
              own_code.py                          files of the method's own code, and their hash
    ---- process boundary -------------------------------------------------------------------------------------
            child/supervisor.py                    restricts its child (Landlock, seccomp), kills descendants
              child/numba_cache.py                 folders in which the process finds compiled kernels
              child/loop.py                        reads an order, calls the method, writes the reply
                adapters/*.py                      one module for each interface of methods
                  the method

`registry.py` finds a method by its name. `method_call.py` has the request and the record of a call, and the failures.
`config_truth.py` refuses a configuration that contains the ground truth. `point_bounds.py` checks the bounds of points
on both sides of the process boundary. `ours.py` gives our localiser and mapper the interface of a candidate.

Another interface requires a module in `adapters/` with `open_method(setup)`, which returns an object as described in
`child/loop.py`, and a row in `registry.py` (`_BUILT_IN`, or `_PEERS` for a method of another interpreter). A user's own
method requires neither an adapter nor a row: `package.module:Class`, `FILE.py:Class` and `lib:PATH.so` use existing
adapters (docs/candidates.md).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Properties of all child processes of this package: they end with their parent and import the same modules."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Collection

LIBRARY_PATH = "LD_LIBRARY_PATH"  #: Search path of the dynamic linker, which ROS requires.
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
_LIBRARY = ctypes.CDLL(None) if sys.platform.startswith("linux") else None
"""C library, loaded at import because a child must not load a library between fork and exec."""


def end_with_parent(number: signal.Signals, waiting: Collection[signal.Signals] = ()) -> None:
    """Let the kernel send this process a signal when its parent ends (Linux).

    The signals in `waiting` are blocked until the program that is started unblocks them (`nodes.start`).
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, waiting)
    if _LIBRARY is not None:
        _LIBRARY.prctl(_PR_SET_PDEATHSIG, number)


def ending_of(code: int) -> str:
    """Return how a process ended, in words; the exit code -N means that the signal N killed the process."""
    if code >= 0:
        return f"ended with exit code {code}"
    name = next((item.name for item in signal.Signals if item == -code), f"signal {-code}")
    return f"was killed by {name}"


def adopt_descendants() -> None:
    """Let the kernel make this process the parent of descendants whose parent ends (Linux); exec keeps this setting.

    Otherwise a descendant that forks twice leaves the process tree whose memory and time are measured.
    """
    if _LIBRARY is not None:
        _LIBRARY.prctl(_PR_SET_CHILD_SUBREAPER, 1)


def inherited_environment() -> dict[str, str]:
    """Return the environment without the variables that make the dynamic linker load other code (`LD_PRELOAD`)."""
    return {name: value for name, value in os.environ.items() if not name.startswith("LD_") or name == LIBRARY_PATH}


def child_environment() -> dict[str, str]:
    """Return the environment for a process that imports the same modules from any working directory."""
    return inherited_environment() | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}

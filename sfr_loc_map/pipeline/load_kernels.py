"""Loads the kernels of a part; where they are not compiled yet, a process of its own compiles them first.

The compiler takes some 300 MB, and a process does not give them back: in a first run after an installation they would
be scored as memory of the localiser or the mapper. So a compilation that begins here is refused, `compile_kernels`
is run beside, and what it left in the cache is loaded.
"""

from __future__ import annotations

import subprocess
import sys
import threading

from numba.core import event

from sfr_loc_map.child_process import child_environment
from sfr_loc_map.pipeline.compile_kernels import COMPILE, PARTS, Say, announce_compilation

_ONE_AT_A_TIME = threading.Lock()


def say_on_stderr(line: str) -> None:
    """Write a line to standard error."""
    print(line, file=sys.stderr, flush=True)


def load_kernels(part: str, say: Say = say_on_stderr) -> None:
    """Load all kernels of a part, so that no later call pays for it.

    Args:
        part: One of `compile_kernels.PARTS`.
        say: Called with each line of progress where kernels are compiled.
    """
    with _ONE_AT_A_TIME:  # the listeners hear all threads
        try:
            with event.install_listener(COMPILE, _Refusal()):
                PARTS[part]()
        except _NotCompiledError:
            _compile_beside(part, say)
            with announce_compilation(say):  # of what could not be kept: the cache may be read-only
                PARTS[part]()


class _NotCompiledError(Exception):
    """A kernel is not in the cache."""


class _Refusal(event.Listener):
    """Ends each compilation before it begins."""

    def on_start(self, event: event.Event) -> None:
        raise _NotCompiledError

    def on_end(self, event: event.Event) -> None:
        pass


def _compile_beside(part: str, say: Say) -> None:
    """Compile in a process that ends with this one; pass on what it says."""
    command = [sys.executable, "-P", "-m", "sfr_loc_map.pipeline.compile_kernels", part]
    environment = child_environment()
    with subprocess.Popen(
        command, env=environment, text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
    ) as child:
        for line in child.stdout or ():
            say(line.rstrip())
    if child.returncode != 0:
        say(f"the process that compiles ended with exit code {child.returncode}: the kernels are compiled here")

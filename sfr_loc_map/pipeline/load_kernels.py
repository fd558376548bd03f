"""Loads the kernels of a part; where they are not compiled yet, a process of its own compiles them first.

The compiler takes some 300 MB, and a process does not give them back: in a first run after an installation they would
be scored as memory of the localiser or the mapper. So a compilation that begins here is refused, `compile_kernels`
is run beside, and what it left in the cache is loaded.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable

from numba.core import event

from sfr_loc_map.child_process import child_environment
from sfr_loc_map.pipeline.compile_kernels import COMPILE, PARTS, Say, announce_compilation

_ONE_AT_A_TIME = threading.Lock()
POLL_S = 0.1
SIGNAL_S = 1.0
"""How long after a signal has ended the compiling process this one may still learn of it."""


def say_on_stderr(line: str) -> None:
    """Write a line to standard error."""
    print(line, file=sys.stderr, flush=True)


def _always() -> bool:
    return True


def load_kernels(part: str, say: Say = say_on_stderr, is_wanted: Callable[[], bool] = _always) -> None:
    """Load all kernels of a part, so that no later call pays for it.

    Args:
        part: One of `compile_kernels.PARTS`.
        say: Called with each line of progress where kernels are compiled.
        is_wanted: Becomes false where the program is to end and no exception says so, as in a ROS node.

    Raises:
        KeyboardInterrupt: If kernels had to be compiled, and are wanted no more.
    """
    with _ONE_AT_A_TIME:  # the listeners hear all threads
        with event.install_listener(COMPILE, _Refusal()):
            try:
                PARTS[part]()
                return
            except _NotCompiledError:  # refused all the while: other threads of the part have not ended yet
                _compile_beside(part, say, is_wanted)
        guard = event.install_listener(COMPILE, _EndWhenUnwanted(is_wanted))
        with guard, announce_compilation(say):  # of what could not be kept: the cache may be read-only
            PARTS[part]()


class _NotCompiledError(Exception):
    """A kernel is not in the cache."""


class _Refusal(event.Listener):
    """Ends each compilation before it begins."""

    def on_start(self, event: event.Event) -> None:
        raise _NotCompiledError

    def on_end(self, event: event.Event) -> None:
        pass


class _EndWhenUnwanted(event.Listener):
    """Ends a compilation that nobody waits for any more."""

    def __init__(self, is_wanted: Callable[[], bool]) -> None:
        self._is_wanted = is_wanted

    def on_start(self, event: event.Event) -> None:
        if not self._is_wanted():
            raise KeyboardInterrupt

    def on_end(self, event: event.Event) -> None:
        pass


def _compile_beside(part: str, say: Say, is_wanted: Callable[[], bool]) -> None:
    """Compile in a process that ends with this one; pass on what it says.

    Raises:
        KeyboardInterrupt: If the kernels are wanted no more.
    """
    command = [sys.executable, "-P", "-m", "sfr_loc_map.pipeline.compile_kernels", part]
    environment = child_environment()
    with subprocess.Popen(
        command, env=environment, text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
    ) as child:
        threading.Thread(target=_end_when_unwanted, args=(child, is_wanted), daemon=True).start()
        for line in child.stdout or ():
            say(line.rstrip())
    end = time.monotonic() + (SIGNAL_S if child.returncode < 0 else 0.0)
    while is_wanted() and time.monotonic() < end:
        time.sleep(POLL_S)
    if not is_wanted():
        raise KeyboardInterrupt
    if child.returncode != 0:
        say(f"the process that compiles ended with exit code {child.returncode}: the kernels are compiled here")


def _end_when_unwanted(child: subprocess.Popen[str], is_wanted: Callable[[], bool]) -> None:
    while child.poll() is None:
        if not is_wanted():
            child.terminate()
        time.sleep(POLL_S)

"""Loads the kernels of a part; where they are not compiled yet, a process of its own compiles them first.

The compiler takes some 300 MB, and a process does not give them back: in a first run after an installation they would
be scored as memory of the localiser or the mapper. So a compilation that begins here is refused, `compile_kernels`
is run beside, and what it left in the cache is loaded.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import Any

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


def load_kernels(part: str, say: Say = say_on_stderr, is_wanted: Callable[[], bool] | None = None) -> None:
    """Load all kernels of a part, so that no later call pays for it.

    SIGINT and SIGTERM, where Python handles them, take effect when that is done.

    Args:
        part: One of `compile_kernels.PARTS`.
        say: Called with each line of progress where kernels are compiled.
        is_wanted: Becomes false where the program is to end and no exception says so, as in a ROS node. Where it is
            given, the handlers of signals are left as they are.

    Raises:
        KeyboardInterrupt: If kernels had to be compiled, and are wanted no more.
    """
    with _signals_deferred() if is_wanted is None else nullcontext(is_wanted) as goes_on:
        _load(part, say, goes_on)


@contextmanager
def _signals_deferred() -> Iterator[Callable[[], bool]]:
    """Call Python's handlers of SIGINT and SIGTERM afterwards; yield what tells whether there was no such signal.

    numba loads compiled code in a callback from C. An exception of a handler there is discarded, and numba then calls a
    kernel that is not loaded (SIGSEGV).
    """
    received: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)

    before: dict[int, Callable[[int, FrameType | None], Any]] = {}
    if threading.current_thread() is threading.main_thread():  # no other may set handlers, or runs them
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(handler := signal.getsignal(number)):
                before[number] = handler
                signal.signal(number, note)
    try:
        yield lambda: not received
    finally:
        for changed, handler in before.items():
            signal.signal(changed, handler)
        if received:
            before[received[0]](received[0], None)


def _load(part: str, say: Say, is_wanted: Callable[[], bool]) -> None:
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

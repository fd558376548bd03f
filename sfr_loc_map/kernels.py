"""Loads the kernels of a part; where they are not compiled yet, a process of its own compiles them first.

    python -m sfr_loc_map.kernels localisation mapping terrain

The compiler takes some 300 MB, and a process does not give them back: in a first run after an installation they would
be scored as memory of the localiser or the mapper. So a compilation that begins here is refused, this module is run
beside, and what it left in the cache is loaded. Each part takes up to a minute of one core the first time.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from importlib import import_module
from types import FrameType
from typing import Any

from numba.core import event

from sfr_loc_map.child_process import child_environment, end_with_parent
from sfr_loc_map.jit import KERNELS
from sfr_loc_map.signals import END_SIGNALS

COMPILE = "numba:compile"  # event: a kernel is compiled; none for one that is loaded from the cache
POLL_S = 0.1
PERIOD_S = 3.0  # of lines that say how far a compilation is
SIGNAL_S = 1.0  # how long after a signal has ended the compiling process this one may still learn of it
Say = Callable[[str], None]
_ONE_AT_A_TIME = threading.Lock()

PARTS: Mapping[str, Callable[[], None]] = {
    "localisation": lambda: import_module("sfr_loc_map.localisation.localiser").Localiser.warm_up(),
    "mapping": lambda: import_module("sfr_loc_map.mapping.mapper").Mapper.warm_up(),
    "terrain": lambda: import_module("sfr_loc_map.mapping.terrain.terrain_grid").warm_up(),
}


def load_kernels(
    part: str,
    say: Say = lambda line: print(line, file=sys.stderr, flush=True),
    is_wanted: Callable[[], bool] | None = None,
) -> None:
    """Load all kernels of a part, so that no later call pays for it.

    Signals that end a program take effect, where Python handles them, when that is done. Kernels that had to be
    compiled and are wanted no more end in KeyboardInterrupt: `is_wanted` says so where no exception does, as in a ROS
    node, and the handlers of signals are then left as they are.
    """

    def refuse(_: object) -> None:
        raise _NotCompiledError

    def end_when_unwanted(_: object) -> None:
        if not goes_on():
            raise KeyboardInterrupt

    with _signals_deferred() if is_wanted is None else nullcontext(is_wanted) as goes_on, _ONE_AT_A_TIME:
        with event.install_listener(COMPILE, _Listener(refuse)):  # it hears all threads
            try:
                PARTS[part]()
                return
            except _NotCompiledError:  # refused all the while: other threads of the part have not ended yet
                _compile_beside(part, say, goes_on)
        guard = event.install_listener(COMPILE, _Listener(end_when_unwanted))
        with guard, announce_compilation(say):  # of what could not be kept: the cache may be read-only
            PARTS[part]()


class _NotCompiledError(Exception):
    """A kernel is not in the cache."""


class _Listener(event.Listener):
    """Calls a function with the kernel before each compilation, which an exception of it ends."""

    def __init__(self, before: Callable[[object], None]) -> None:
        self._before = before

    def on_start(self, event: event.Event) -> None:
        self._before(event.data["dispatcher"])

    def on_end(self, event: event.Event) -> None:
        pass


@contextmanager
def announce_compilation(say: Say) -> Iterator[None]:
    """Say which of how many kernels is compiled within the `with` block, and how long it took; where none is, nothing.

    Of those of the modules that are loaded a part uses nearly all.
    """
    begin_s = said_s = 0.0
    done: set[object] = set()

    def before(kernel: object) -> None:
        nonlocal begin_s, said_s
        now_s = time.monotonic()
        done.update({kernel} & KERNELS)
        if not begin_s:
            begin_s = said_s = now_s
            say("compiles its kernels, once after an installation: this takes about a minute")
        elif now_s - said_s >= PERIOD_S:
            said_s = now_s
            say(f"compiling: kernel {len(done)} of at most {len(KERNELS)}")

    with event.install_listener(COMPILE, _Listener(before)):
        yield
    if begin_s:
        say(f"{len(done)} kernels compiled in {time.monotonic() - begin_s:.0f} s; later starts load them")


@contextmanager
def _signals_deferred() -> Iterator[Callable[[], bool]]:
    """Call Python's handlers of `END_SIGNALS` afterwards; yield what tells whether there was no such signal.

    numba loads compiled code in a callback from C. An exception of a handler there is discarded, and numba then calls a
    kernel that is not loaded (SIGSEGV).
    """
    received: list[int] = []
    before: dict[int, Callable[[int, FrameType | None], Any]] = {}
    if threading.current_thread() is threading.main_thread():  # no other may set handlers, or runs them
        for number in END_SIGNALS:
            if callable(handler := signal.getsignal(number)):
                before[number] = handler
                signal.signal(number, lambda number, frame: received.append(number))
    try:
        yield lambda: not received
    finally:
        for changed, handler in before.items():
            signal.signal(changed, handler)
        if received:
            before[received[0]](received[0], None)


def _compile_beside(part: str, say: Say, is_wanted: Callable[[], bool]) -> None:
    command = [sys.executable, "-P", "-m", "sfr_loc_map.kernels", part]
    pipes: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, env=child_environment(), text=True, **pipes) as child:

        def end_when_unwanted() -> None:
            while child.poll() is None:
                if not is_wanted():
                    child.terminate()
                time.sleep(POLL_S)

        threading.Thread(target=end_when_unwanted, daemon=True).start()
        for line in child.stdout or ():
            say(line.rstrip())
    end = time.monotonic() + (SIGNAL_S if child.returncode < 0 else 0.0)
    while is_wanted() and time.monotonic() < end:
        time.sleep(POLL_S)
    if not is_wanted():
        raise KeyboardInterrupt
    if child.returncode != 0:
        say(f"the process that compiles ended with exit code {child.returncode}: the kernels are compiled here")


if __name__ == "__main__":
    end_with_parent(signal.SIGTERM)  # compilation ends with the process that waits for it
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it goes to the whole terminal: no traceback beside the one who waits
    with announce_compilation(lambda line: print(line, flush=True)):
        for part in sys.argv[1:]:
            PARTS[part]()

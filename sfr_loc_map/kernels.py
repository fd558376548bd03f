"""Load the compiled functions (numba kernels) of a part: localisation, mapping or terrain.

If the kernels are not compiled yet, a separate process compiles them first:

    python -m sfr_loc_map.kernels localisation mapping terrain

The compiler takes about 300 MB, which a process does not release. In the first run after an installation, this memory
would be scored as memory of the localiser or the mapper. A compilation that begins in this process is therefore
stopped, this module is run in a separate process, and the kernels are loaded from the cache. The compilation of a part
takes up to a minute on one core.
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

from sfr_loc_map.child_process import child_environment, end_with_parent, ending_of
from sfr_loc_map.jit import KERNELS
from sfr_loc_map.signals import END_SIGNALS

COMPILE = "numba:compile"  # numba's event of a compilation; loading from the cache has no event
POLL_S = 0.1
PERIOD_S = 3.0  # period of progress lines, s
SIGNAL_S = 1.0  # maximum delay, s, until this process receives the signal that ended the compiling process
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
    """Load all kernels of a part, so that no later call has to load or compile them.

    Signals that end a program are deferred until the kernels are loaded or the compilation has stopped. In a ROS node,
    signals raise no exception. A node passes `is_wanted` instead, and its signal handlers are left unchanged. If the
    kernels are no longer wanted, the compilation stops with KeyboardInterrupt.
    """

    def refuse(_: object) -> None:
        raise _NotCompiledError

    def end_when_unwanted(_: object) -> None:
        if not goes_on():
            raise KeyboardInterrupt

    with _signals_deferred() if is_wanted is None else nullcontext(is_wanted) as goes_on, _ONE_AT_A_TIME:
        with event.install_listener(COMPILE, _Listener(refuse)):  # numba calls the listener in every thread
            try:
                PARTS[part]()
                return
            except _NotCompiledError:  # with the listener, so that no other thread compiles meanwhile
                _compile_beside(part, say, goes_on)
        guard = event.install_listener(COMPILE, _Listener(end_when_unwanted))
        with guard, announce_compilation(say):  # kernels that the other process did not save are compiled here
            PARTS[part]()


class _NotCompiledError(Exception):
    """A kernel is not in the cache."""


class _Listener(event.Listener):
    """Calls a function before each compilation, with the kernel. An exception in the function stops the compilation."""

    def __init__(self, before: Callable[[object], None]) -> None:
        self._before = before

    def on_start(self, event: event.Event) -> None:
        self._before(event.data["dispatcher"])

    def on_end(self, event: event.Event) -> None:
        pass


@contextmanager
def announce_compilation(say: Say) -> Iterator[None]:
    """Report progress and duration of compilations within the `with` block.

    The reported total is the number of kernels in all loaded modules. The localiser or the mapper alone compiles nearly
    all of them.
    """
    begin_s = said_s = 0.0
    done: set[object] = set()

    def before(kernel: object) -> None:
        nonlocal begin_s, said_s
        now_s = time.monotonic()
        done.update({kernel} & KERNELS)
        if not begin_s:
            begin_s = said_s = now_s
            say("compiling kernels, once after an installation: this takes about a minute")
        elif now_s - said_s >= PERIOD_S:
            said_s = now_s
            say(f"compiling: kernel {len(done)} of at most {len(KERNELS)}")

    with event.install_listener(COMPILE, _Listener(before)):
        yield
    if begin_s:
        say(f"{len(done)} kernels compiled in {time.monotonic() - begin_s:.0f} s; later starts load them")


@contextmanager
def _signals_deferred() -> Iterator[Callable[[], bool]]:
    """Defer Python's handlers of `END_SIGNALS`; yield a function that returns whether no such signal was received.

    Numba loads compiled code in a callback from C. An exception in a handler is discarded there, and numba then calls a
    kernel that is not loaded (SIGSEGV).
    """
    received: list[int] = []
    before: dict[int, Callable[[int, FrameType | None], Any]] = {}
    if threading.current_thread() is threading.main_thread():  # only this thread may set and run handlers
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
        say(f"the compiling process {ending_of(child.returncode)}: kernels are compiled in this process")


if __name__ == "__main__":
    end_with_parent(signal.SIGTERM)  # compilation ends with the process that waits for it
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # a terminal signals both processes: avoid a second traceback
    with announce_compilation(lambda line: print(line, flush=True)):
        for part in sys.argv[1:]:
            PARTS[part]()

"""Compiles the kernels of a part before they are needed, as `make demo` does beside the installation.

    python -m sfr_loc_map.pipeline.kernels localisation mapping terrain metrics

Each part takes up to a minute of one core the first time, a few seconds to load later. Parts may be compiled in
processes side by side. Nothing has to be compiled in advance: what needs kernels has this run when it starts
(`load_kernels`).
"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from types import FrameType
from typing import Any

from numba.core import event

from sfr_loc_map.child_process import child_environment, end_with_parent
from sfr_loc_map.errors import ConfigError

COMPILE = "numba:compile"
"""Event of numba: a kernel is compiled; none for one that is loaded from the cache."""
PERIOD_S = 5.0
Say = Callable[[str], None]


def _localisation() -> None:
    from sfr_loc_map.localisation.localiser import Localiser

    Localiser.warm_up()


def _mapping() -> None:
    from sfr_loc_map.geometry.stereo import StereoRig
    from sfr_loc_map.mapping.config import MappingConfig
    from sfr_loc_map.mapping.mapper import Mapper

    Mapper(StereoRig(320, 240, 300.0, 300.0, 159.5, 119.5, 0.1), MappingConfig()).warm_up()


def _terrain() -> None:
    from sfr_loc_map.mapping.terrain import grid

    grid.warm_up()


def _metrics() -> None:
    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.pipeline.monitor_score import warm_up

    warm_up(ScoreConfig())


PARTS: Mapping[str, Callable[[], None]] = {
    "localisation": _localisation,
    "mapping": _mapping,
    "terrain": _terrain,
    "metrics": _metrics,
}


@contextmanager
def announce_compilation(say: Say, clock: Callable[[], float] = time.monotonic) -> Iterator[None]:
    """Say that kernels are compiled within the `with` block, every 5 s how many, and how long it took; else nothing.

    Args:
        say: Called with each line, in the thread that compiles.
        clock: Seconds, going forward.
    """
    progress = _Progress(say, clock)
    with event.install_listener(COMPILE, progress):
        yield
    if progress.count:
        say(f"{progress.count} kernels compiled in {progress.elapsed_s:.0f} s; later starts load them")


def compile_kernels(parts: list[str]) -> None:
    """Compile the kernels of parts, or load those that are compiled.

    Args:
        parts: Some of `PARTS`.

    Raises:
        ConfigError: If another part is named.
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise ConfigError(f"no kernels of '{unknown[0]}': give some of {', '.join(PARTS)}")
    for part in parts:
        PARTS[part]()


class _Progress(event.Listener):
    """Counts the kernels that are compiled."""

    def __init__(self, say: Say, clock: Callable[[], float]) -> None:
        self.count = 0
        self._say, self._clock = say, clock
        self._begin = self._last = 0.0

    @property
    def elapsed_s(self) -> float:
        return self._clock() - self._begin

    def on_start(self, event: event.Event) -> None:
        if not self._begin:
            self._begin = self._last = self._clock()
            self._say("compiles its kernels, once after an installation: this takes about a minute")

    def on_end(self, event: event.Event) -> None:
        self.count += 1
        if self._clock() - self._last > PERIOD_S:
            self._last = self._clock()
            self._say(f"{self.count} kernels compiled, {self.elapsed_s:.0f} s")


if __name__ == "__main__":
    end_with_parent(signal.SIGTERM)  # who waits for the kernels is not outlived
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it goes to the whole terminal: no traceback beside the one who waits
    with announce_compilation(lambda line: print(line, flush=True)):
        compile_kernels(sys.argv[1:])


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
    command = [sys.executable, "-P", "-m", "sfr_loc_map.pipeline.kernels", part]
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

"""Says when a node compiles its kernels: the first start after an installation does, for a minute or so."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core import event

COMPILE = "numba:compile"
"""Event of numba: a kernel is compiled; none for one that is loaded from the cache."""
PERIOD_S = 5.0


class _Progress(event.Listener):
    """Counts the kernels that are compiled."""

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float]) -> None:
        self.count = 0
        self._say, self._clock = say, clock
        self._begin = self._last = 0.0

    @property
    def elapsed_s(self) -> float:
        return self._clock() - self._begin

    def on_start(self, item: event.Event) -> None:
        if not self._begin:
            self._begin = self._last = self._clock()
            self._say("compiles its kernels, once after an installation: this takes about a minute")

    def on_end(self, item: event.Event) -> None:
        self.count += 1
        if self._clock() - self._last > PERIOD_S:
            self._last = self._clock()
            self._say(f"{self.count} kernels compiled, {self.elapsed_s:.0f} s")


@contextmanager
def announce_compilation(say: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> Iterator[None]:
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

"""Compiles the kernels of a part before they are needed, as `make demo` does beside the installation.

    python -m sfr_loc_map.pipeline.compile_kernels localisation mapping terrain metrics

Each part takes up to a minute of one core the first time, a few seconds to load later. Parts may be compiled in
processes side by side. Nothing has to be compiled in advance: what needs kernels has this run when it starts
(`load_kernels`).
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from numba.core import event

from sfr_loc_map.child_process import end_with_parent
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
    from sfr_loc_map.pipeline.online.monitor_score import warm_up

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
    from sfr_loc_map.io import resampling

    resampling.warm_up()  # raw images may come to any part, which loads it before the first of them


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

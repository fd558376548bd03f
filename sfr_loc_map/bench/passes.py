"""One pass of several methods over the same pairs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Generic, TypeVar

from sfr_loc_map.bench.method_process import MethodProcess, SharedImages
from sfr_loc_map.bench.reference_methods import OURS, ReferenceMethod
from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import BenchError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

Progress = Callable[[str], None]
"""Called with the name of a method after each of its calls."""
R = TypeVar("R")


@dataclass(slots=True, eq=False)
class Run(Generic[R]):
    """Calls of one method in one pass.

    Attributes:
        method: The method.
        version: Its version.
        idle_bytes: Resident memory of its process before the first call.
        seconds: Time of each call.
        peaks: Peak of resident memory of each call.
        results: Result of each call.
    """

    method: ReferenceMethod
    version: str
    idle_bytes: int | None
    seconds: list[float] = field(default_factory=list)
    peaks: list[int | None] = field(default_factory=list)
    results: list[R] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Pass(Generic[R]):
    """A pass of several methods.

    Attributes:
        runs: Runs of the methods that completed the pass, by name.
        failed: Reason why the others did not, by name.
    """

    runs: dict[str, Run[R]] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class PassInput(Generic[R]):
    """Input of all methods, and how their results are read.

    Attributes:
        rig: Rig of the pairs.
        pairs: Yields the pairs from the start at each call.
        setup: Sent to each worker besides the rig.
        read_result: Result of a call from the worker's report and the file that it may have written.
        rate_scale: Factor on the rate of the recording, for methods that work in the background.
    """

    rig: StereoRig
    pairs: Callable[[], Iterable[StereoPair]]
    setup: Mapping[str, Any]
    read_result: Callable[[Mapping[str, Any], Path], R]
    rate_scale: float = 1.0


def run_passes(
    methods: Sequence[ReferenceMethod], given: PassInput[R], repeat: int, progress: Progress
) -> tuple[dict[str, list[Run[R]]], dict[str, str]]:
    """Repeat a pass; a method that has failed is left out of the later ones.

    Returns:
        Runs by method, and the reasons of the methods that failed.

    Raises:
        BenchError: If ours failed.
    """
    runs: dict[str, list[Run[R]]] = {}
    failed: dict[str, str] = {}
    for _ in range(repeat):
        done = run_pass([method for method in methods if method.name not in failed], given, progress)
        failed |= done.failed
        if OURS in failed:
            raise BenchError(failed[OURS])
        for name, run in done.runs.items():
            runs.setdefault(name, []).append(run)
    return runs, failed


def run_pass(
    methods: Sequence[ReferenceMethod], given: PassInput[R], progress: Progress = lambda name: None
) -> Pass[R]:
    """Process all pairs with all methods.

    Methods that are idle between calls are interleaved: each pair is processed by one after the other, and the first
    one changes from pair to pair. Methods that work in the background follow, each alone, at the rate of the stamps.
    """
    idle = [method for method in methods if not method.background]
    done = _run_group(idle, given, None, progress)
    for method in methods:
        if method.background:
            alone = _run_group([method], given, given.rate_scale, progress)
            done.runs |= alone.runs
            done.failed |= alone.failed
    return done


def _run_group(
    methods: Sequence[ReferenceMethod], given: PassInput[R], rate_scale: float | None, progress: Progress
) -> Pass[R]:
    done: Pass[R] = Pass()
    with TemporaryDirectory(prefix="sfr_bench_") as temporary, ExitStack() as stack:
        folder = Path(temporary)
        images = SharedImages(folder / "images", given.rig)
        active: list[tuple[MethodProcess, Run[R]]] = []
        for method in methods:
            try:
                process = stack.enter_context(MethodProcess(method, given.rig, images, given.setup, folder))
            except BenchError as error:
                done.failed[method.name] = str(error)
                continue
            active.append((process, Run(method, process.version, process.idle_bytes)))
        pacer = _Pacer(rate_scale)
        for number, pair in enumerate(given.pairs()):
            images.show(pair)
            order = {"stamp_ns": pair.stamp_ns, "since_start_s": pacer.wait(pair.stamp_ns)}
            first = number % max(1, len(active))
            for process, run in [*active[first:], *active[:first]]:
                output = folder / f"{run.method.name}.npy"
                try:
                    answer = process.ask(order | {"output": str(output)})
                except BenchError as error:
                    done.failed[run.method.name] = str(error)
                    active.remove((process, run))
                    continue
                run.seconds.append(answer["seconds"])
                run.peaks.append(answer["peak_bytes"])
                run.results.append(given.read_result(answer["result"], output))
                progress(run.method.name)
        done.runs |= {run.method.name: run for _, run in active}
    return done


class _Pacer:
    """Delays pairs to the rate of their stamps; without a rate it only counts the time."""

    def __init__(self, rate_scale: float | None) -> None:
        self._rate_scale = rate_scale
        self._first_ns: int | None = None
        self._begin_s = 0.0

    def wait(self, stamp_ns: int) -> float:
        """Return the seconds since the first pair at the scaled rate, once they have passed."""
        if self._first_ns is None:
            self._first_ns, self._begin_s = stamp_ns, time.monotonic()
        since_s = (stamp_ns - self._first_ns) / NS_PER_S / (self._rate_scale or 1.0)
        if self._rate_scale is not None:
            time.sleep(max(0.0, self._begin_s + since_s - time.monotonic()))
        return since_s

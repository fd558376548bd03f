"""One pass of several methods over the same pairs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from sfr_loc_map.bench.results import OURS
from sfr_loc_map.errors import BenchError, MethodError
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.calls import CallUsage

Progress = Callable[[str], None]
"""Called with the name of a method after each of its calls."""
LIMITS = MethodLimits(call_timeout_s=900.0, memory_mb=16_000, restarts=0)
"""Of a method in a benchmark; some dense matchers take minutes."""
M = TypeVar("M", bound=IsolatedMethod)
R = TypeVar("R")


@dataclass(slots=True, eq=False)
class Run(Generic[R]):
    """Calls of one method in one pass.

    Attributes:
        version: Its version.
        idle_bytes: Resident memory of its process before the first call.
        seconds: Time of each call.
        peaks: Peak of resident memory of each call.
        results: Result of each call.
        findings: What it did wrong in calls after which it went on.
    """

    version: str
    idle_bytes: int | None
    seconds: list[float] = field(default_factory=list)
    peaks: list[int | None] = field(default_factory=list)
    results: list[R] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)


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
class PassInput(Generic[M, R]):
    """Input of all methods, and how they are called.

    Attributes:
        pairs: Yields the pairs from the start at each call.
        open: Starts a method.
        call: Gives it a pair, and the seconds since the first one; returns result, costs and finding.
        rate_scale: Factor on the rate of the recording, for methods that work in the background.
    """

    pairs: Callable[[], Iterable[StereoPair]]
    open: Callable[[Method], M]
    call: Callable[[M, StereoPair, float], tuple[R, CallUsage, str]]
    rate_scale: float = 1.0


def run_passes(
    methods: Sequence[Method], given: PassInput[M, R], repeat: int, progress: Progress
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
    return {name: mine for name, mine in runs.items() if name not in failed}, failed


def run_pass(methods: Sequence[Method], given: PassInput[M, R], progress: Progress = lambda name: None) -> Pass[R]:
    """Process all pairs with all methods.

    Methods that are idle between calls are interleaved: each pair is processed by one after the other, and the first
    one changes from pair to pair. Methods that work in the background follow, each alone, at the rate of the stamps.
    """
    done = _run_group([method for method in methods if not method.background], given, None, progress)
    for method in methods:
        if method.background:
            alone = _run_group([method], given, given.rate_scale, progress)
            done.runs |= alone.runs
            done.failed |= alone.failed
    return done


def _run_group(
    methods: Sequence[Method], given: PassInput[M, R], rate_scale: float | None, progress: Progress
) -> Pass[R]:
    done: Pass[R] = Pass()
    with ExitStack() as stack:
        active: list[tuple[str, M]] = []
        for method in methods:
            try:
                opened = given.open(method)
            except MethodError as error:
                done.failed[method.name] = str(error)
                continue
            stack.callback(opened.close)
            active.append((method.name, opened))
            done.runs[method.name] = Run(opened.record.version or "", opened.idle_bytes)
        pacer = _Pacer(rate_scale)
        for number, pair in enumerate(given.pairs()):
            since_start_s = pacer.wait(pair.stamp_ns)
            first = number % max(1, len(active))
            for name, opened in [*active[first:], *active[:first]]:
                result, usage, finding = given.call(opened, pair, since_start_s)
                if not opened.alive:
                    done.failed[name] = f"method {name}: {finding}"
                    del done.runs[name]
                    active.remove((name, opened))
                    continue
                _add(done.runs[name], result, usage, finding)
                progress(name)
    return done


def _add(run: Run[R], result: R, usage: CallUsage, finding: str) -> None:
    run.seconds.append(usage.processing_time_s)
    run.peaks.append(usage.peak_rss_bytes)
    run.results.append(result)
    if finding:
        run.findings.append(finding)


def findings_of(runs: Mapping[str, Sequence[Run[R]]]) -> dict[str, list[str]]:
    """Return what methods did wrong in calls after which they went on, by name."""
    found = {name: list(dict.fromkeys(text for run in mine for text in run.findings)) for name, mine in runs.items()}
    return {name: texts for name, texts in found.items() if texts}


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

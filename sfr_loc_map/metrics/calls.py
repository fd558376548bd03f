"""Time and memory of the calls of a processing API [4.2.1, 4.2.2, 4.3.1, 4.3.2]: measured one by one, and scored.

Memory: before a call the kernel's high-water mark of the process' resident memory is set back to what is resident
now (`5` written to `/proc/self/clear_refs`), after it the mark is read (`VmHWM` in `/proc/self/status`): the kernel's
own peak, of all threads together, exact to some hundred KiB. Memory "above the idle process" is the peak less what was
resident when the meter was made or told so (`mark_idle`).
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics.config import CallKind, MappingState
from sfr_loc_map.metrics.score import (
    CallDetails,
    CallFigures,
    CallHistogram,
    CallScore,
    CallSeries,
    ExternalScore,
    MemoryScore,
    PeakMemory,
    StageTime,
    TargetScore,
    TimingScore,
)
from sfr_loc_map.metrics.statistics import column, sample_statistic

HOST_CLOCK = "host monotonic"
NODE_CLOCK = "as the node reports (<node>/call)"
METHOD = "kernel high-water mark of resident memory (VmHWM), set back before each call"
METHOD_UNAVAILABLE = "not measured: this system has no resettable high-water mark (/proc/self/clear_refs)"
KINDS: dict[str, CallKind] = {
    MappingState.MAPPED: CallKind.MAPPING,
    MappingState.FUSED: CallKind.FUSION,
    MappingState.MAPPED_SET: CallKind.MAPPING_CALL,
}
"""Kind of call by its state; all other states are those of the localiser."""
UNMEASURED = PeakMemory(peak_bytes=None, above_idle_bytes=None)
HISTOGRAM_BINS = 40
SERIES_ROWS = 2000  #: Calls of each kind that are kept for figures.


# ---- measuring


@dataclass(slots=True)
class CallUsage:
    """What one call took: wall-clock time, peak resident memory, the same above the idle process."""

    processing_time_s: float = 0.0
    peak_rss_bytes: int | None = None
    above_idle_bytes: int | None = None

    def cost(self, state: str) -> tuple[float, str, int | None, int | None]:
        """Return time, state after the call and memory, as a `CallRecord` has them."""
        return self.processing_time_s, str(state), self.peak_rss_bytes, self.above_idle_bytes


class CallMeter:
    """Measures calls, one at a time; names its clock and how memory is measured."""

    def __init__(self, clock_ns: Callable[[], int] = time.perf_counter_ns, clock: str = HOST_CLOCK) -> None:
        """Take the present resident memory as that of the idle process."""
        self.clock = clock
        self._clock_ns = clock_ns
        try:
            _reset_peak()
            self._available = _status_bytes(b"VmHWM:") > 0
        except OSError:
            self._available = False
        self.method = METHOD if self._available else METHOD_UNAVAILABLE
        self.mark_idle()

    def mark_idle(self) -> None:
        """Take the present resident memory as that of the idle process (after start and warm-up)."""
        self._idle = _status_bytes(b"VmRSS:") if self._available else 0

    @contextmanager
    def measure(self) -> Iterator[CallUsage]:
        """Measure what is done in the `with` block; the usage is filled in at its end, an error passes through."""
        usage = CallUsage()
        if self._available:
            _reset_peak()
        begin = self._clock_ns()
        try:
            yield usage
        finally:
            usage.processing_time_s = (self._clock_ns() - begin) * 1e-9
            if self._available:
                usage.peak_rss_bytes = _status_bytes(b"VmHWM:")
                usage.above_idle_bytes = max(usage.peak_rss_bytes - self._idle, 0)


def _reset_peak() -> None:
    with open("/proc/self/clear_refs", "wb", buffering=0) as stream:
        stream.write(b"5")


def _status_bytes(key: bytes) -> int:
    with open("/proc/self/status", "rb", buffering=0) as stream:
        text = stream.read(8192)
    at = text.find(key)
    return 0 if at < 0 else int(text[at + len(key) : text.index(b"kB", at)]) * 1024


# ---- scoring


@dataclass(frozen=True, slots=True, eq=False)
class Calls:
    """Calls in the order they were made."""

    stamps_ns: IntArray  #: `(N,)` int64, stamp of the pair.
    seconds: FloatArray  #: `(N,)` float64, wall-clock time, NaN where not measured.
    states: Sequence[str]  #: `(N,)` state of each call: initialising, tracking, degraded, lost; mapped, fused.
    peak_bytes: FloatArray  #: `(N,)` float64, peak resident memory, NaN where not measured.
    above_idle_bytes: FloatArray  #: `(N,)` float64, the same above the idle process.
    #: `(N,)` float64 by name, time of each stage, NaN where a call had none of that name.
    stage_s: Mapping[str, FloatArray] = field(default_factory=dict)
    heap_bytes: FloatArray | None = None  #: `(N,)` largest sum of blocks, NaN where not measured; None: nowhere.
    stack_bytes: FloatArray | None = None  #: `(N,)` deepest stack, likewise.


class ScoredCalls(NamedTuple):
    """What calls add to the score: its parts `timing` and `memory`, and what figures are drawn from if wanted."""

    timing: TimingScore
    memory: MemoryScore
    details: CallDetails | None


def parts_of(calls: Sequence[ScoredCalls]) -> tuple[TimingScore | None, MemoryScore | None, CallDetails | None]:
    """Return the parts of a score, None where nothing was measured; of a kind that several sources have the last."""
    known: tuple[dict[str, Any], ...] = ({}, {}, {})
    for scored in calls:
        for part, values in zip(scored, known, strict=True):
            told = {} if part is None else vars(part)
            values.update({name: value for name, value in told.items() if value is not None})
    timing, memory = TimingScore(**known[0]), MemoryScore(**known[1])
    drawn = None if all(item.details is None for item in calls) else CallDetails(**known[2])
    return timing if any(timing.kinds()) else None, memory if memory != MemoryScore() else None, drawn


def score_calls(calls: Calls, clock: str = HOST_CLOCK, *, details: bool = True) -> ScoredCalls:
    """Return times (with the name of their clock) and memory of calls, whose states tell what kind they are."""
    kinds = np.array([KINDS.get(state, CallKind.LOCALISATION) for state in calls.states], dtype=object)
    timing, peaks, drawn = {}, {}, {}
    # a system that cannot tell its memory may say 0: that is not known; above the idle process 0 may be true
    peak = np.where(calls.peak_bytes > 0.0, calls.peak_bytes, np.nan)
    above = np.where(np.isfinite(peak) | (calls.above_idle_bytes > 0.0), calls.above_idle_bytes, np.nan)
    calls = replace(calls, peak_bytes=peak, above_idle_bytes=above)
    for kind in CallKind:
        rows = np.flatnonzero(kinds == kind)
        if not len(rows):
            continue
        seconds = calls.seconds[rows]
        if np.isfinite(seconds).any():
            times = {name: stage_time(values[rows]) for name, values in sorted(calls.stage_s.items())}
            stages = {name: figures for name, figures in times.items() if figures is not None}
            timing[kind.value] = call_score(seconds, clock, stages)
        peaks[kind.value] = PeakMemory(
            **{
                f"{name}_bytes": int(known.max())
                if values is not None and len(known := values[rows][np.isfinite(values[rows])])
                else None
                for name, values in (
                    ("peak", calls.peak_bytes),
                    ("above_idle", calls.above_idle_bytes),
                    ("heap_peak", calls.heap_bytes),
                    ("stack_peak", calls.stack_bytes),
                )
            }
        )
        if details:
            drawn[kind.value] = _figures(calls, rows)
    method = METHOD if any(each != UNMEASURED for each in peaks.values()) else METHOD_UNAVAILABLE
    memory = MemoryScore(**peaks, method=method)
    return ScoredCalls(TimingScore(**timing), memory, CallDetails(**drawn) if details else None)


def call_score(seconds: FloatArray, clock: str, stages: Mapping[str, StageTime] | None = None) -> CallScore:
    """Return the figures of all calls `(N,)` in order, NaN where not measured; the first, which may load, apart."""
    known = seconds[np.isfinite(seconds)]
    return CallScore(
        **asdict(sample_statistic(known)),
        p99=float(np.percentile(known, 99.0)) if len(known) else None,
        max=float(known.max()) if len(known) else None,
        first=float(known[0]) if len(known) else None,
        max_after_first=float(known[1:].max()) if len(known) > 1 else None,
        clock=clock,
        stages=stages or {},
    )


def stage_time(seconds: FloatArray) -> StageTime | None:
    """Return the figures of one stage over the calls that had it; None if none had."""
    known = seconds[np.isfinite(seconds)]
    return StageTime(**asdict(sample_statistic(known)), max=float(known.max())) if len(known) else None


def _figures(calls: Calls, mine: NDArray[np.intp]) -> CallFigures:
    block = max(1, -(-len(mine) // SERIES_ROWS))
    blocks = (mine[first : first + block] for first in range(0, len(mine), block))
    chosen = [rows[np.argmax(np.nan_to_num(calls.seconds[rows], nan=-1.0))] for rows in blocks]
    series = CallSeries(
        slowest_of=block,
        stamp_ns=tuple(calls.stamps_ns[chosen].tolist()),
        processing_time_s=column(calls.seconds[chosen], None),
        peak_rss_bytes=column(calls.peak_bytes[chosen], None),
        state=tuple(calls.states[row] for row in chosen),
    )
    seconds, histogram = calls.seconds[mine], CallHistogram(edges_s=(), counts=())
    if len(known := seconds[np.isfinite(seconds) & (seconds > 0)]):
        low, high = float(known.min()), float(known.max())
        edges = np.geomspace(low, max(high, low * 1.01) * (1 + 1e-9), HISTOGRAM_BINS + 1)
        edges[0] = low
        counts = np.histogram(known, edges)[0]
        histogram = CallHistogram(edges_s=tuple(edges.tolist()), counts=tuple(counts.tolist()))
    return CallFigures(histogram=histogram, series=series)


def score_target(
    calls: Calls,
    name: str,
    estimate_ns: IntArray | None = None,
    *,
    has_stamps: bool = False,
    other_run: str | None = None,
) -> TargetScore:
    """Return the score of calls that were measured elsewhere, under that target's name.

    Calls with stamps belong to estimates of the same stamps; MetricsError if they are of another run that is not named.
    """
    matched = None
    if has_stamps and estimate_ns is not None and len(estimate_ns):
        localised = [stamp for stamp, state in zip(calls.stamps_ns, calls.states, strict=True) if state not in KINDS]
        matched = float(np.isin(estimate_ns, localised).mean())
        if localised and not np.isin(localised, estimate_ns).all() and other_run is None:
            raise MetricsError(
                f"the times of {name} are of another run: {np.count_nonzero(~np.isin(localised, estimate_ns))} of "
                f"{len(localised)} stamps are not the estimate's; name that run by --target-run"
            )
    timing, memory, _ = score_calls(calls, clock=name, details=False)
    memory = replace(memory, method=f"as measured on {name}") if memory.method == METHOD else MemoryScore()
    return TargetScore(name=name, timing=timing, memory=memory, matched_share=matched, other_run=other_run)


def stage_of(figure: str) -> str | None:
    """Return the name of the stage whose time a figure of a call is (`stage_NAME_s`), None if it is none."""
    found = re.fullmatch(r"stage_(.+)_s", figure)
    return None if found is None else found[1]


def with_external(scored: ScoredCalls, node: ExternalScore) -> ScoredCalls:
    """Return scored calls with the clock of an external node's own times, and the memory of its processes."""
    kind, timing, memory = CallKind(node.task), scored.timing, scored.memory
    if (calls := timing.of(kind)) is not None:
        timing = replace(timing, **{kind.value: replace(calls, clock=NODE_CLOCK)})
    told = memory.of(kind)
    if node.process is not None and (told is None or told.peak_bytes is None):
        others = [peaks for other in CallKind if other is not kind and (peaks := memory.of(other)) is not None]
        beside = f"; others: {memory.method}" if any(item.peak_bytes is not None for item in others) else ""
        peaks = PeakMemory(peak_bytes=node.process.peak_rss_bytes or None, above_idle_bytes=None)
        memory = replace(memory, **{kind.value: peaks}, method=f"{kind}: {node.process.method}{beside}")
    return scored._replace(timing=timing, memory=memory)

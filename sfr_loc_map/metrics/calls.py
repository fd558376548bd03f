"""Time and memory of the calls of a processing API [4.2.1, 4.2.2, 4.3.1, 4.3.2]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics.config import CallKind, MappingState
from sfr_loc_map.metrics.resources import METHOD, METHOD_UNAVAILABLE
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
NODE_CLOCK = "as the node reports (/diagnostics)"
HISTOGRAM_BINS = 40
KINDS: dict[str, CallKind] = {MappingState.MAPPED: CallKind.MAPPING, MappingState.FUSED: CallKind.FUSION}
"""Kind of call by its state; all other states are those of the localiser."""
SERIES_ROWS = 2000
"""Calls of each kind that are kept for figures."""
Part = TypeVar("Part", TimingScore, MemoryScore, CallDetails)
Rows = NDArray[np.intp]
STAGE_PREFIX, STAGE_SUFFIX = "stage_", "_s"
"""What surrounds the name of a stage among the figures of a call."""


def call_score(seconds: FloatArray, clock: str, stages: Mapping[str, StageTime] | None = None) -> CallScore:
    """Return the figures of all calls, the first apart as well, since it may load or compile.

    Args:
        seconds: `(N,)` seconds of each call in order; NaN (not measured) is left out.
        clock: Clock they were measured with; a host time is never shown under another name.
        stages: Times of the stages of the calls.
    """
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
    if not len(known):
        return None
    return StageTime(**asdict(sample_statistic(known)), max=float(known.max()))


def call_histogram(seconds: FloatArray) -> CallHistogram:
    """Return a histogram of the times with logarithmic bins."""
    known = seconds[np.isfinite(seconds) & (seconds > 0)]
    if not len(known):
        return CallHistogram(edges_s=(), counts=())
    low, high = float(known.min()), float(known.max())
    edges = np.geomspace(low, max(high, low * 1.01) * (1 + 1e-9), HISTOGRAM_BINS + 1)
    edges[0] = low
    return CallHistogram(edges_s=tuple(edges.tolist()), counts=tuple(np.histogram(known, edges)[0].tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class Calls:
    """Calls in the order they were made.

    Attributes:
        stamps_ns: `(N,)` int64, stamp of the pair.
        seconds: `(N,)` float64, wall-clock time, NaN where not measured.
        states: `(N,)` state of each call: initialising, tracking, degraded, lost; mapped, fused.
        peak_bytes: `(N,)` float64, peak resident memory, NaN where not measured.
        above_idle_bytes: `(N,)` float64, the same above the idle process.
        stage_s: `(N,)` float64 by name, time of each stage, NaN where a call had none of that name.
    """

    stamps_ns: IntArray
    seconds: FloatArray
    states: Sequence[str]
    peak_bytes: FloatArray
    above_idle_bytes: FloatArray
    stage_s: Mapping[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ScoredCalls:
    """What calls add to the score.

    Attributes:
        timing: The part `timing`.
        memory: The part `memory`.
        details: What figures are drawn from, None if it is not wanted.
    """

    timing: TimingScore
    memory: MemoryScore
    details: CallDetails | None

    def merged(self, other: ScoredCalls) -> ScoredCalls:
        """Return both; of a kind that both have the other's."""
        return ScoredCalls(
            _merged(self.timing, other.timing),
            _merged(self.memory, other.memory),
            _merged(self.details or CallDetails(), other.details or CallDetails()),
        )


def _merged(first: Part, second: Part) -> Part:
    present = {item.name: getattr(second, item.name) for item in fields(second)}
    return replace(first, **{name: value for name, value in present.items() if value is not None})


def score_calls(calls: Calls, clock: str = HOST_CLOCK, *, details: bool = True) -> ScoredCalls:
    """Return times and memory of calls; localisation, mapping (one pair) and fusion are told apart by their states.

    Args:
        calls: All calls.
        clock: Clock of their times.
        details: Whether what figures are drawn from is wanted.
    """
    kinds = np.array([KINDS.get(state, CallKind.LOCALISATION) for state in calls.states], dtype=object)
    timing, peaks, drawn = {}, {}, {}
    for kind in CallKind:
        rows = np.flatnonzero(kinds == kind)
        if not len(rows):
            continue
        seconds = calls.seconds[rows]
        if np.isfinite(seconds).any():
            times = {name: stage_time(values[rows]) for name, values in sorted(calls.stage_s.items())}
            stages = {name: time for name, time in times.items() if time is not None}
            timing[kind.value] = call_score(seconds, clock, stages)
        peak, above_idle = (
            int(known.max()) if len(known := values[rows][np.isfinite(values[rows])]) else None
            for values in (calls.peak_bytes, calls.above_idle_bytes)
        )
        peaks[kind.value] = PeakMemory(peak_bytes=peak, above_idle_bytes=above_idle)
        if details:
            drawn[kind.value] = _figures(calls, rows)
    method = METHOD if any(map(_measured, peaks.values())) else METHOD_UNAVAILABLE
    memory = MemoryScore(**peaks, method=method)
    return ScoredCalls(TimingScore(**timing), memory, CallDetails(**drawn) if details else None)


def score_target(calls: Calls, name: str) -> TargetScore:
    """Return the score of calls that were measured elsewhere, under that target's name.

    They stand apart from the host's figures, and neither is shown under the other's name.

    Args:
        calls: Calls as measured there.
        name: Name of the target.
    """
    parts = score_calls(calls, clock=name, details=False)
    memory = replace(parts.memory, method=f"as measured on {name}")
    measured = any(_measured(peaks) for kind in CallKind if (peaks := memory.of(kind)) is not None)
    return TargetScore(name=name, timing=parts.timing, memory=memory if measured else MemoryScore())


def _measured(peaks: PeakMemory) -> bool:
    return peaks.peak_bytes is not None or peaks.above_idle_bytes is not None


def stage_of(figure: str) -> str | None:
    """Return the name of the stage whose time a figure of a call is, None if it is none."""
    is_stage = figure.startswith(STAGE_PREFIX) and figure.endswith(STAGE_SUFFIX)
    return figure.removeprefix(STAGE_PREFIX).removesuffix(STAGE_SUFFIX) or None if is_stage else None


def _figures(calls: Calls, mine: Rows) -> CallFigures:
    """Return the calls for figures; of many calls the slowest of each block, so that no peak is hidden."""
    block = max(1, -(-len(mine) // SERIES_ROWS))
    chosen = []
    for first in range(0, len(mine), block):
        rows = mine[first : first + block]
        chosen.append(rows[np.argmax(np.nan_to_num(calls.seconds[rows], nan=-1.0))])
    series = CallSeries(
        slowest_of=block,
        stamp_ns=tuple(calls.stamps_ns[chosen].tolist()),
        processing_time_s=column(calls.seconds[chosen], None),
        peak_rss_bytes=column(calls.peak_bytes[chosen], None),
        state=tuple(calls.states[row] for row in chosen),
    )
    return CallFigures(histogram=call_histogram(calls.seconds[mine]), series=series)


def with_external(scored: ScoredCalls, node: ExternalScore) -> ScoredCalls:
    """Return scored calls with the clock of an external node's own times, and the memory of its processes.

    Its latency is not among them: it is not a time per call.
    """
    kind = CallKind(node.task)
    timing, memory = scored.timing, scored.memory
    if (calls := timing.of(kind)) is not None:
        timing = replace(timing, **{kind.value: replace(calls, clock=NODE_CLOCK)})
    told = memory.of(kind)
    if node.process is not None and (told is None or told.peak_bytes is None):
        others = [peaks for other in CallKind if other is not kind and (peaks := memory.of(other)) is not None]
        method = f"{kind}: {node.process.method}"
        if any(item.peak_bytes is not None for item in others):
            method += f"; others: {memory.method}"
        peaks = PeakMemory(peak_bytes=node.process.peak_rss_bytes, above_idle_bytes=None)
        memory = replace(memory, **{kind.value: peaks}, method=method)
    return replace(scored, timing=timing, memory=memory)

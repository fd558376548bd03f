"""Time, memory and completeness of the calls of a processing API [4.2.1, 4.2.2, 4.3.1, 4.3.2].

`metrics.calls.call_meter` measures the calls.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from msgspec.structs import asdict
from msgspec.structs import replace as replace_row
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted, printable
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.calls.call_meter import HOST_CLOCK, METHOD_UNAVAILABLE
from sfr_loc_map.metrics.completeness.expected_items import answers_completeness, calls_completeness
from sfr_loc_map.metrics.config import CallKind, MappingState
from sfr_loc_map.metrics.figures.details import CallHistogram, CallPlots, CallSeries, column
from sfr_loc_map.metrics.figures.records import CallRecords, ExternalScore, TargetRun
from sfr_loc_map.metrics.figures.results import CallsResult
from sfr_loc_map.metrics.figures.row_part import AFTER_FIRST, FIRST, Place, RowPart, calls_part
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import Scope, Subject
from sfr_loc_map.suite_names import Task

UNKNOWN_METHOD = "unknown"
OUTSIDE_CLOCK = "host monotonic, from publishing a pair to the answer"
STATED_BY_NODE = "stated by the node"  #: Clock and memory method of calls whose costs a node states.
STATE_KINDS: dict[str, CallKind] = {
    MappingState.MAPPED: CallKind.MAPPING,
    MappingState.FUSED: CallKind.FUSION,
    MappingState.MAPPED_SET: CallKind.MAPPING_CALL,
}
"""Kind of a mapping call by its state."""
LOCALISER_STATES = ("", "initialising", "tracking", "degraded", "lost")
"""States of a call of a localiser; empty for an unknown state (`localisation.estimate.TrackingState`)."""
KNOWN_STATES = (*LOCALISER_STATES, *STATE_KINDS)
KINDS_OF = {task: tuple(kind for kind in CallKind if kind.task is task) for task in Task}
"""Kinds of calls by their task."""
HOST_CLOCKS: Mapping[CallKind, str] = MappingProxyType(dict.fromkeys(CallKind, HOST_CLOCK))
"""Clock of each kind of call if all calls were measured on this host."""
HOST_PLACES: Mapping[CallKind, Place] = MappingProxyType(dict.fromkeys(CallKind, Place.HOST))
"""Place of each kind of call if all calls were measured on this host."""
USAGE_NAMES = ("cpu_s", "cpu_between_s", "threads", "processes")
"""Statistics of a call that state the usage of a method, measured from outside its processes."""
MAX_NUMBER = 1e18
"""Maximum magnitude of times, sizes, covariances and statistics of calls. Its square is finite."""
HISTOGRAM_BINS = 40
SERIES_ROWS = 2000  #: Maximum number of calls of each kind in plots.


@dataclass(frozen=True, slots=True, eq=False)
class Calls:
    """Calls in the order of their files, and in a file in chronological order."""

    stamps_ns: IntArray  #: `(N,)` int64, stamp of the pair.
    seconds: FloatArray  #: `(N,)` float64, wall-clock time, NaN if not measured.
    states: Sequence[str]  #: `(N,)` state of each call: initialising, tracking, degraded, lost; mapped, fused.
    peak_bytes: FloatArray  #: `(N,)` float64, peak resident memory, NaN if not measured.
    above_idle_bytes: FloatArray  #: `(N,)` float64, peak resident memory above the idle process, NaN if not measured.
    #: `(N,)` float64 by the name of the stage: time of the stage, NaN if the call does not have the stage.
    stage_s: Mapping[str, FloatArray] = field(default_factory=dict)
    heap_bytes: FloatArray | None = None  #: `(N,)` peak heap size, NaN if not measured; None if never measured.
    stack_bytes: FloatArray | None = None  #: `(N,)` peak stack depth, NaN if not measured; None if never measured.
    memory_method: str | None = None  #: Method of measuring memory, from the source of the calls; None if unknown.

    def __post_init__(self) -> None:
        """Check that each column has one entry for each call; MetricsError if not.

        MetricsError also if a state is unknown, or if a number is negative or infinite.
        """
        count = len(self.stamps_ns)
        if len(self.states) != count:
            raise MetricsError(f"{counted(count, 'call')} have {len(self.states)} states: one state each is required")
        for state in sorted(set(self.states).difference(KNOWN_STATES)):
            needed = f"one of {', '.join(filter(None, KNOWN_STATES))}, or an empty text, is required"
            raise MetricsError(f"the state of a call is '{state}': {needed}")
        names = ("seconds", "peak_bytes", "above_idle_bytes", "heap_bytes", "stack_bytes")
        columns = {name: getattr(self, name) for name in names}
        columns |= {f"stage_s[{name}]": seconds for name, seconds in self.stage_s.items()}
        for name, values in columns.items():
            if values is None:
                continue
            if np.shape(values) != (count,):
                needed = f"{(count,)} is required for {counted(count, 'call')}"
                raise MetricsError(f"'{name}' of calls has the shape {np.shape(values)}: {needed}")
            is_invalid = (values < 0.0) | np.isinf(values)
            if is_invalid.any():
                invalid = values[np.argmax(is_invalid)]
                raise MetricsError(f"'{name}' of a call is {invalid:g}: a finite number >= 0, or NaN, is required")

    @property
    def kinds(self) -> NDArray[np.object_]:
        """Kind `(N,)` of each call."""
        return np.array([STATE_KINDS.get(state, CallKind.LOCALISATION) for state in self.states], dtype=object)

    @property
    def is_localisation(self) -> Mask:
        """Whether each call `(N,)` is a call of a localiser."""
        return np.asarray(self.kinds == CallKind.LOCALISATION, np.bool_)


def concatenated(parts: Sequence[Calls]) -> Calls:
    """Return the calls of one or several files as calls of one run, in the order of the files."""
    counts = [len(part.stamps_ns) for part in parts]
    stages = dict.fromkeys(name for part in parts for name in part.stage_s)
    stage_s = {name: stacked([part.stage_s.get(name) for part in parts], counts) for name in stages}
    return Calls(
        np.concatenate([part.stamps_ns for part in parts]),
        np.concatenate([part.seconds for part in parts]),
        [state for part in parts for state in part.states],
        np.concatenate([part.peak_bytes for part in parts]),
        np.concatenate([part.above_idle_bytes for part in parts]),
        {name: values for name, values in stage_s.items() if values is not None},
        stacked([part.heap_bytes for part in parts], counts),
        stacked([part.stack_bytes for part in parts], counts),
        memory_method="; ".join(dict.fromkeys(part.memory_method for part in parts if part.memory_method)) or None,
    )


def stacked(parts: Sequence[FloatArray | None], counts: Sequence[int]) -> FloatArray | None:
    """Return the concatenated values of several files, NaN for a file without them; None if no file has them."""
    shape = next((part.shape[1:] for part in parts if part is not None), None)
    if shape is None:
        return None
    return np.concatenate(
        [np.full((count, *shape), np.nan) if part is None else part for part, count in zip(parts, counts, strict=True)]
    )


def score_calls(
    calls: Calls,
    expected_ns: Mapping[Task, IntArray | None],
    clock_of: Mapping[CallKind, str] = HOST_CLOCKS,
    place_of: Mapping[CallKind, Place] = HOST_PLACES,
    *,
    details: bool = True,
) -> CallsResult:
    """Return times, memory and completeness of calls. The kind of a call follows from its state.

    `expected_ns` has the stamps of the pairs that should have a call. `clock_of` and `place_of` state the clock and the
    place of the calls of each kind. Calls that an external node states have no completeness: for a node in a replay,
    its answers are counted instead (`answers_completeness`).
    """
    # a peak of 0 is unknown, because systems without the measurement report 0; above the idle process 0 is possible
    peak = np.where(calls.peak_bytes > 0.0, calls.peak_bytes, np.nan)
    above = np.where(np.isfinite(peak) | (calls.above_idle_bytes > 0.0), calls.above_idle_bytes, np.nan)
    measured = replace(calls, peak_bytes=peak, above_idle_bytes=above)
    kinds = calls.kinds
    times: list[Figure] = []
    peaks: list[Figure] = []
    completeness: list[Figure] = []
    clocks: dict[str, str] = {}
    plots: dict[str, CallPlots] = {}
    for kind in CallKind:
        mine = np.flatnonzero(kinds == kind)
        if not len(mine):
            continue
        place = place_of[kind]
        if np.isfinite(calls.seconds[mine]).any():
            clocks[kind.value] = clock_of[kind]
            times += time_rows(kind, place, calls.seconds[mine])
            times += deadline_rows(kind, place, calls.stamps_ns[mine], calls.seconds[mine])
            for name, values in sorted(calls.stage_s.items()):
                times += stage_rows(kind, place, name, values[mine])
        peaks += peak_rows(kind, place, measured, mine)
        if place is not Place.STATED:
            completeness += completeness_rows(kind, place, calls, mine, expected_ns.get(kind.task))
        if details:
            plots[kind.value] = plots_of(measured, mine)
    method = calls.memory_method if has_memory(peaks) else METHOD_UNAVAILABLE
    records = CallRecords(clocks=clocks, memory_method=method)
    return CallsResult(figures=(*times, *peaks, *completeness), records=records, plots=plots)


def has_memory(rows: Iterable[Figure]) -> bool:
    """Return whether memory was measured in any call."""
    return any(row.subject is Subject.MEMORY and row.value is not None for row in rows)


def completeness_rows(
    kind: CallKind, place: Place, calls: Calls, mine: NDArray[np.intp], expected_ns: IntArray | None
) -> Iterator[Figure]:
    """Yield the rows that compare the measured calls of a kind with the expected calls."""
    values = {Scope.CALLS: calls.seconds[mine]}
    if (memory := measured_memory(calls, mine)) is not None:
        values[Scope.MEMORY] = memory
    yield from calls_completeness(kind, calls.stamps_ns[mine], expected_ns, values, place)


def measured_memory(calls: Calls, mine: NDArray[np.intp]) -> FloatArray | None:
    """Return the peak memory of some calls, NaN for calls that lack a figure of memory that other calls have.

    None if no peak was measured. A peak of 0 is unknown, because systems without the measurement report 0.
    """
    peak = calls.peak_bytes[mine]
    if not np.isfinite(peak).any():
        return None
    known = np.where(peak > 0.0, peak, np.nan)
    for values in (calls.above_idle_bytes, calls.heap_bytes, calls.stack_bytes):
        if values is not None and np.isfinite(values[mine]).any():
            known = np.where(np.isfinite(values[mine]), known, np.nan)
    return known


def time_rows(kind: CallKind, place: Place, seconds: FloatArray) -> Iterator[Figure]:
    """Yield the rows of the times of calls. `seconds` `(N,)` is in the order of the calls, NaN if not measured.

    The first call has a separate row, because it may load libraries.
    """
    known = seconds[np.isfinite(seconds)]
    yield figure_row(kind, part=None if place is Place.HOST else place, statistics=formulas.statistics(known))
    yield figure_row(kind, part=FIRST.at(place), n=1, value=float(known[0]))
    if len(known) > 1:
        yield figure_row(kind, part=AFTER_FIRST.at(place), statistics=formulas.statistics(known[1:]))


def deadline_rows(kind: CallKind, place: Place, stamps_ns: IntArray, seconds: FloatArray) -> Iterator[Figure]:
    """Yield the period of the pairs, the fraction of calls within the period, and the mean time divided by the period.

    The period is the median difference of the stamps. There are no rows for calls without stamps or for mapping calls.
    """
    apart_s = np.diff(np.unique(stamps_ns)) / NS_PER_S
    known = seconds[np.isfinite(seconds)]
    if kind is not CallKind.LOCALISATION or not len(apart_s):
        return
    part = calls_part("", kind, place)
    period_s = float(np.median(apart_s))
    yield figure_row("period", part=part, n=len(apart_s), value=period_s)
    yield figure_row("within_period", part=part, n=len(known), value=float(np.mean(known <= period_s)))
    yield figure_row("processor_share", part=part, n=len(known), value=float(np.mean(known)) / period_s)


def stage_rows(kind: CallKind, place: Place, stage: str, seconds: FloatArray) -> Iterator[Figure]:
    """Yield the row of one stage over the calls that have the stage."""
    known = seconds[np.isfinite(seconds)]
    if len(known):
        yield figure_row(kind, part=RowPart(stage).at(place), statistics=formulas.statistics(known))


def peak_rows(kind: CallKind, place: Place, calls: Calls, mine: NDArray[np.intp]) -> Iterator[Figure]:
    """Yield the rows of the peak memory of some calls; resident memory always has rows, null if not measured."""
    part = calls_part("", kind, place)
    for name, values in (
        ("peak", calls.peak_bytes),
        ("above_idle", calls.above_idle_bytes),
        ("heap_peak", calls.heap_bytes),
        ("stack_peak", calls.stack_bytes),
    ):
        known = np.empty(0) if values is None else values[mine][np.isfinite(values[mine])]
        if len(known) or name in ("peak", "above_idle"):
            yield figure_row(name, part=part, n=len(known), value=int(known.max()) if len(known) else None)


def plots_of(calls: Calls, mine: NDArray[np.intp]) -> CallPlots:
    """Return the data of the plots of some calls."""
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
    return CallPlots(histogram=histogram, series=series)


def score_target(
    calls: Calls,
    name: str,
    expected_ns: Mapping[Task, IntArray | None],
    estimate_ns: IntArray | None = None,
    *,
    has_stamps: bool = False,
    other_run: str | None = None,
) -> tuple[tuple[Figure, ...], TargetRun]:
    """Return the rows, at the place `target`, of calls that were measured on a target, and the record of the target.

    Every stamp of a localisation call must be a stamp of the estimate; otherwise MetricsError, unless `other_run` names
    the run of the calls.
    """
    matched = None
    if has_stamps and estimate_ns is not None and len(estimate_ns):
        localised = calls.stamps_ns[calls.is_localisation]
        matched = float(np.isin(estimate_ns, localised).mean())
        if len(localised) and not np.isin(localised, estimate_ns).all() and other_run is None:
            raise MetricsError(
                f"the times of {name} belong to another run: {np.count_nonzero(~np.isin(localised, estimate_ns))} of "
                f"{len(localised)} stamps are not in the estimate; name that run by the option target_run"
            )
    on_target = dict.fromkeys(CallKind, Place.TARGET)
    expected_ns = expected_ns if has_stamps else {}  # calls without stamps cannot be assigned to pairs
    scored = score_calls(calls, expected_ns, dict.fromkeys(CallKind, name), on_target, details=False)
    is_measured = has_memory(scored.figures)
    figures = [row for row in scored.figures if row.subject is not Subject.MEMORY or is_measured]
    method = (calls.memory_method or f"as measured on {name}") if is_measured else None
    return tuple(figures), TargetRun(name=name, matched_share=matched, other_run=other_run, memory_method=method)


def statistic_range(name: str) -> tuple[float, float]:
    """Return the lowest and highest valid number of a statistic of a call. Times of stages and usage are at least 0."""
    is_unsigned = stage_of(name) is not None or name in USAGE_NAMES
    return 0.0 if is_unsigned else -MAX_NUMBER, MAX_NUMBER


def is_statistic(name: str, value: float) -> bool:
    """Return whether a number is valid for a statistic of a call; the name must be printable."""
    low, high = statistic_range(name)
    return low <= value <= high and printable(name) == name


def stage_of(figure: str) -> str | None:
    """Return NAME for a figure `stage_NAME_s`, the time of a stage of a call; None for other figures.

    The name is in quotes if a part of a row has another meaning by this name, such as `target` or `first call`.
    """
    found = re.fullmatch(r"stage_(.+)_s", figure)
    if found is None:
        return None
    name = found[1]
    is_reserved = name in (FIRST, AFTER_FIRST) or RowPart(name).what != name
    return f"'{name}'" if is_reserved else name


def with_external(scored: CallsResult, node: ExternalScore) -> CallsResult:
    """Return scored calls with time, memory and completeness of an external node as measured from outside.

    Times and memory that the node states for its own calls are at the place `stated` and cannot be limited.
    """
    kind, records = CallKind(node.task), scored.records or CallRecords()
    kinds = KINDS_OF[Task(node.task)]
    measured = list[Figure]()
    clocks = {name: clock for name, clock in records.clocks.items() if name not in kinds}
    if node.latency_s is not None:
        measured.append(figure_row(kind, **asdict(node.latency_s)))
        clocks[kind.value] = OUTSIDE_CLOCK
    method = records.memory_method
    if node.process is not None:
        measured.append(figure_row("peak", part=kind, value=node.process.peak_rss_bytes or None))
        others = any(row.figure == "peak" and row.call not in kinds and row.value is not None for row in scored.figures)
        method = f"{kind}: {node.process.method}"
        if others:
            method += f"; others: {records.memory_method or UNKNOWN_METHOD}"
    records = replace_row(records, clocks=clocks, memory_method=method)
    figures = (*measured, *scored.figures, *answers_completeness(node))
    return replace(scored, figures=figures, records=records)

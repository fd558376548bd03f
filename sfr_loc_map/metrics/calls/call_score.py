"""Time, memory and completeness of the calls of a processing API [4.2.1, 4.2.2, 4.3.1, 4.3.2].

`score_calls` scores calls whose times and memory are given, `score_target` those that were measured on a target, and
`with_external` adds what was measured from outside of an external node.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from msgspec.structs import asdict
from msgspec.structs import replace as replace_row
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.calls.call_meter import HOST_CLOCK, METHOD_UNAVAILABLE
from sfr_loc_map.metrics.calls.calls import KINDS_OF, Calls
from sfr_loc_map.metrics.completeness.expected_items import answers_completeness, calls_completeness
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.details import CallHistogram, CallPlots, CallSeries, column
from sfr_loc_map.metrics.figures.records import CallRecords, ExternalScore, TargetRun
from sfr_loc_map.metrics.figures.results import CallsResult
from sfr_loc_map.metrics.figures.row_part import AFTER_FIRST, FIRST, Place, RowPart, calls_part
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import Scope, Subject
from sfr_loc_map.suite_names import Task

OUTSIDE_CLOCK = "host monotonic, from publishing a pair to the answer"
STATED_BY_NODE = "stated by the node"  #: Clock and memory method of calls whose costs a node states.
HISTOGRAM_BINS = 40  #: Number of bins of the histogram of times.
SERIES_ROWS = 2000  #: Maximum number of calls of each kind in plots.


class Measurement(NamedTuple):
    """How the times and the memory of the calls of one kind were measured."""

    place: Place
    clock: str  #: Name of the clock.


ON_HOST = Measurement(Place.HOST, HOST_CLOCK)


def score_calls(
    calls: Calls,
    expected_ns: Mapping[Task, IntArray | None],
    measured_by: Mapping[CallKind, Measurement] | None = None,
    *,
    details: bool = True,
) -> CallsResult:
    """Return times, memory and completeness of calls. The kind of a call follows from its state.

    `expected_ns` has the stamps of the pairs that should have a call. `measured_by` states how each kind of call was
    measured; None if all calls were measured on this host. Calls that an external node states have no completeness: for
    a node in a replay, its answers are counted instead (`answers_completeness`).
    """
    measurement_of = dict.fromkeys(CallKind, ON_HOST) if measured_by is None else measured_by
    measured = with_known_memory(calls)
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
        place, clock = measurement_of[kind]
        if np.isfinite(calls.seconds[mine]).any():
            clocks[kind.value] = clock
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


def with_known_memory(calls: Calls) -> Calls:
    """Return calls whose unknown memory is NaN instead of 0.

    Systems without the measurement report 0. A peak of 0 is therefore unknown. Other memory can be 0 in single calls.
    It is unknown if it is 0 in all calls and the calls do not state how memory was measured. Memory above the idle
    process is also unknown if it is 0 and the peak is unknown.
    """
    peak = np.where(calls.peak_bytes > 0.0, calls.peak_bytes, np.nan)
    above = np.where(np.isfinite(peak) | (calls.above_idle_bytes > 0.0), calls.above_idle_bytes, np.nan)
    known = replace(calls, peak_bytes=peak, above_idle_bytes=above)
    if calls.memory_method is not None:
        return known
    heap, stack = (None if values is None else _unless_zero(values) for values in (calls.heap_bytes, calls.stack_bytes))
    return replace(known, above_idle_bytes=_unless_zero(above), heap_bytes=heap, stack_bytes=stack)


def _unless_zero(values: FloatArray) -> FloatArray:
    """Return memory of calls, NaN if none of it exceeds 0."""
    return values if (values > 0.0).any() else np.full_like(values, np.nan)


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
    on_target = dict.fromkeys(CallKind, Measurement(Place.TARGET, name))
    expected_ns = expected_ns if has_stamps else {}  # calls without stamps cannot be assigned to pairs
    scored = score_calls(calls, expected_ns, on_target, details=False)
    is_measured = has_memory(scored.figures)
    figures = [row for row in scored.figures if row.subject is not Subject.MEMORY or is_measured]
    method = (calls.memory_method or f"as measured on {name}") if is_measured else None
    return tuple(figures), TargetRun(name=name, matched_share=matched, other_run=other_run, memory_method=method)


def with_external(scored: CallsResult, node: ExternalScore) -> CallsResult:
    """Return scored calls with time, memory and completeness of an external node as measured from outside.

    Times and memory that the node states for its own calls are at the place `stated` and cannot be limited.
    """
    kind = CallKind(node.task)
    kinds = KINDS_OF[Task(node.task)]
    records = scored.records or CallRecords()
    measured: list[Figure] = []
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
            method += f"; others: {records.memory_method or 'unknown'}"
    records = replace_row(records, clocks=clocks, memory_method=method)
    figures = (*measured, *scored.figures, *answers_completeness(node))
    return replace(scored, figures=figures, records=records)

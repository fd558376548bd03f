"""Records of the calls of localiser and mapper: as JSON on `<node>/call`, and as CSV file of a run (`--stats`)."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import MAX_TEXT_BYTES, Task, read_table_text, refusing
from sfr_loc_map.io.tables.stamps import parse_stamp_ns
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.metrics.association import UPPER, Estimates, lost_by_covariance
from sfr_loc_map.metrics.call_meter import METHOD, CallUsage
from sfr_loc_map.metrics.calls import Calls, concatenated, stacked, stage_of
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.consistency import STEP_SIZE, WITHOUT_NOISE
from sfr_loc_map.metrics.records import FindingKind, FindingRecord, MethodKind, MethodRecord, ProcessUsage

if TYPE_CHECKING:
    from sfr_loc_map.mapping.maps import FusedMap

COVARIANCE_NAMES = tuple(f"cov_{i}{j}" for i, j in zip(*UPPER, strict=True))
STEP_NAMES = (
    *(f"step_{name}" for name in COVARIANCE_NAMES),
    *(f"systematic_cov_{i}" for i in range(6)),
    *(f"noise_{name}" for name in COVARIANCE_NAMES),
)
METHOD_FIELDS = ("version", "kind", "sha256", "config_sha256", "isolation")  #: Of a `MethodRecord`, in order.
METHOD_NAMES = ("method", *(f"method_{name}" for name in METHOD_FIELDS), "finding")
HEADER = ("stamp_ns", "processing_time_s", "state", "reason", "peak_rss_bytes", "above_idle_bytes")
POSITION_NAMES = ("position_x_m", "position_y_m", "position_z_m")
"""Columns of the estimated position of a call. The positions identify the estimate to which the calls belong."""
MEMORY_METHOD = "memory_method"  #: Column that states how memory was measured.
COSTS = ("processing_time_s", "peak_rss_bytes", "above_idle_bytes", "heap_peak_bytes", "stack_peak_bytes")
TAKEN = ("cpu_s", "cpu_between_s", "threads", "processes")  #: Usage of a method, measured from outside its processes.
ADAPTER_S = 0.015  #: Processor time of a method's adapter per call, s, with the resolution of 0.01 s.
TREE = "of the method's processes and all that they started, at each call, from outside (psutil)"
STATES_OF: dict[Task, tuple[str, ...]] = {Task.LOCALISATION: tuple(TrackingState), Task.MAPPING: tuple(MappingState)}
STATES = (*TrackingState, *MappingState)
WORST_LAST = {TrackingState.DEGRADED.value: 1, TrackingState.LOST.value: 2}  #: Severity of states; 0 for others.
DEFAULT_STATE = {Task.LOCALISATION: "", Task.MAPPING: MappingState.MAPPED.value}
"""State of a call, by task, if an external node reports none; the state of a localiser is then unknown."""
MAX_CALL_S = 1e6
STATS_SUFFIX = ".stats.csv"  #: Suffix of a file of calls, which replaces the suffix of the result.
Bytes = Annotated[int, Meta(ge=0, le=2**63 - 1)]
MAX_NUMBER = 1e18  #: Limit of times, sizes and covariances in a file; its square is finite.


@dataclass(frozen=True, slots=True, eq=False)
class CallRecord:
    """One call of localiser or mapper; `encode_call` and `decode_call` convert it for `<node>/call`."""

    stamp_ns: Annotated[int, Meta(ge=0, le=2**63 - 1)]  #: Stamp of the pair; for a fused cloud, of its last pair.
    processing_time_s: Annotated[float, Meta(ge=0.0, le=MAX_CALL_S)]  #: Wall-clock time; NaN: not measured.
    state: str = ""  #: State after the call: initialising, tracking, degraded, lost; mapped, fused, mapped_set.
    #: Peak resident memory of the process during the call; None if it cannot be measured.
    peak_rss_bytes: Bytes | None = None
    above_idle_bytes: Bytes | None = None  #: Peak above the memory of the idle process.
    statistics: Mapping[str, float] = field(default_factory=dict)  #: Statistics of the call by name.
    covariance: FloatArray | None = None  #: `(6, 6)` of the pose (ROS order), None for mapping.
    reason: str = ""  #: Why the pose is degraded or lost, in one word.
    #: `(48,)`: upper triangle of the covariance of the motion since the previous pose, in RB at that pose (21); one
    #: standard deviation of the error that all motions share (6); upper triangle of the pose noise (21). None: unknown.
    step: FloatArray | None = None
    finding: str = ""  #: Error of the method in this call, `KIND: text`.
    pair_stamps_ns: tuple[int, ...] = ()  #: Stamps of the pairs of a fused cloud, in the order of the points' `pair`.
    fused: bool | None = None  #: Whether the cloud contains each surface once; None if the mapper does not report it.
    #: Times around the call, s: decoding, latencies. `times` and `counts` are shown live but not written to files.
    times: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)  #: Messages dropped since the start, by cause.
    version: str = ""  #: Version of the method, if a node reports it.
    task: Task = field(default=Task.LOCALISATION, kw_only=True)  #: Task of the node that made the call.

    def __post_init__(self) -> None:
        """Reject a state of the other task."""
        (other,) = set(Task) - {self.task}
        if self.state in STATES_OF[other]:
            raise ValueError(f"state is '{self.state}': one of {', '.join(STATES_OF[self.task])} is required")

    @property
    def outcome(self) -> str:
        """State after the call with its reason, for display."""
        return f"{self.state}: {self.reason}" if self.reason else self.state

    @property
    def is_fused(self) -> bool:
        """Whether the cloud of a fusion contains each surface once; true by default for several pairs."""
        return len(self.pair_stamps_ns) > 1 if self.fused is None else self.fused


@dataclass(frozen=True, slots=True, eq=False)
class CallStats:
    """Calls as columns, as in the CSV file."""

    calls: Calls
    covariance: FloatArray | None  # `(N, 21)` upper triangles, NaN if unknown; None if all are unknown
    steps: FloatArray | None  # `(N, 48)` steps between the poses; NaN and None as above
    method: MethodRecord | None = None  # None if unknown
    findings: tuple[FindingRecord, ...] = ()  # errors of the method, one record for each kind
    processes: ProcessUsage | None = None  # usage of the method's processes; None if not measured
    positions: FloatArray | None = None  # `(N, 3)` estimated positions of the calls, NaN without estimate
    has_stamps: bool = True  # whether the calls have stamps; otherwise they are numbered

    @property
    def localised_ns(self) -> IntArray:
        """Stamps of the calls of a localiser; calls of a mapper may have the same stamps."""
        return self.calls.stamps_ns[self.calls.is_localisation]

    def has_task(self, task: Task) -> bool:
        """Return whether there is a call of a task."""
        is_localisation = self.calls.is_localisation
        return bool((is_localisation if task is Task.LOCALISATION else ~is_localisation).any())

    def localised_rows(self, stamps_ns: IntArray) -> NDArray[np.intp]:
        """Return the row of the call of a localiser for each stamp, -1 where there is no call.

        If several calls have one stamp, the row is that of the worst state; for equal states, that of the last call.
        """
        rows = np.flatnonzero(self.calls.is_localisation)
        severity = np.array([WORST_LAST.get(self.calls.states[row], 0) for row in rows.tolist()], np.intp)
        order = np.lexsort((severity, self.calls.stamps_ns[rows]))  # stable
        rows = np.append(-1, rows[order])
        called_ns = self.calls.stamps_ns[rows[1:]]
        last = np.searchsorted(called_ns, stamps_ns, "right")
        is_called = np.isin(stamps_ns, called_ns)
        return rows[np.where(is_called, last, 0)]


def estimates_of(trajectory: Trajectory, stats: CallStats | None, covariance: FloatArray | None = None) -> Estimates:
    """Return the poses with the states, covariances and steps that calls and published covariances report.

    `covariance` `(N, 21)` has the upper triangles that were published with the poses. The covariance of a pose is the
    published one, or that of its call if none is published (`is_covariance_reported`). A pose is lost if the state of
    its call or its covariance reports a loss.
    """
    states = np.full(len(trajectory), "", object)
    steps = of_calls = None
    if stats is not None:
        rows = stats.localised_rows(trajectory.stamps_ns)
        states = np.array([*stats.calls.states, ""], object)[rows]
        steps = _steps_between(trajectory.stamps_ns, stats, rows)
        of_calls = _values_at(stats.covariance, rows)
    covariance = _first_reported(covariance, of_calls)
    lost, degraded = states == TrackingState.LOST, states == TrackingState.DEGRADED
    is_known = np.asarray(states != "", np.bool_)
    is_lost_known = is_known
    if covariance is not None:
        lost = lost | lost_by_covariance(covariance)
        is_lost_known = is_known | np.isfinite(covariance).all(axis=1)
    estimates = Estimates.of(trajectory, lost, degraded, covariance, steps)
    return replace(estimates, is_lost_known=is_lost_known, is_degraded_known=is_known)


def _values_at(values: FloatArray | None, rows: NDArray[np.intp]) -> FloatArray | None:
    """Return rows of an array `(N, K)`; the row -1 is NaN."""
    return None if values is None else np.vstack((values, np.full(values.shape[1], np.nan)))[rows]


def is_covariance_reported(covariance: FloatArray) -> NDArray[np.bool_]:
    """Return which covariances `(N, 21)` are reported. Zeros, the default of ROS messages, and NaN are not reports."""
    return np.asarray((np.nan_to_num(covariance) != 0.0).any(axis=1))


def published_or_of_call(published: FloatArray | None, call: CallRecord) -> FloatArray | None:
    """Return the covariance `(6, 6)` of a pose by the rule of `estimates_of`: the published one, else that of its call.

    None if neither is reported.
    """
    for covariance in (published, call.covariance):
        if covariance is not None and is_covariance_reported(covariance[None, *UPPER])[0]:
            return covariance
    return None


def _first_reported(first: FloatArray | None, second: FloatArray | None) -> FloatArray | None:
    """Return the first reported covariance of each row, NaN in rows without one; None if none is reported."""
    found: FloatArray | None = None
    for covariance in (second, first):
        if covariance is None or not (is_reported := is_covariance_reported(covariance)).any():
            continue
        otherwise = np.full_like(covariance, np.nan) if found is None else found
        found = np.where(is_reported[:, None], covariance, otherwise)
    return found


def _steps_between(stamps_ns: IntArray, stats: CallStats, rows: NDArray[np.intp]) -> FloatArray | None:
    """Return the steps `(N, 48)` to poses from the rows of their calls; NaN if the previous pose is missing."""
    steps = _values_at(stats.steps, rows)
    if steps is None or stats.steps is None:
        return None
    has_step = stats.calls.is_localisation & np.isfinite(stats.steps).all(axis=1)
    stepped_ns = np.unique(stats.calls.stamps_ns[has_step])
    own_ns = np.unique(stamps_ns)
    steps_until = np.searchsorted(stepped_ns, own_ns, "right")
    has_gap = np.diff(steps_until) > np.isin(own_ns[1:], stepped_ns)
    steps[np.isin(stamps_ns, own_ns[1:][has_gap])] = np.nan
    return steps


def united(parts: Sequence[CallStats]) -> CallStats:
    """Return the calls of one or more files of one run, with covariances and steps but without the other fields."""
    counts = [len(part.calls.stamps_ns) for part in parts]
    covariance = stacked([part.covariance for part in parts], counts)
    steps = stacked([part.steps for part in parts], counts)
    return CallStats(concatenated([part.calls for part in parts]), covariance, steps)


def stats_of(
    records: Sequence[CallRecord], method: MethodRecord | None = None, estimate: Trajectory | None = None
) -> CallStats:
    """Return one or more calls as columns, with the positions that the estimate of the same run has at their stamps."""

    def numbers(values: Iterable[float | None]) -> FloatArray:
        return np.array([np.nan if value is None else value for value in values], np.float64)

    def rows(values: list[FloatArray | None], width: int) -> FloatArray:
        return np.array([np.full(width, np.nan) if value is None else value for value in values])

    names = sorted({name for record in records for name in record.statistics})
    stages = {stage: numbers(r.statistics.get(name) for r in records) for name in names if (stage := stage_of(name))}
    calls = Calls(
        np.array([record.stamp_ns for record in records], np.int64),
        numbers(record.processing_time_s for record in records),
        [record.state for record in records],
        numbers(record.peak_rss_bytes for record in records),
        numbers(record.above_idle_bytes for record in records),
        stages,
        memory_method=METHOD,
    )
    covariances = [None if record.covariance is None else record.covariance[UPPER] for record in records]
    steps = [record.step for record in records]
    findings = findings_of([record.finding for record in records], calls.stamps_ns.tolist())
    taken = [numbers(record.statistics.get(name) for record in records) for name in TAKEN]
    about = (method, findings, _processes(taken, calls))
    positions = None
    if estimate is not None and len(estimate):
        given = _positions_of(estimate)
        positions = np.array([given.get(record.stamp_ns, [np.nan] * len(POSITION_NAMES)) for record in records])
    if all(item is None for item in (*covariances, *steps)):
        return CallStats(calls, None, None, *about, positions)
    return CallStats(calls, rows(covariances, len(COVARIANCE_NAMES)), rows(steps, STEP_SIZE), *about, positions)


def _positions_of(estimate: Trajectory) -> dict[int, list[float]]:
    """Return the positions of an estimate by stamp."""
    return dict(zip(estimate.stamps_ns.tolist(), estimate.positions.tolist(), strict=True))


def _processes(taken: Sequence[FloatArray], calls: Calls) -> ProcessUsage | None:
    """Return the usage of the processes of a method in all calls, from the columns of TAKEN."""
    known = np.isfinite(taken[0]) & np.isfinite(taken[1])
    if not known.any():
        return None
    cpu_s, between_s, threads, processes = (np.nan_to_num(values[known]) for values in taken)
    within_s = threads * np.nan_to_num(calls.seconds[known]) + ADAPTER_S
    return ProcessUsage(
        cpu_s=float(cpu_s.sum() + between_s.sum()),
        cpu_outside_s=float(between_s.sum() + np.maximum(cpu_s - within_s, 0.0).sum()),
        peak_rss_bytes=int(np.nanmax(np.append(calls.peak_bytes, 0.0))),
        processes=int(processes.max()),
        threads=int(threads.max()),
        method=TREE,
    )


def call_of_stages(stages: Sequence[CallRecord | CallUsage], seconds: float | None = None) -> CallUsage:
    """Return the usage of a mapping call from its stages; without `seconds`, its time is the sum of their times."""
    peak, above_idle = (
        max((value for value in values if value is not None), default=None)
        for values in zip(*((item.peak_rss_bytes, item.above_idle_bytes) for item in stages), strict=True)
    )
    total = sum(item.processing_time_s for item in stages) if seconds is None else seconds
    return CallUsage(total, peak, above_idle)


def call_of_estimate(
    estimate: PoseEstimate, usage: CallUsage, more: Mapping[str, float] = MappingProxyType({})
) -> CallRecord:
    """Return the record of the localiser's call that gave an estimate, with further statistics."""
    step = None if estimate.step is None else estimate.step.uncertainty
    about = (estimate.figures | dict(more), estimate.covariance, estimate.reason_text, step)
    return CallRecord(estimate.stamp_ns, *usage.cost(estimate.state), *about)


def call_of_fusion(fused: FusedMap, stamps_ns: Sequence[int], usage: CallUsage, state: MappingState) -> CallRecord:
    """Return the record of a mapper's call that fused pairs; `stamps_ns` is in the order of the points' `pair`."""
    call = CallRecord(stamps_ns[-1], *usage.cost(state), fused.statistics, task=Task.MAPPING)
    return replace(call, pair_stamps_ns=tuple(stamps_ns), fused=fused.cloud.fused)


def stats_beside(result: Path) -> Path:
    """Return the default file of the calls that gave a result, which is beside the result."""
    return result.with_suffix(STATS_SUFFIX)


def save_stats(
    path: Path, records: Sequence[CallRecord], method: MethodRecord | None = None, estimate: Trajectory | None = None
) -> None:
    """Write one row per call; with a method each row names the method and its error in the call.

    With an estimate each row has the estimated position.
    """
    given = {} if estimate is None else _positions_of(estimate)
    named: tuple[str, ...] = ()
    if method is not None:
        named = (method.name, *(getattr(method, field) or "" for field in METHOD_FIELDS))
    names = sorted({name for record in records for name in record.statistics})
    # statistics of a method must not replace measured columns
    taken = {*HEADER, *COSTS, *METHOD_NAMES, *POSITION_NAMES, *COVARIANCE_NAMES, *STEP_NAMES, MEMORY_METHOD}
    told = [f"statistics.{name}" if name in taken else name for name in names]
    with_pose = any(record.covariance is not None for record in records)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        pose_names = (*COVARIANCE_NAMES, *STEP_NAMES) if with_pose else ()
        position_names = POSITION_NAMES if given else ()
        names_of_method = METHOD_NAMES if named else ()
        writer.writerow([*HEADER, MEMORY_METHOD, *names_of_method, *position_names, *told, *pose_names])
        for record in records:
            row = [record.stamp_ns, repr(record.processing_time_s), record.state, record.reason]
            row += ["" if item is None else item for item in (record.peak_rss_bytes, record.above_idle_bytes)]
            row.append("" if record.peak_rss_bytes is None else METHOD)
            row += [*named, record.finding] if named else []
            position = given.get(record.stamp_ns)
            row += [""] * len(position_names) if position is None else map(repr, position)
            figures = (record.statistics.get(name) for name in names)
            row += ["" if value is None else repr(float(value)) for value in figures]
            if record.covariance is not None:
                row += map(repr, record.covariance[UPPER].tolist())
                row += [""] * STEP_SIZE if record.step is None else map(repr, record.step.tolist())
            writer.writerow(row)


def load_call_stats(path: Path, needed: str = "stamp_ns") -> CallStats:
    """Read a file with the needed column and a figure of calls. Without `stamp_ns` the calls are numbered."""
    advice = "give a CSV with one row for each call"
    with refusing(f"cannot read '{path}'", advice):
        rows = list(csv.DictReader(io.StringIO(read_table_text(path, advice), newline="")))
    if not rows or needed not in rows[0] or rows[0].keys().isdisjoint(("state", *COSTS, COVARIANCE_NAMES[0])):
        found = ", ".join(list(rows[0])[:5]) if rows else "no row"
        text = f"statistics '{path}' need at least one row, and columns {needed} and state, processing_time_s or cov_00"
        raise InputError(f"{text}: found {found}")
    stamps_ns = np.arange(len(rows), dtype=np.int64)
    if "stamp_ns" in rows[0]:
        with refusing(f"statistics '{path}': a stamp is not an integer number of nanoseconds"):
            stamps_ns = np.array([parse_stamp_ns(row["stamp_ns"] or "") for row in rows], np.int64)
    states = [row.get("state") or "" for row in rows]
    for number, state in enumerate(states, 2):
        if state and state not in STATES:
            raise InputError(
                f"statistics '{path}' line {number}: state is '{state}', must be one of {', '.join(STATES)} or empty"
            )
    seconds, peak, above_idle, heap, stack = (_column(path, rows, name) for name in COSTS)
    seconds[seconds == 0.0] = np.nan  # zero: the time is unknown
    stages = {stage: _column(path, rows, name) for name in rows[0] if (stage := stage_of(name or ""))}
    covariance = _columns(path, rows, COVARIANCE_NAMES, COVARIANCE_NAMES)
    steps = _columns(path, rows, STEP_NAMES, STEP_NAMES[:WITHOUT_NOISE])
    if steps is not None and STEP_NAMES[-1] not in rows[0]:
        steps[:, WITHOUT_NOISE:] = 0.0
    method = None
    if name := rows[0].get("method"):
        about = {field: rows[0].get(f"method_{field}") or None for field in METHOD_FIELDS}
        kind = about["kind"]
        if kind not in set(MethodKind):
            given, known = kind or "", ", ".join(MethodKind)
            raise InputError(f"statistics '{path}': method_kind is '{given}', must be one of {known}")
        method = msgspec.convert({"name": name, **about}, MethodRecord)
    findings = findings_of([row.get("finding") or "" for row in rows], stamps_ns.tolist())
    memory_method = next(filter(None, (row.get(MEMORY_METHOD) for row in rows)), None)
    calls = Calls(stamps_ns, seconds, states, peak, above_idle, stages, heap, stack, memory_method)
    taken = [_column(path, rows, name) for name in TAKEN] if TAKEN[1] in rows[0] else None
    usage = None if taken is None else _processes(taken, calls)
    positions = _columns(path, rows, POSITION_NAMES, POSITION_NAMES)
    return CallStats(calls, covariance, steps, method, findings, usage, positions, has_stamps="stamp_ns" in rows[0])


def _columns(
    path: Path, rows: list[dict[str, str]], names: Sequence[str], required: Sequence[str]
) -> FloatArray | None:
    """Return columns `(N, names)`; None unless all required columns exist."""
    if not rows[0].keys() >= set(required):
        return None
    return np.column_stack([_column(path, rows, name) for name in names])


def _column(path: Path, rows: list[dict[str, str]], name: str) -> FloatArray:
    values, low = np.full(len(rows), np.nan), -MAX_NUMBER if "cov_" in name or name in POSITION_NAMES else 0.0
    for number, row in enumerate(rows):
        text = row.get(name)
        if not text:
            continue
        try:
            values[number] = float(text)
        except ValueError as error:
            raise InputError(
                f"statistics '{path}' line {number + 2}: {name} is '{text}', which is not a number"
            ) from error
    wrong = ~np.isnan(values) & ~((values >= low) & (values <= MAX_NUMBER))
    if wrong.any():
        number = int(np.argmax(wrong))
        raise InputError(
            f"statistics '{path}' line {number + 2}: {name} is {values[number]:g}, but must be "
            f"{low:g} to {MAX_NUMBER:g}, or empty if not measured"
        )
    return values


def findings_of(texts: Sequence[str], stamps_ns: Sequence[int]) -> tuple[FindingRecord, ...]:
    """Return the errors of a method, one for each kind, from the `KIND: text` of each call; other texts are ignored."""
    counted: dict[FindingKind, FindingRecord] = {}
    for text, stamp_ns in zip(texts, stamps_ns, strict=True):
        word, _, rest = text.partition(": ")
        if word in set(FindingKind):
            kind = FindingKind(word)
            first = counted.get(kind) or FindingRecord(kind=kind, count=0, first_stamp_ns=stamp_ns, text=rest)
            counted[kind] = msgspec.structs.replace(first, count=first.count + 1)
    return tuple(counted.values())


def encode_call(record: CallRecord) -> str:
    """Return a call as JSON; numbers have the shortest form that is exact when read back."""
    finite = {name: float(value) for name, value in record.statistics.items() if math.isfinite(value)}
    return msgspec.json.encode(replace(record, statistics=finite), enc_hook=_to_plain).decode()


def decode_call(text: str, task: Task) -> CallRecord:
    """Return the call in the JSON of a node; `task` is the task of the topic, and determines the default state.

    InputError if a key is missing or a value has another type or range.
    """
    with refusing(f"call of {task}", "publish a JSON object with stamp_ns and processing_time_s for each call"):
        if len(text) > MAX_TEXT_BYTES:
            raise ValueError(f"{len(text)} characters: at most {MAX_TEXT_BYTES} are allowed")
        content = {"task": task, **msgspec.json.decode(text, type=dict[str, Any])}
        record = msgspec.convert(content, CallRecord, dec_hook=_from_plain)
        if record.task is not task:
            raise ValueError(f"task is '{record.task}': '{task}' is required on this topic")
        if record.state not in ("", *STATES_OF[task]):
            raise ValueError(f"state is '{record.state}': one of {', '.join(STATES_OF[task])} is required")
        for name, value, shape in (("step", record.step, (STEP_SIZE,)), ("covariance", record.covariance, (6, 6))):
            if value is not None and (value.shape != shape or not np.isfinite(value).all()):
                raise ValueError(f"'{name}' has the shape {value.shape}: finite numbers of shape {shape} are required")
    return record if record.state else replace(record, state=DEFAULT_STATE[task])


def _to_plain(value: Any) -> Any:  # noqa: ANN401 - an array or a number of NumPy
    return value.tolist()


def _from_plain(kind: type[Any], value: Any) -> FloatArray:  # noqa: ANN401 - JSON
    return np.array(value, np.float64)

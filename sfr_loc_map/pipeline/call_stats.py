"""Calls of localiser and mapper: one record each, their CSV file, and their status on /diagnostics."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.inputs import read_table
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.text_numbers import parse_stamp_ns
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.calls import Calls, stage_of
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.consistency import STEP_SIZE
from sfr_loc_map.metrics.method_record import FindingKind, FindingRecord, MethodKind, MethodRecord


@dataclass(frozen=True, slots=True)
class CallRecord:
    """One call of a processing API.

    Attributes:
        stamp_ns: Stamp of the pair.
        processing_time_s: Wall-clock time of the call on this host.
        state: State after the call: initialising, tracking, degraded, lost; mapped, fused.
        peak_rss_bytes: Peak resident memory of the process during the call, None where it cannot be measured.
        above_idle_bytes: The same above the idle process, None where it cannot be measured.
        statistics: Figures of the call by name.
        covariance: `(6, 6)` of the pose (ROS order), None for mapping.
        step: `(27,)` upper triangle of the covariance of the motion since the pose before, in RB there, then one
            standard deviation of the error that all such motions have alike; None where not known.
        reason: Why it is degraded or lost, in one word; empty otherwise.
        finding: What the method did wrong in this call, `KIND: text`; empty for nothing.
    """

    stamp_ns: int
    processing_time_s: float
    state: str
    peak_rss_bytes: int | None
    above_idle_bytes: int | None
    statistics: Mapping[str, float] = field(default_factory=dict)
    covariance: FloatArray | None = None
    reason: str = ""
    step: FloatArray | None = None
    finding: str = ""


MAX_CALL_S = 1e6
DEFAULT_STATE = {"localisation": TrackingState.TRACKING.value, "mapping": MappingState.MAPPED.value}
"""State of a call by its task, where a foreign node tells none."""
STATISTIC = "statistic."
"""Prefix of the names of a call's figures."""


@dataclass(frozen=True, slots=True)
class TaskRecord:
    """A call and the task it belongs to.

    Attributes:
        task: `localisation` or `mapping`.
        record: The call.
        memory_method: How the memory was measured.
    """

    task: str
    record: CallRecord
    memory_method: str


def call_of(values: Mapping[str, str]) -> TaskRecord | None:
    """Return the call that the values of a status describe, None where they describe something else.

    Raises:
        InputError: If they do, but one is missing or no number.
    """
    if "task" not in values or "processing_time_s" not in values:
        return None
    try:
        statistics = {
            name.removeprefix(STATISTIC): float(text) for name, text in values.items() if name.startswith(STATISTIC)
        }
        record = CallRecord(
            stamp_ns=_whole(values, "stamp_ns"),
            processing_time_s=_seconds(values["processing_time_s"]),
            state=values.get("state") or DEFAULT_STATE[values["task"]],
            peak_rss_bytes=_optional(values, "peak_rss_bytes"),
            above_idle_bytes=_optional(values, "above_idle_bytes"),
            statistics=statistics,
            reason=values.get("reason", ""),
            step=_step(values.get("step", "")),
        )
    except (KeyError, ValueError) as error:
        raise InputError(str(error)) from error
    return TaskRecord(values["task"], record, values.get("memory_method", ""))


def _step(text: str) -> FloatArray | None:
    numbers = np.array([float(word) for word in text.split()[: STEP_SIZE + 1]])
    return numbers if len(numbers) == STEP_SIZE and np.isfinite(numbers).all() else None


def _optional(values: Mapping[str, str], name: str) -> int | None:
    return _whole(values, name) if name in values else None


def _whole(values: Mapping[str, str], name: str) -> int:
    number = int(values[name])
    if not 0 <= number < 2**63:  # what arrays of whole numbers can hold
        raise ValueError(f"{name} is out of range")
    return number


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0.0 <= seconds <= MAX_CALL_S:
        raise ValueError(f"a call of {seconds} s")
    return seconds


UPPER = np.triu_indices(6)
"""Rows and columns of the upper triangle of a pose covariance."""
COVARIANCE_NAMES = tuple(f"cov_{i}{j}" for i, j in zip(*UPPER, strict=True))

METHOD_NAMES = ("method", "method_version", "method_kind", "method_sha256", "finding")
MAPPING_STATES = frozenset(MappingState)
STATES = (*TrackingState, *MappingState)
MAX_NUMBER = 1e18
"""Of times, sizes and covariances; squares of it are finite."""
STEP_NAMES = (*(f"step_{name}" for name in COVARIANCE_NAMES), *(f"systematic_cov_{i}" for i in range(6)))


@dataclass(frozen=True, slots=True, eq=False)
class CallStats:
    """The content of the file.

    Attributes:
        calls: Times, states and memory.
        covariance: `(N, 21)` upper triangles, NaN where not known; None if the file has none.
        steps: `(N, 27)` steps between the poses, NaN where not known; None if the file has none.
        method: The method that was called; None if the file does not name it.
        findings: What the method did wrong, one for each kind.
    """

    calls: Calls
    covariance: FloatArray | None
    steps: FloatArray | None
    method: MethodRecord | None = None
    findings: tuple[FindingRecord, ...] = ()

    def lost_at(self, stamps_ns: IntArray) -> Mask:
        """Return for each stamp whether the state of its call is lost."""
        return self._state_at(stamps_ns, TrackingState.LOST)

    def degraded_at(self, stamps_ns: IntArray) -> Mask:
        """Return for each stamp whether the state of its call is degraded."""
        return self._state_at(stamps_ns, TrackingState.DEGRADED)

    def _state_at(self, stamps_ns: IntArray, state: str) -> Mask:
        rows, states = self.localised_rows(), self.calls.states
        found = [rows.get(stamp) for stamp in stamps_ns.tolist()]
        return np.array([row is not None and states[row] == state for row in found], np.bool_)

    def localised_rows(self) -> dict[int, int]:
        """Return the row of each call of a localiser by stamp; calls of a mapper may have the same stamps."""
        calls = zip(self.calls.stamps_ns.tolist(), self.calls.states, strict=True)
        return {stamp: row for row, (stamp, state) in enumerate(calls) if state not in MAPPING_STATES}

    def covariance_at(self, stamps_ns: IntArray) -> FloatArray | None:
        """Return the covariance `(N, 21)` of each stamp, NaN where there is none; None if the file has none."""
        return self._at(stamps_ns, self.covariance)

    def steps_at(self, stamps_ns: IntArray) -> FloatArray | None:
        """Return the step to each stamp, `(N, 27)`, NaN where there is none; None if the file has none."""
        return self._at(stamps_ns, self.steps)

    def _at(self, stamps_ns: IntArray, values: FloatArray | None) -> FloatArray | None:
        if values is None:
            return None
        rows = self.localised_rows()
        unknown = np.full(values.shape[1], np.nan)
        chosen = [rows.get(stamp) for stamp in stamps_ns.tolist()]
        return np.array([unknown if row is None else values[row] for row in chosen]).reshape(-1, values.shape[1])


def load_call_stats(path: Path, needed: str = "stamp_ns") -> CallStats:
    """Read the file; columns are found by name, all but one are optional, others are ignored.

    Args:
        path: The file.
        needed: Column that must be there. Without `stamp_ns` the calls are numbered.

    Raises:
        InputError: If it cannot be read, has not the column, or a number in it is none; names the line.
    """
    rows = _rows(path, needed)
    calls = Calls(
        _stamps(path, rows),
        _column(path, rows, "processing_time_s"),
        _states(path, rows),
        _column(path, rows, "peak_rss_bytes"),
        _column(path, rows, "above_idle_bytes"),
        {stage: _column(path, rows, name) for name in rows[0] if (stage := stage_of(name or ""))},
    )
    covariance, steps = (_columns(path, rows, names) for names in (COVARIANCE_NAMES, STEP_NAMES))
    findings = findings_of([row.get("finding") or "" for row in rows], calls.stamps_ns.tolist())
    return CallStats(calls, covariance, steps, _method(path, rows[0]), findings)


def stats_of(records: Sequence[CallRecord], method: MethodRecord | None = None) -> CallStats:
    """Return what the file of some calls would hold, without writing it.

    Args:
        records: The calls, at least one.
        method: Whose they are.
    """
    names = sorted({name for record in records for name in record.statistics})
    calls = Calls(
        np.array([record.stamp_ns for record in records], np.int64),
        _numbers([record.processing_time_s for record in records]),
        [record.state for record in records],
        _numbers([record.peak_rss_bytes for record in records]),
        _numbers([record.above_idle_bytes for record in records]),
        {stage: _figure(records, name) for name in names if (stage := stage_of(name))},
    )
    findings = findings_of([record.finding for record in records], calls.stamps_ns.tolist())
    return CallStats(calls, *_uncertainties(records), method, findings)


def _uncertainties(records: Sequence[CallRecord]) -> tuple[FloatArray | None, FloatArray | None]:
    """Return covariances and steps, NaN where not known; None if no call has a covariance."""
    if all(record.covariance is None for record in records):
        return None, None
    covariances = [None if record.covariance is None else record.covariance[UPPER] for record in records]
    return _stacked(covariances, len(COVARIANCE_NAMES)), _stacked([item.step for item in records], len(STEP_NAMES))


def _numbers(values: Sequence[float | None]) -> FloatArray:
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _figure(records: Sequence[CallRecord], name: str) -> FloatArray:
    return _numbers([record.statistics.get(name) for record in records])


def _stacked(rows: Sequence[FloatArray | None], width: int) -> FloatArray:
    unknown = np.full(width, np.nan)
    return np.array([unknown if row is None else row for row in rows])


def findings_of(texts: Sequence[str], stamps_ns: Sequence[int]) -> tuple[FindingRecord, ...]:
    """Return what a method did wrong, one for each kind in the order of their first calls.

    Args:
        texts: Of each call `KIND: text`, empty for nothing; other texts are no findings.
        stamps_ns: Stamps of the calls.
    """
    counted: dict[FindingKind, FindingRecord] = {}
    for text, stamp_ns in zip(texts, stamps_ns, strict=True):
        word, _, rest = text.partition(": ")
        if word not in set(FindingKind):
            continue
        kind = FindingKind(word)
        first = counted.get(kind) or FindingRecord(kind=kind, count=0, first_stamp_ns=stamp_ns, text=rest)
        counted[kind] = replace(first, count=first.count + 1)
    return tuple(counted.values())


def _method(path: Path, row: Mapping[str, str]) -> MethodRecord | None:
    if not row.get("method"):
        return None
    kind = row.get("method_kind") or ""
    if kind not in set(MethodKind):
        raise InputError(f"statistics '{path}': method_kind is '{kind}', must be one of {', '.join(MethodKind)}")
    version, sha256 = row.get("method_version") or None, row.get("method_sha256") or None
    return MethodRecord(name=row["method"], version=version, kind=MethodKind(kind), sha256=sha256)


def _columns(path: Path, rows: list[dict[str, str]], names: Sequence[str]) -> FloatArray | None:
    """Return columns `(N, K)`, None if one is missing."""
    if not all(name in rows[0] for name in names):
        return None
    return np.column_stack([_column(path, rows, name) for name in names])


def _rows(path: Path, needed: str) -> list[dict[str, str]]:
    try:
        text = read_table(path).decode("utf-8-sig")
        rows = list(csv.DictReader(io.StringIO(text, newline="")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot read statistics '{path}': {reason}; give a CSV with one row for each call") from error
    if not rows or needed not in rows[0]:
        found = ", ".join(list(rows[0])[:5]) if rows else "no row"
        raise InputError(f"statistics '{path}' need a column {needed} and at least one row: found {found}")
    return rows


def _stamps(path: Path, rows: list[dict[str, str]]) -> IntArray:
    if "stamp_ns" not in rows[0]:
        return np.arange(len(rows), dtype=np.int64)
    try:
        return np.array([parse_stamp_ns(row["stamp_ns"] or "") for row in rows], np.int64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"statistics '{path}': a stamp is not a whole number of nanoseconds ({error})") from error


def _states(path: Path, rows: list[dict[str, str]]) -> list[str]:
    states = [row.get("state") or "" for row in rows]
    for number, state in enumerate(states, 2):
        if state and state not in STATES:
            raise InputError(
                f"statistics '{path}' line {number}: state is '{state}', must be one of {', '.join(STATES)} or empty"
            )
    return states


def _column(path: Path, rows: list[dict[str, str]], name: str) -> FloatArray:
    """Return a column, NaN where it is empty; times and sizes are not negative."""
    values, low = np.full(len(rows), np.nan), -MAX_NUMBER if "cov_" in name else 0.0
    for number, row in enumerate(rows):
        text = row.get(name)
        if not text:
            continue
        try:
            values[number] = float(text)
        except ValueError as error:
            raise InputError(f"statistics '{path}' line {number + 2}: {name} is '{text}', no number") from error
    wrong = ~np.isnan(values) & ~((values >= low) & (values <= MAX_NUMBER))
    if wrong.any():
        number = int(np.argmax(wrong))
        raise InputError(
            f"statistics '{path}' line {number + 2}: {name} is {values[number]:g}: "
            f"{low:g} to {MAX_NUMBER:g}, or nothing where it was not measured"
        )
    return values


def save_stats(path: Path, records: list[CallRecord], method: MethodRecord | None = None) -> None:
    """Write one row a call: costs, state, reason, statistics, and of a pose its covariance and that of its step.

    Args:
        path: The file.
        records: The calls.
        method: Their method, which every row then names, with what it did wrong in the call; None to leave that out.
    """
    named = () if method is None else (method.name, method.version or "", method.kind.value, method.sha256 or "")
    names = sorted({name for record in records for name in record.statistics})
    with_covariance = any(record.covariance is not None for record in records)
    pose_names = [*COVARIANCE_NAMES, *STEP_NAMES] if with_covariance else []
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        header = ["stamp_ns", "processing_time_s", "state", "reason", "peak_rss_bytes", "above_idle_bytes"]
        writer.writerow([*header, *(METHOD_NAMES if named else ()), *names, *pose_names])
        writer.writerows(_stats_row(record, names, named) for record in records)


def _stats_row(record: CallRecord, names: list[str], method: tuple[str, ...]) -> list[str | int]:
    memory = (record.peak_rss_bytes, record.above_idle_bytes)
    statistics = (record.statistics.get(name) for name in names)
    pose: list[str] = []
    if record.covariance is not None:
        pose = list(map(repr, record.covariance[UPPER].tolist()))
        pose += [""] * len(STEP_NAMES) if record.step is None else map(repr, record.step.tolist())
    return [
        record.stamp_ns,
        repr(record.processing_time_s),
        record.state,
        record.reason,
        *("" if item is None else item for item in memory),
        *((*method, record.finding) if method else ()),
        *("" if value is None else repr(float(value)) for value in statistics),
        *pose,
    ]

"""The CSV with one row for each call, as `sfr localise --stats` and `sfr map --stats` write it."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.inputs import read_table
from sfr_loc_map.io.text_numbers import parse_stamp_ns
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.calls import Calls, stage_of
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.method_record import FindingKind, FindingRecord, MethodKind, MethodRecord
from sfr_loc_map.pipeline.call_record import CallRecord

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

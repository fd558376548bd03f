"""The CSV file of the calls of a run, one row for each call (`--stats`): written from records, read as columns.

The columns are in this order. A file has only the groups for which a call has a value; a missing value is empty.

    CALL_NAMES, MEMORY_METHOD         stamp, time, state, reason, memory
    METHOD_NAMES, FINDING             method under test, and its error in the call
    POSITION_NAMES                    estimated position
    statistics                        statistics of the calls by name, sorted
    COVARIANCE_NAMES, STEP_NAMES      covariance of the pose; step from the previous pose
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.calls.call_findings import findings_of
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.call_stats import USAGE_NAMES, CallStats, positions_of
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_table_text, refusing
from sfr_loc_map.io.tables.stamps import parse_stamp_ns
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.calls.call_meter import METHOD
from sfr_loc_map.metrics.calls.call_score import Calls, stage_of
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.errors.consistency import WITHOUT_NOISE
from sfr_loc_map.metrics.frames.association import UPPER
from sfr_loc_map.metrics.table.records import MethodKind, MethodRecord

STATS_SUFFIX = ".stats.csv"  #: Suffix of a file of calls, which replaces the suffix of the result.
CALL_NAMES = ("stamp_ns", "processing_time_s", "state", "reason", "peak_rss_bytes", "above_idle_bytes")
COST_NAMES = ("processing_time_s", "peak_rss_bytes", "above_idle_bytes", "heap_peak_bytes", "stack_peak_bytes")
MEMORY_METHOD = "memory_method"  #: Column that states how memory was measured.
METHOD_FIELDS = tuple(name for name in MethodRecord.__struct_fields__ if name != "name")
OF_METHOD = {f"method_{name}": name for name in METHOD_FIELDS}  #: Field of a `MethodRecord` by its column.
METHOD_NAMES = ("method", *OF_METHOD)
FINDING = "finding"  #: Column of the error of a method in a call.
POSITION_NAMES = ("position_x_m", "position_y_m", "position_z_m")
"""Columns of the estimated position of a call. The positions identify the estimate to which the calls belong."""
COVARIANCE_NAMES = tuple(f"cov_{i}{j}" for i, j in zip(*UPPER, strict=True))
STEP_NAMES = (
    *(f"step_{name}" for name in COVARIANCE_NAMES),
    *(f"systematic_cov_{i}" for i in range(6)),
    *(f"noise_{name}" for name in COVARIANCE_NAMES),
)
SIGNED_NAMES = frozenset((*POSITION_NAMES, *COVARIANCE_NAMES, *STEP_NAMES))  #: Columns that may be negative.
RESERVED_NAMES = frozenset((*CALL_NAMES, *COST_NAMES, MEMORY_METHOD, *METHOD_NAMES, FINDING)) | SIGNED_NAMES
"""Names of columns that are not those of statistics. A statistic with such a name has the column `statistics.NAME`."""
STATES = (*TrackingState, *MappingState)
MAX_NUMBER = 1e18  #: Limit of times, sizes and covariances in a file; its square is finite.


def stats_beside(result: Path) -> Path:
    """Return the default file of the calls that gave a result, which is beside the result."""
    return result.with_suffix(STATS_SUFFIX)


def save_stats(
    path: Path, records: Sequence[CallRecord], method: MethodRecord | None = None, estimate: Trajectory | None = None
) -> None:
    """Write one row per call. With a method each row names the method, and with an estimate the estimated position."""
    positions = {} if estimate is None else positions_of(estimate)
    statistics = sorted({name for record in records for name in record.statistics})
    columns = [*CALL_NAMES, MEMORY_METHOD]
    columns += METHOD_NAMES if method is not None else ()
    columns += (FINDING,) if method is not None or any(record.finding for record in records) else ()
    columns += POSITION_NAMES if positions else ()
    columns += map(_column_of_statistic, statistics)
    columns += COVARIANCE_NAMES if any(record.covariance is not None for record in records) else ()
    columns += STEP_NAMES if any(record.step is not None for record in records) else ()
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        for record in records:
            row = _call_cells(record) | {_column_of_statistic(k): repr(float(v)) for k, v in record.statistics.items()}
            if method is not None:
                row |= _method_cells(method)
            if record.finding:
                row[FINDING] = record.finding
            if (position := positions.get(record.stamp_ns)) is not None:
                row |= zip(POSITION_NAMES, map(repr, position), strict=True)
            writer.writerow(row | _pose_cells(record))


def _column_of_statistic(name: str) -> str:
    return f"statistics.{name}" if name in RESERVED_NAMES else name


def _call_cells(record: CallRecord) -> dict[str, object]:
    """Return the cells of a call: stamp, time, state and memory."""
    memory = record.peak_rss_bytes, record.above_idle_bytes
    values = (record.stamp_ns, repr(record.processing_time_s), record.state, record.reason, *memory)
    cells: dict[str, object] = dict(zip(CALL_NAMES, values, strict=True))
    return cells | {MEMORY_METHOD: None if record.peak_rss_bytes is None else METHOD}


def _method_cells(method: MethodRecord) -> dict[str, object]:
    """Return the cells about a method."""
    return {"method": method.name, **{column: getattr(method, name) for column, name in OF_METHOD.items()}}


def _pose_cells(record: CallRecord) -> dict[str, object]:
    """Return the cells of the covariance and of the step of a pose."""
    cells: dict[str, object] = {}
    if record.covariance is not None:
        cells |= zip(COVARIANCE_NAMES, map(repr, record.covariance[UPPER].tolist()), strict=True)
    if record.step is not None:
        cells |= zip(STEP_NAMES, map(repr, record.step.tolist()), strict=True)
    return cells


def load_call_stats(path: Path, needed: str = "stamp_ns") -> CallStats:
    """Read a file with the needed column and a figure of calls. Without `stamp_ns` the calls are numbered."""
    table = _Table.read(path, needed)
    has_stamps = table.has(["stamp_ns"])
    stamps_ns = table.stamps_ns() if has_stamps else np.arange(len(table.rows), dtype=np.int64)
    states = table.states()
    times, peak, above_idle, heap, stack = map(table.numbers, COST_NAMES)
    stages = {stage: table.numbers(name) for name in table.rows[0] if (stage := stage_of(name or ""))}
    memory_method = next(filter(None, table.texts(MEMORY_METHOD)), None)
    calls = Calls(stamps_ns, times, states, peak, above_idle, stages, heap, stack, memory_method)
    covariance = table.matrix(COVARIANCE_NAMES) if table.has(COVARIANCE_NAMES) else None
    steps = table.matrix(STEP_NAMES) if table.has(STEP_NAMES[:WITHOUT_NOISE]) else None
    if steps is not None and not table.has(STEP_NAMES[-1:]):  # written by a version without pose noise
        steps[:, WITHOUT_NOISE:] = 0.0
    usage_columns = [*map(table.numbers, USAGE_NAMES)] if table.has(USAGE_NAMES[1:2]) else None
    return CallStats.of_columns(
        calls,
        covariance,
        steps,
        findings_of(table.texts(FINDING), stamps_ns.tolist()),
        usage_columns,
        method=table.method(),
        positions=table.matrix(POSITION_NAMES) if table.has(POSITION_NAMES) else None,
        has_stamps=has_stamps,
    )


@dataclass(frozen=True, slots=True)
class _Table:
    """The rows of a file of calls, at least one. Errors name the file and the line."""

    path: Path
    rows: list[dict[str, str]]

    @classmethod
    def read(cls, path: Path, needed: str) -> _Table:
        """Read a file that has a needed column and a figure of calls."""
        advice = "give a CSV with one row for each call"
        with refusing(f"cannot read '{path}'", advice):
            rows = list(csv.DictReader(io.StringIO(read_table_text(path, advice), newline="")))
        if not rows or needed not in rows[0] or rows[0].keys().isdisjoint(("state", *COST_NAMES, COVARIANCE_NAMES[0])):
            columns = [name for name in rows[0] if name is not None] if rows else []  # None: cells without a column
            found = f"the columns are {', '.join(columns[:5])}" if rows else "the table has no row"
            required = f"{needed} and one of state, processing_time_s and cov_00 are required in each row"
            raise InputError(f"statistics '{path}': {found}: {required}; {advice}")
        return cls(path, rows)

    def has(self, names: Sequence[str]) -> bool:
        """Return whether all columns exist."""
        return self.rows[0].keys() >= set(names)

    def texts(self, name: str) -> list[str]:
        """Return the cells of a column; empty texts if it is missing."""
        return [row.get(name) or "" for row in self.rows]

    def states(self) -> list[str]:
        """Return the states of the calls; InputError if a state is neither a known state nor empty."""
        states = self.texts("state")
        for number, state in enumerate(states, 2):
            if state and state not in STATES:
                text = f"state is '{state}': one of {', '.join(STATES)}, or an empty cell, is required"
                raise InputError(f"statistics '{self.path}' line {number}: {text}")
        return states

    def stamps_ns(self) -> IntArray:
        """Return the stamps of the calls."""
        with refusing(f"statistics '{self.path}': a stamp is not an integer number of nanoseconds"):
            return np.array([parse_stamp_ns(text) for text in self.texts("stamp_ns")], np.int64)

    def method(self) -> MethodRecord | None:
        """Return the method that the rows name; None without one. InputError if the rows name several methods."""
        first = self.rows[0]
        self._check_one_method()
        if not (name := first.get("method")):
            return None
        about = {field: text for column, field in OF_METHOD.items() if (text := first.get(column))}
        if (kind := about.get("kind", "")) not in set(MethodKind):
            text = f"method_kind is '{kind}': one of {', '.join(MethodKind)} is required"
            raise InputError(f"statistics '{self.path}': {text}")
        with refusing(f"statistics '{self.path}'", "give the statistics of one run, unchanged"):
            return msgspec.convert({"name": name, "version": None, **about}, MethodRecord, strict=False)

    def _check_one_method(self) -> None:
        """Raise InputError if rows name different methods: a file has the calls of one run."""
        named = {tuple(row.get(column) or "" for column in METHOD_NAMES) for row in self.rows}
        if len(named) > 1:
            methods = ", ".join(sorted({" ".join(filter(None, names[:2])) or "no method" for names in named}))
            raise InputError(
                f"statistics '{self.path}': its rows name different methods or configurations ({methods}): give the "
                "statistics of one run, unchanged"
            )

    def matrix(self, names: Sequence[str]) -> FloatArray:
        """Return columns `(N, names)` of numbers, NaN where a cell is empty."""
        return np.column_stack([self.numbers(name) for name in names])

    def numbers(self, name: str) -> FloatArray:
        """Return a column `(N,)` of numbers, NaN where a cell is empty."""
        values = np.full(len(self.rows), np.nan)
        low = -MAX_NUMBER if name in SIGNED_NAMES else 0.0
        for number, text in enumerate(self.texts(name)):
            if not text:
                continue
            try:
                values[number] = float(text)
            except ValueError as error:
                line = number + 2
                raise InputError(
                    f"statistics '{self.path}' line {line}: {name} is '{text}', which is not a number"
                ) from error
        wrong = ~np.isnan(values) & ~((values >= low) & (values <= MAX_NUMBER))
        if wrong.any():
            number = int(np.argmax(wrong))
            raise InputError(
                f"statistics '{self.path}' line {number + 2}: {name} is {values[number]:g}: {low:g} to "
                f"{MAX_NUMBER:g}, or an empty cell if not measured, is required"
            )
        return values

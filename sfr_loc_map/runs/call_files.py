"""The CSV file of the calls of a run, one row for each call (`--stats`)."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_table_text, refusing
from sfr_loc_map.io.tables.stamps import parse_stamp_ns
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.association import UPPER
from sfr_loc_map.metrics.call_meter import METHOD
from sfr_loc_map.metrics.calls import Calls, stage_of
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.consistency import STEP_SIZE, WITHOUT_NOISE
from sfr_loc_map.metrics.records import MethodKind, MethodRecord
from sfr_loc_map.runs.call_stats import USAGE_NAMES, CallStats, known_times, positions_of, processes_of
from sfr_loc_map.runs.calls import CallRecord, findings_of

STATS_SUFFIX = ".stats.csv"  #: Suffix of a file of calls, which replaces the suffix of the result.
CALL_NAMES = ("stamp_ns", "processing_time_s", "state", "reason", "peak_rss_bytes", "above_idle_bytes")
COST_NAMES = ("processing_time_s", "peak_rss_bytes", "above_idle_bytes", "heap_peak_bytes", "stack_peak_bytes")
MEMORY_METHOD = "memory_method"  #: Column that states how memory was measured.
METHOD_FIELDS = ("version", "kind", "sha256", "config_sha256", "isolation")  #: Fields of a `MethodRecord`.
METHOD_NAMES = ("method", *(f"method_{name}" for name in METHOD_FIELDS), "finding")
POSITION_NAMES = ("position_x_m", "position_y_m", "position_z_m")
"""Columns of the estimated position of a call. The positions identify the estimate to which the calls belong."""
COVARIANCE_NAMES = tuple(f"cov_{i}{j}" for i, j in zip(*UPPER, strict=True))
STEP_NAMES = (
    *(f"step_{name}" for name in COVARIANCE_NAMES),
    *(f"systematic_cov_{i}" for i in range(6)),
    *(f"noise_{name}" for name in COVARIANCE_NAMES),
)
SIGNED_NAMES = frozenset((*POSITION_NAMES, *COVARIANCE_NAMES, *STEP_NAMES))  #: Columns that may be negative.
STATES = (*TrackingState, *MappingState)
MAX_NUMBER = 1e18  #: Limit of times, sizes and covariances in a file; its square is finite.


def stats_beside(result: Path) -> Path:
    """Return the default file of the calls that gave a result, which is beside the result."""
    return result.with_suffix(STATS_SUFFIX)


def save_stats(
    path: Path, records: Sequence[CallRecord], method: MethodRecord | None = None, estimate: Trajectory | None = None
) -> None:
    """Write one row per call; with a method each row names the method and its error in the call.

    With an estimate each row has the estimated position.
    """
    positions = {} if estimate is None else positions_of(estimate)
    method_values: tuple[str, ...] = ()
    if method is not None:
        method_values = (method.name, *(getattr(method, field) or "" for field in METHOD_FIELDS))
    names = sorted({name for record in records for name in record.statistics})
    # statistics of a method must not replace measured columns
    reserved = {*CALL_NAMES, *COST_NAMES, *METHOD_NAMES, *POSITION_NAMES, *COVARIANCE_NAMES, *STEP_NAMES, MEMORY_METHOD}
    statistics_names = [f"statistics.{name}" if name in reserved else name for name in names]
    with_pose = any(record.covariance is not None for record in records)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        pose_names = (*COVARIANCE_NAMES, *STEP_NAMES) if with_pose else ()
        position_names = POSITION_NAMES if positions else ()
        method_names = METHOD_NAMES if method_values else ()
        writer.writerow([*CALL_NAMES, MEMORY_METHOD, *method_names, *position_names, *statistics_names, *pose_names])
        for record in records:
            row = [record.stamp_ns, repr(record.processing_time_s), record.state, record.reason]
            row += ["" if item is None else item for item in (record.peak_rss_bytes, record.above_idle_bytes)]
            row.append("" if record.peak_rss_bytes is None else METHOD)
            row += [*method_values, record.finding] if method_values else []
            position = positions.get(record.stamp_ns)
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
    if not rows or needed not in rows[0] or rows[0].keys().isdisjoint(("state", *COST_NAMES, COVARIANCE_NAMES[0])):
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
    times, peak, above_idle, heap, stack = (_column(path, rows, name) for name in COST_NAMES)
    seconds = known_times(times)
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
    usage = None
    if USAGE_NAMES[1] in rows[0]:
        usage = processes_of([_column(path, rows, name) for name in USAGE_NAMES], calls)
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
    """Return a column `(N,)` of numbers, NaN where a row has none."""
    values = np.full(len(rows), np.nan)
    low = -MAX_NUMBER if name in SIGNED_NAMES else 0.0
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

"""The CSV file of the calls of a run (`--stats`): written from records, read as columns.

A row with a `finding_count` is a finding on an external node in a replay that belongs to no call, with the stamp of its
first error. Every other row is a call. The columns have the order below. A group of columns is omitted if no row has a
value for it, and the cell of a missing value is empty.

    CALL_NAMES, MEMORY_METHOD         stamp, time, state, reason, memory; in all files
    METHOD_NAMES, FINDING             method of the task, and its error in the call
    FINDING_TASK, FINDING_COUNT       task and number of errors that belong to no call
    POSE_NAMES                        estimated pose
    IMAGES, CLOUD, RATE               images of the call; cloud and rate of the run
    statistics                        statistics of the calls by name, sorted
    COVARIANCE_NAMES, STEP_NAMES      covariance of the pose; step from the previous pose
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import msgspec
import numpy as np

from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.calls.call_findings import findings_of
from sfr_loc_map.calls.call_record import UNKNOWN_TIME_S, CallRecord, bounded, check_uncertainty, task_of
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.run_identity import POSE_SIZE, RunIdentity, hash_of_cloud, poses_by_stamp
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_table_text, refusing
from sfr_loc_map.io.number_text import is_decimal, parse_count
from sfr_loc_map.io.stamps.stamp_text import parse_stamp_ns
from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.calls.call_meter import METHOD
from sfr_loc_map.metrics.calls.call_score import STATED_BY_NODE
from sfr_loc_map.metrics.calls.calls import KNOWN_STATES, MAX_NUMBER, USAGE_NAMES, Calls, stage_of
from sfr_loc_map.metrics.figures.records import CallFinding, FindingKind, FindingRecord, MethodKind, MethodRecord
from sfr_loc_map.metrics.frames.covariance import DIAGONAL, UPPER, check_variances, step_variances
from sfr_loc_map.suite_names import Task

STATS_SUFFIX = ".stats.csv"  #: Suffix of a file of calls, which replaces the suffix of the result.
CALL_NAMES = ("stamp_ns", "processing_time_s", "state", "reason", "peak_rss_bytes", "above_idle_bytes")
COST_NAMES = ("processing_time_s", "peak_rss_bytes", "above_idle_bytes", "heap_peak_bytes", "stack_peak_bytes")
MEMORY_METHOD = "memory_method"  #: Column that states how memory was measured.
OF_METHOD = {"method" if name == "name" else f"method_{name}": name for name in MethodRecord.__struct_fields__}
"""Field of a `MethodRecord` by its column."""
METHOD_NAMES = tuple(OF_METHOD)
FINDING = "finding"  #: Column of the error of a method in a call.
FINDING_TASK, FINDING_COUNT = "finding_task", "finding_count"
"""Columns of the task and of the number of errors that belong to no call; empty for a call."""
POSITION_NAMES = ("position_x_m", "position_y_m", "position_z_m")
ATTITUDE_NAMES = ("attitude_x", "attitude_y", "attitude_z", "attitude_w")
POSE_NAMES = (*POSITION_NAMES, *ATTITUDE_NAMES)
"""Columns of the estimated pose of a call: position, and quaternion of RB in DS. The poses identify the estimate to
which the calls belong."""
IMAGES, CLOUD = "images_sha256", "cloud_sha256"
"""Columns of the hash of the images of a call, and of the hash of the cloud that the calls of a mapper made."""
RATE = "replay_rate"  #: Column of the multiple of the recorded speed at which a replay was played.
COVARIANCE_NAMES = tuple(f"cov_{i}{j}" for i, j in zip(*UPPER, strict=True))
MOTION_NAMES = (*(f"step_{name}" for name in COVARIANCE_NAMES), *(f"systematic_cov_{i}" for i in range(6)))
"""Columns of the uncertainty of the motion since the previous pose."""
NOISE_NAMES = tuple(f"noise_{name}" for name in COVARIANCE_NAMES)  #: Columns of the covariance of the pose noise.
STEP_NAMES = (*MOTION_NAMES, *NOISE_NAMES)
SIGNED_NAMES = frozenset((*POSE_NAMES, *COVARIANCE_NAMES, *STEP_NAMES))
"""Columns that may be negative."""
FINDING_NAMES = (FINDING, FINDING_TASK, FINDING_COUNT)
IDENTITY_NAMES = (*POSE_NAMES, IMAGES, CLOUD, RATE)
ALWAYS_NAMES = (*CALL_NAMES, MEMORY_METHOD)  #: Columns of every file.
NAMES_BEFORE_STATISTICS = (*ALWAYS_NAMES, *METHOD_NAMES, *FINDING_NAMES, *IDENTITY_NAMES)
RESERVED_NAMES = SIGNED_NAMES.union(COST_NAMES, NAMES_BEFORE_STATISTICS)
"""Names of columns that are not those of statistics. A statistic with such a name has the column `statistics.NAME`."""
STATISTICS = "statistics."  #: Prefix of the column of a statistic whose name is reserved or begins with this prefix.
NOT_FINITE = ("nan", "inf", "-inf")  #: Texts of numbers that are not finite.
SHA256 = re.compile("[0-9a-f]{64}")


def stats_beside(result: Path) -> Path:
    """Return the default file of the calls that gave a result, which is beside the result."""
    return result.with_suffix(STATS_SUFFIX)


def save_stats(
    path: Path,
    records: Sequence[CallRecord],
    methods: Mapping[Task, MethodRecord] = MappingProxyType({}),
    estimate: Trajectory | None = None,
    findings: Mapping[Task, Sequence[FindingRecord]] = MappingProxyType({}),
    *,
    cloud: PointCloud | None = None,
    replay_rate: float | None = None,
) -> None:
    """Write one row per call and per finding. Each row names the method of its task, if given.

    With an estimate, each call has the estimated pose at its stamp. With a cloud, each call of a mapper has the hash of
    the cloud. `replay_rate` is the multiple of the recorded speed of a replay; None in lock step and without a replay.
    InputError if a call has an invalid covariance or step, because such a file cannot be read.
    """
    for record in records:
        with refusing(f"call of stamp {record.stamp_ns}"):
            check_uncertainty(record)
    run = _RunCells(
        methods,
        poses=None if estimate is None or not len(estimate) else poses_by_stamp(estimate),
        cloud_sha256=None if cloud is None else hash_of_cloud(cloud),
        replay_rate=replay_rate,
    )
    rows = [run.of_call(record) for record in records]
    rows += [run.of_finding(task, finding) for task, items in findings.items() for finding in items]
    used = set[str](ALWAYS_NAMES).union(*rows)
    statistics = sorted({name for record in records for name in record.statistics})
    order = (*NAMES_BEFORE_STATISTICS, *map(_column_of_statistic, statistics), *COVARIANCE_NAMES, *STEP_NAMES)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [name for name in order if name in used], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


@dataclass(frozen=True, slots=True)
class _RunCells:
    """Gives the cells of the rows of one run by column. A row has all columns of a group, or none."""

    methods: Mapping[Task, MethodRecord]  #: Known methods.
    poses: Mapping[int, Sequence[float]] | None  #: Pose (`POSE_NAMES`) of the estimate by stamp; None without estimate.
    cloud_sha256: str | None  #: Hash of the cloud of the run; None without a cloud.
    replay_rate: float | None

    def of_call(self, record: CallRecord) -> dict[str, object]:
        """Return the cells of a call. The memory of a call of an external node is marked as stated by the node."""
        method = self.methods.get(record.task)
        cells: dict[str, object] = {
            "stamp_ns": record.stamp_ns,
            "processing_time_s": math.nan if record.processing_time_s is None else record.processing_time_s,
            "state": record.state,
            "reason": record.reason,
            "peak_rss_bytes": record.peak_rss_bytes,
            "above_idle_bytes": record.above_idle_bytes,
        }
        if record.peak_rss_bytes is not None:
            is_stated = method is not None and method.kind is MethodKind.EXTERNAL
            cells[MEMORY_METHOD] = STATED_BY_NODE if is_stated else METHOD
        cells |= _cells_of_method(method)
        if record.finding or method is not None:
            cells[FINDING] = record.finding
        if self.poses is not None:
            cells |= zip(POSE_NAMES, self.poses.get(record.stamp_ns, [None] * POSE_SIZE), strict=True)
        if record.images_sha256:
            cells[IMAGES] = record.images_sha256
        if self.cloud_sha256 is not None and record.task is Task.MAPPING:
            cells[CLOUD] = self.cloud_sha256
        if self.replay_rate is not None:
            cells[RATE] = self.replay_rate
        cells |= {_column_of_statistic(name): float(value) for name, value in record.statistics.items()}
        if record.covariance is not None:
            cells |= zip(COVARIANCE_NAMES, bounded(record.covariance[UPPER]).tolist(), strict=True)
        if record.step is not None:
            cells |= zip(STEP_NAMES, bounded(record.step).tolist(), strict=True)
        return {name: _cell(value) for name, value in cells.items()}

    def of_finding(self, task: Task, finding: FindingRecord) -> dict[str, object]:
        """Return the cells of a finding that belongs to no call."""
        cells = _cells_of_method(self.methods.get(task)) | {
            "stamp_ns": finding.first_stamp_ns,
            FINDING: str(CallFinding(finding.kind, finding.text)),
            FINDING_TASK: task.value,
            FINDING_COUNT: finding.count,
        }
        return {name: _cell(value) for name, value in cells.items()}


def _cells_of_method(method: MethodRecord | None) -> dict[str, object]:
    """Return the cells of a method; empty without a method."""
    return {} if method is None else {column: getattr(method, name) for column, name in OF_METHOD.items()}


def _column_of_statistic(name: str) -> str:
    """Return the column of a statistic; different statistics have different columns."""
    is_taken = not name or name in RESERVED_NAMES or name.startswith(STATISTICS)
    return f"{STATISTICS}{name}" if is_taken else name


def _cell(value: object) -> object:
    """Return the cell of a value: numbers in the shortest exact form, texts in one line without control characters."""
    if isinstance(value, float):  # also np.float64, whose repr contains its type
        return repr(float(value))
    return printable(value).replace("\n", "\\n").replace("\t", "\\t") if isinstance(value, str) else value


def load_call_stats(path: Path, needed: str = "stamp_ns") -> CallStats:
    """Read a file, which must have the needed column, and a state, cost or covariance of the calls.

    Without the column `stamp_ns`, the calls are numbered.
    """
    file = _Table.read(path, needed)
    methods = file.methods()
    findings = file.of_findings().findings()
    table = file.of_calls()
    has_stamps = "stamp_ns" in table.columns
    stamps_ns = table.stamps_ns() if has_stamps else np.arange(len(table.rows), dtype=np.int64)
    states = table.states()
    seconds = table.numbers("processing_time_s")
    calls = Calls(
        stamps_ns=stamps_ns,
        seconds=np.where(seconds == UNKNOWN_TIME_S, np.nan, seconds),
        states=states,
        peak_bytes=table.numbers("peak_rss_bytes"),
        above_idle_bytes=table.numbers("above_idle_bytes"),
        stage_s={stage: table.numbers(name) for name in table.columns if (stage := stage_of(name))},
        heap_bytes=table.numbers("heap_peak_bytes"),
        stack_bytes=table.numbers("stack_peak_bytes"),
        memory_method=next((text for text in table.texts(MEMORY_METHOD) if text and text != STATED_BY_NODE), None),
    )
    stats = CallStats.of_columns(
        calls,
        usage={name: table.numbers(name) for name in USAGE_NAMES},
        covariance=table.covariance(),
        steps=table.steps(),
        stated_tasks=[task for task, method in methods.items() if method.kind is MethodKind.EXTERNAL],
    )
    return replace(
        stats,
        methods=methods,
        findings=(*findings, *findings_of(zip(stamps_ns.tolist(), table.texts(FINDING), strict=True))),
        identity=table.identity(),
        has_stamps=has_stamps,
    )


@dataclass(frozen=True, slots=True)
class _Table:
    """The rows of a file of calls. Errors name the file and the line."""

    path: Path
    columns: tuple[str, ...]
    rows: list[dict[str, str]]
    lines: list[int]  # number of the line of each row

    @classmethod
    def read(cls, path: Path, needed: str) -> _Table:
        """Read a file; InputError unless it has the needed column, a state, cost or covariance, and a row."""
        advice = "give a CSV with one row for each call"
        with refusing(f"cannot read '{path}'", advice):
            reader = csv.reader(io.StringIO(read_table_text(path, advice), newline=""))
            numbered = [(reader.line_num, cells) for cells in reader if cells]
        columns = numbered[0][1] if len(numbered) > 1 else []
        if needed not in columns or {"state", *COST_NAMES, COVARIANCE_NAMES[0]}.isdisjoint(columns):
            found = f"the columns are {', '.join(columns[:5])}" if columns else "the table has no row"
            required = f"{needed} and one of state, processing_time_s and cov_00 are required in each row"
            raise InputError(f"statistics '{path}': {found}: {required}; {advice}")
        for name, count in Counter(filter(None, columns)).items():
            if count > 1:
                raise InputError(f"statistics '{path}' line 1: column {name} is given {count} times; {advice}")
        for line, cells in numbered:
            if len(cells) != len(columns):
                text = f"{len(cells)} cells for {len(columns)} columns: one cell for each column is required"
                raise InputError(f"statistics '{path}' line {line}: {text}; write numbers with a decimal point")
        rows = [dict(zip(columns, cells, strict=True)) for _, cells in numbered[1:]]
        return cls(path, tuple(columns), rows, [line for line, _ in numbered[1:]])

    def texts(self, name: str) -> list[str]:
        """Return the cells of a column; empty texts if it is missing."""
        return [row.get(name, "") for row in self.rows]

    def of_calls(self) -> _Table:
        """Return the rows that are calls."""
        return self._selected(is_finding=False)

    def of_findings(self) -> _Table:
        """Return the rows that are findings that belong to no call."""
        return self._selected(is_finding=True)

    def _selected(self, *, is_finding: bool) -> _Table:
        kept = [number for number, row in enumerate(self.rows) if _is_finding(row) is is_finding]
        return replace(self, rows=[self.rows[number] for number in kept], lines=[self.lines[number] for number in kept])

    def findings(self) -> list[FindingRecord]:
        """Return the findings of rows that belong to no call."""
        found = []
        for line, row in zip(self.lines, self.rows, strict=True):
            kind, _, text = row.get(FINDING, "").partition(": ")
            stamp = row.get("stamp_ns")
            with refusing(f"statistics '{self.path}' line {line}: invalid finding"):
                first_ns = parse_stamp_ns(stamp) if stamp else None
                count = parse_count(row[FINDING_COUNT])
                found.append(FindingRecord(kind=FindingKind(kind), count=count, first_stamp_ns=first_ns, text=text))
        return found

    def states(self) -> list[str]:
        """Return the states of the calls; InputError if a state is neither a known state nor empty."""
        states = self.texts("state")
        for line, state in zip(self.lines, states, strict=True):
            if state not in KNOWN_STATES:
                known = ", ".join(filter(None, KNOWN_STATES))
                text = f"state is '{state}': one of {known}, or an empty cell, is required"
                raise InputError(f"statistics '{self.path}' line {line}: {text}")
        return states

    def stamps_ns(self) -> IntArray:
        """Return the stamps of the calls."""
        stamps_ns = []
        for line, text in zip(self.lines, self.texts("stamp_ns"), strict=True):
            with refusing(f"statistics '{self.path}' line {line}"):
                stamps_ns.append(parse_stamp_ns(text))
        return np.array(stamps_ns, np.int64)

    def methods(self) -> dict[Task, MethodRecord]:
        """Return the method that the rows of each task name. InputError if several are named.

        A file has the calls of one run, in which at most one task has a method under test.
        """
        named: dict[Task, set[tuple[str, ...]]] = {}
        for line, row in zip(self.lines, self.rows, strict=True):
            with refusing(f"statistics '{self.path}' line {line}"):
                task = _task_of(row)
            named.setdefault(task, set()).add(tuple(row.get(column, "") for column in METHOD_NAMES))
        for of_task in named.values():
            self._check_one_method(of_task)
        found = {}
        for task, (texts,) in named.items():
            cells = dict(zip(METHOD_NAMES, texts, strict=True))
            if cells["method"]:
                found[task] = self._method(cells)
        under_test = {task for task, method in found.items() if method.kind is not MethodKind.BUILT_IN}
        self._check_one_method(set().union(*(named[task] for task in under_test)))
        return found

    def _method(self, cells: Mapping[str, str]) -> MethodRecord:
        """Return the method of the cells of `METHOD_NAMES`."""
        about = {field: cells[column] for column, field in OF_METHOD.items() if cells[column]}
        if (kind := about.get("kind", "")) not in set(MethodKind):
            text = f"method_kind is '{kind}': one of {', '.join(MethodKind)} is required"
            raise InputError(f"statistics '{self.path}': {text}")
        with refusing(f"statistics '{self.path}'", "give the statistics of one run, unchanged"):
            return msgspec.convert({"version": None, **about}, MethodRecord, strict=False)

    def _check_one_method(self, named: set[tuple[str, ...]]) -> None:
        """Raise InputError if the cells of `METHOD_NAMES` differ."""
        if len(named) > 1:
            cells = [dict(zip(METHOD_NAMES, texts, strict=True)) for texts in named]
            names = {f"{each['method']} {each['method_version']}".strip() or "no method" for each in cells}
            raise InputError(
                f"statistics '{self.path}': its rows name different methods or configurations "
                f"({', '.join(sorted(names))}): give the statistics of one run, unchanged"
            )

    def covariance(self) -> FloatArray | None:
        """Return the covariances `(N, 21)` of the poses, None if missing; InputError if a variance is negative."""
        covariance = self.matrix(COVARIANCE_NAMES)
        if covariance is None:
            return None
        for line, variances in zip(self.lines, covariance[:, DIAGONAL], strict=True):
            with refusing(f"statistics '{self.path}' line {line}"):
                check_variances("covariance", variances)
        return covariance

    def steps(self) -> FloatArray | None:
        """Return the steps `(N, 48)` between the poses, None if missing; InputError if a variance is negative."""
        motion, noise = self.matrix(MOTION_NAMES), self.matrix(NOISE_NAMES)
        if motion is None:
            return None
        if noise is None:  # written by a version without pose noise
            noise = np.zeros((len(motion), len(NOISE_NAMES)))
        steps = np.hstack((motion, noise))
        for line, variances in zip(self.lines, step_variances(steps), strict=True):
            with refusing(f"statistics '{self.path}' line {line}"):
                check_variances("step", variances)
        return steps

    def identity(self) -> RunIdentity:
        """Return what identifies the run; InputError for an invalid hash, and for several clouds or rates."""
        for name in (CLOUD, IMAGES):
            self.check_hashes(name)
        rates = self.numbers(RATE).tolist()
        for name in (CLOUD, RATE):
            self.check_one_value(name)
        return RunIdentity(
            positions=self.matrix(POSITION_NAMES),
            quats_xyzw=self.matrix(ATTITUDE_NAMES),
            images_sha256=self.texts(IMAGES) if IMAGES in self.columns else None,
            cloud_sha256=next(filter(None, self.texts(CLOUD)), None),
            replay_rate=next((rate for rate in rates if rate > 0.0), None),
        )

    def check_hashes(self, name: str) -> None:
        """Raise InputError if a cell of a column is neither a SHA-256 nor empty."""
        for line, text in zip(self.lines, self.texts(name), strict=True):
            if text and not SHA256.fullmatch(text):
                required = "64 digits from 0 to 9 and a to f, or an empty cell, are required"
                raise InputError(f"statistics '{self.path}' line {line}: {name} is '{text}': {required}")

    def check_one_value(self, name: str) -> None:
        """Raise InputError if the cells of a column that are not empty have different texts."""
        texts = set(filter(None, self.texts(name)))
        if len(texts) > 1:
            text = f"the column {name} has {len(texts)} different values: one for the complete run is required"
            raise InputError(f"statistics '{self.path}': {text}; give the statistics of one run, unchanged")

    def matrix(self, names: Sequence[str]) -> FloatArray | None:
        """Return columns `(N, names)` of numbers, NaN where a cell is empty; None if a column is missing."""
        if not set(names).issubset(self.columns):
            return None
        return np.column_stack([self.numbers(name) for name in names])

    def numbers(self, name: str) -> FloatArray:
        """Return a column `(N,)` of numbers, NaN where a cell is empty."""
        values = np.full(len(self.rows), np.nan)
        low = -MAX_NUMBER if name in SIGNED_NAMES else 0.0
        for row, text in enumerate(self.texts(name)):
            if not (word := text.strip(" \t")):
                continue
            if not is_decimal(word) and word.lower() not in NOT_FINITE:
                place = f"statistics '{self.path}' line {self.lines[row]}"
                raise InputError(f"{place}: {name} is '{text}', which is not a number")
            values[row] = float(word)
        wrong = ~np.isnan(values) & ~((values >= low) & (values <= MAX_NUMBER))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"statistics '{self.path}' line {self.lines[row]}: {name} is {values[row]:g}: {low:g} to "
                f"{MAX_NUMBER:g}, or an empty cell if not measured, is required"
            )
        return values


def _is_finding(row: Mapping[str, str]) -> bool:
    """Return whether a row is a finding that belongs to no call."""
    return bool(row.get(FINDING_COUNT))


def _task_of(row: Mapping[str, str]) -> Task:
    """Return the task of a row: that of its finding, or else of its state. ValueError if the task is unknown."""
    if _is_finding(row):
        return Task(row.get(FINDING_TASK, ""))
    return task_of(row.get("state", ""))

"""Trajectories from files; the format is detected from the content. `trajectory_writer` writes the first four formats.

| format | content |
|---|---|
| `csv` | header `stamp_ns,rbOriginPos_m_Ds_{x,y,z},att_q_DsToRb_{1..4}`, scalar last |
| `tum` | `t x y z qx qy qz qw`, t in seconds, orientation as in ROS messages |
| `kitti` | twelve numbers per line, the first three rows of a pose matrix, no stamps (Geiger et al. 2012) |
| `euroc` | csv with nanoseconds and quaternions scalar first (Burri et al. 2016); further columns are ignored |
| `matrix` | 3 x 4 or 4 x 4 matrices after a stamp or a frame number |
| `columns` | any other table of positions or poses; `column_detection` detects its columns and their units |

`att_q_DsToRb` converts components in DS to components in RB: the conjugate of the orientation in ROS messages. KITTI
has poses of the left camera in its first frame, with x right, y down, z forward. Both frames are rotated to the axes of
the suite (x forward, y left, z up), so that yaw is the heading. The rotation does not change pose errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, plausible_poses, plausible_positions, plausible_rotations
from sfr_loc_map.geometry.rotation import quat_from_matrix
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_table, split_lines
from sfr_loc_map.io.tables.column_detection import detect_columns
from sfr_loc_map.io.tables.numbered_stamps import stamps_by_number, times_beside
from sfr_loc_map.io.tables.pose_columns import (
    COVARIANCES,
    CSV_HEADER,
    FRAME,
    KITTI_COLUMNS,
    NANOSECONDS,
    QUATERNION,
    PoseColumns,
    TrajectoryFormat,
)
from sfr_loc_map.io.tables.stamps import check_unit, seconds_text
from sfr_loc_map.io.tables.table_head import HEAD_LINES, header_cells, separator_in
from sfr_loc_map.io.tables.text_table import BOM, MAX_BROKEN, Table, parse_table
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted

MAX_NEGATIVE = 1e-6  #: Largest negative eigenvalue of a covariance by rounding, as a fraction of its largest variance.
CONJUGATED = np.array([-1.0, -1.0, -1.0, 1.0])
"""Signs that conjugate a quaternion, which converts `att_q_DsToRb` to the orientation in ROS messages and back."""
ANNOUNCED = (TrajectoryFormat.KITTI, TrajectoryFormat.EUROC, TrajectoryFormat.COLUMNS, TrajectoryFormat.MATRIX)
"""Formats that commands report when they detect them."""
COLUMNS_OPTION = "--columns 'COLUMNS'"
"""How a user names the columns of a file, for messages; COLUMNS stands for the columns."""
ESTIMATE_OPTION, TRUTH_OPTION = "--columns 'estimate:COLUMNS'", "--columns 'truth:COLUMNS'"
CONFIGURED_OPTION = "--set 'truth.columns=COLUMNS'"  #: For a truth that `truth.source` names.
MAX_EQUAL = 2  #: Largest mean number of poses with one stamp; some tools write each pose twice.
SAME_PLACE_M = 0.01  #: Largest distance of positions at equal stamps that may be noise, m.
APART_STEPS = 5.0  #: Smallest distance of two bodies, as a multiple of the median step between different stamps.
RUN_ROWS = 10  #: Smallest number of rows of a run; rows in random order have shorter runs.
MOST_NAMED = 8  #: Maximum number of columns that a message lists.
FORMAT_NAMES = {  # all formats but COLUMNS, whose name is that of the detected columns
    TrajectoryFormat.CSV: "csv of the suite",
    TrajectoryFormat.TUM: "TUM",
    TrajectoryFormat.KITTI: "KITTI poses of the left camera, rotated to x forward, y left, z up",
    TrajectoryFormat.EUROC: "EuRoC csv",
    TrajectoryFormat.MATRIX: "3 x 4 matrices with stamps or frame numbers",
}


@dataclass(frozen=True, slots=True, eq=False)
class LoadedTrajectory:
    """A trajectory as read."""

    path: Path
    trajectory: Trajectory
    format: TrajectoryFormat = TrajectoryFormat.CSV
    stamps: str = ""  #: Origin of the stamps for messages, if the file itself has none.
    by_index: bool = False  #: Whether the stamps are only numbers of lines or frames.
    columns: PoseColumns | None = None  #: The columns that were read; None for poses of other sources.
    skipped: str = ""  #: Description of the skipped rows.
    covariance: FloatArray | None = None  #: `(N, 6, 6)` in ROS order (m^2, rad^2), if the file has it.
    rows: IntArray | None = None  #: `(N,)` number of the row of each pose in the file, from 0; None: all rows.
    row_count: int | None = None  #: Number of rows in the file, with the skipped rows; None: that of the poses.

    @property
    def text(self) -> str:
        """The detected format and content, in one line."""
        kind = "pose" if self.trajectory.has_attitude else "position"
        name = FORMAT_NAMES.get(self.format) or ("" if self.columns is None else self.columns.name)
        parts = [name, counted(len(self.trajectory), kind)]
        parts += [f"stamps: {self.stamps}"] if self.stamps else []
        if self.columns is not None:
            lengths = " and ".join(self.columns.length_units)
            parts += [f"unit of the positions: {lengths}"] if lengths else []
            unit = self.columns.inferred
            parts += [f"unit of the stamps, inferred from their magnitude: {unit}"] if unit else []
            parts += ["covariances read"] if self.covariance is not None else []
            ignored = [name for name in self.columns.ignored if name]
            more = f" and {len(ignored) - MOST_NAMED} more" if len(ignored) > MOST_NAMED else ""
            parts += [f"columns not read: {', '.join(ignored[:MOST_NAMED])}{more}"] if ignored else []
        parts += [self.skipped] if self.skipped else []
        return f"{self.path}: {', '.join(parts)}"

    @property
    def is_announced(self) -> bool:
        """Whether commands report the detection: always, except for the default forms of the suite's csv and of TUM."""
        columns = self.columns
        unusual = columns is not None and bool(columns.inferred or columns.ignored or columns.length_units)
        return self.format in ANNOUNCED or bool(self.skipped) or unusual

    @property
    def stamped(self) -> Trajectory:
        """The trajectory with the stamps of the file; InputError if the file has no stamps."""
        if self.by_index:
            raise InputError(
                f"'{self.path}' has no stamps ({len(self.trajectory)} poses, numbered by line): write the time of each "
                f"pose in seconds into '{times_beside(self.path)}'"
            )
        return self.trajectory

    def with_stamps_of(self, other: LoadedTrajectory) -> LoadedTrajectory:
        """Return the trajectory; if it has no stamps, with the stamps of another trajectory, row by row.

        Poses whose row was skipped in the other file are omitted. InputError if the files differ in their numbers of
        rows, or have no pose in the same row.
        """
        if not self.by_index or other.by_index:
            return self
        own_rows, own_count = self._numbered_rows()
        other_rows, other_count = other._numbered_rows()
        if own_count != other_count:
            raise InputError(
                f"'{self.path}' has no stamps ({own_count} rows of KITTI poses) and '{other.path}' has {other_count} "
                f"rows: write the time of each pose in seconds into '{times_beside(self.path)}'"
            )
        _, own, others = np.intersect1d(own_rows, other_rows, assume_unique=True, return_indices=True)
        if not len(own):
            raise InputError(f"'{self.path}' and '{other.path}' have no pose in the same row: correct the files")
        poses = self.trajectory
        stamped = Trajectory(other.trajectory.stamps_ns[others], poses.positions[own], poses.quats_xyzw[own])
        missing = len(poses) - len(own)
        skipped = [self.skipped] if self.skipped else []
        skipped += [f"{counted(missing, 'pose')} without a stamp in {other.path} skipped"] if missing else []
        return replace(
            self,
            trajectory=stamped,
            stamps=f"those of {other.path}, pose by pose",
            by_index=False,
            skipped="; ".join(skipped),
            covariance=None if self.covariance is None else self.covariance[own],
            rows=own_rows[own],
        )

    def _numbered_rows(self) -> tuple[IntArray, int]:
        """Return the number of the row of each pose `(N,)`, from 0, and the number of all rows."""
        rows = np.arange(len(self.trajectory)) if self.rows is None else self.rows
        return rows, len(self.trajectory) if self.row_count is None else self.row_count


def read_trajectory_file(path: Path, columns: str = "", option: str = COLUMNS_OPTION) -> LoadedTrajectory:
    """Read a trajectory; the format is given by its header, else by the layout that the rows fit (`column_detection`).

    Stamps may be in any order, but the times of several runs must not overlap. `columns` names the columns if the file
    does not. Messages recommend `option` for naming the columns. InputError if the file cannot be read, if its columns
    or units are ambiguous or contradict each other, or if too many of its lines are invalid.
    """
    path = Path(path)
    name = f"'{path}'"
    rest = read_table(path, "give a csv, TUM, KITTI or EuRoC file")
    first = next(rest, b"")
    blocks = chain((first,), rest)
    return _read_columns(path, blocks, name, detect_columns(_lines_of(first), name, columns, option))


def is_suite_table(path: Path) -> bool:
    """Return whether a line of a file is a header with the names of the csv of the suite, `CSV_HEADER`."""
    names = set(CSV_HEADER.lower().split(","))
    lines = _lines_of(next(read_table(path), b""))[:HEAD_LINES]
    return any(names <= set(header_cells(line.lower(), separator_in(line))) for line in lines)


def _lines_of(block: bytes) -> list[str]:
    """Return the lines of the first block of a table."""
    return split_lines(block.removeprefix(BOM).decode("utf-8", "replace"))


def _read_columns(path: Path, blocks: Iterable[bytes], name: str, columns: PoseColumns) -> LoadedTrajectory:
    """Return the poses, or positions, of a table whose columns are known."""
    keys = columns.value_keys
    stamp_keys = () if columns.stamp_key is None else (columns.stamp_key,)
    indices = [columns.index_of[key] for key in (*stamp_keys, *keys)]
    table = parse_table(
        blocks,
        name,
        columns.name,
        indices,
        stamp=columns.stamp_parser() if stamp_keys else None,
        separator=columns.separator,
        more=columns.allows_more,
        skip=columns.skip,
        small_unit=columns.small_unit,
        tolerant=True,
    )
    values = dict(zip(keys, table.values.T, strict=True))
    if columns.is_matrix:
        is_optical = columns.format is TrajectoryFormat.KITTI
        positions, quats = _of_matrices(table.values[:, :KITTI_COLUMNS], is_optical=is_optical)
    else:
        positions = np.stack([values[key] for key in columns.position_keys], axis=1) * np.array(columns.scales)
        quats = np.stack([values.get(key, np.zeros(len(positions))) for key in QUATERNION], axis=1)
        quats *= CONJUGATED if columns.is_conjugated else 1.0
    if NANOSECONDS in columns:
        _check_whole_seconds(table)
        fractions_ns = _fractions_ns(table, values[NANOSECONDS] * columns.fraction_ns)
        table = replace(table, stamps_ns=table.stamps_ns + fractions_ns)
    origin, by_index = "", False
    if columns.stamp_key in (None, FRAME):
        stamps_ns, origin, by_index = stamps_by_number(path, table, columns)
        table = replace(table, stamps_ns=stamps_ns)
    poses = replace(table, values=np.concatenate((positions, quats), axis=1))
    covariance = _covariance(values) if columns.has_covariance else None
    return _loaded(path, poses, columns, stamps=origin, by_index=by_index, covariance=covariance)


def _check_whole_seconds(table: Table) -> None:
    """Raise InputError if the column of seconds has decimals although a column `nsec` contains the fraction."""
    if (has_fraction := table.stamps_ns % NS_PER_S != 0).any():
        first = int(np.argmax(has_fraction))
        stamp = seconds_text(int(table.stamps_ns[first]))
        raise InputError(
            f"{table.name} line {table.lines[first]}: the column of seconds contains {stamp}, although another column "
            f"contains the fraction of a second: whole seconds are required; if {stamp} is the complete stamp, name "
            "only this column, as t"
        )


def _fractions_ns(table: Table, fractions_ns: FloatArray) -> IntArray:
    """Return fractions of seconds `(N,)` as whole nanoseconds; InputError if one is negative or at least 1 s."""
    if (outside := (fractions_ns < 0.0) | (fractions_ns >= NS_PER_S)).any():
        first = int(np.argmax(outside))
        raise InputError(
            f"{table.name} line {table.lines[first]}: the fraction of a second is {fractions_ns[first]:g} ns: 0 to "
            f"{NS_PER_S - 1} ns is required; name the column of the complete stamp as t, or correct the unit"
        )
    return np.rint(fractions_ns).astype(np.int64)


def _of_matrices(rows: FloatArray, *, is_optical: bool) -> tuple[FloatArray, FloatArray]:
    """Return positions and quaternions of 3 x 4 matrices `(N, 12)`; a quaternion is NaN if its matrix is no rotation.

    `is_optical`: both frames are rotated from optical axes (x right, y down, z forward) to those of the suite.
    """
    matrices = rows.reshape(-1, 3, 4)
    rotations, positions = matrices[:, :, :3], matrices[:, :, 3]
    good = plausible_rotations(rotations)
    rotations = np.where(good[:, None, None], rotations, np.eye(3))
    if is_optical:
        rotations = OPTICAL_IN_BODY @ rotations @ OPTICAL_IN_BODY.T
        positions = positions @ OPTICAL_IN_BODY.T
    quats = quat_from_matrix(rotations)
    return positions, np.where(good[:, None], quats, np.nan)


def _covariance(values: Mapping[str, FloatArray]) -> FloatArray:
    """Return covariances `(N, 6, 6)` in ROS order (position, attitude) from the columns of upper triangles."""
    covariance = np.zeros((len(next(iter(values.values()))), 6, 6))
    for prefix, (part, indices) in COVARIANCES.items():
        start = 0 if part == "position" else 3
        for index in indices:
            row, column = (start + int(digit) - 1 for digit in index)
            covariance[:, row, column] = covariance[:, column, row] = values[f"{prefix}{index}"]
    return covariance


def _valid_covariances(covariance: FloatArray) -> tuple[FloatArray | None, int]:
    """Return covariances `(N, 6, 6)`, NaN where invalid (None if all are invalid), and the number that is invalid."""
    largest = np.diagonal(covariance, axis1=1, axis2=2).max(axis=1)
    is_valid = np.linalg.eigvalsh(covariance)[:, 0] >= -MAX_NEGATIVE * np.maximum(largest, 0.0)
    if not is_valid.any():
        return None, len(covariance)
    return np.where(is_valid[:, None, None], covariance, np.nan), int((~is_valid).sum())


def _loaded(
    path: Path, table: Table, columns: PoseColumns, *, stamps: str, by_index: bool, covariance: FloatArray | None
) -> LoadedTrajectory:
    """Return the poses of rows x, y, z, quaternion; rows without a valid pose are skipped and counted."""
    positions, quats = table.values[:, :3].copy(), table.values[:, 3:].copy()
    good, near = plausible_poses(positions, quats), plausible_positions(positions)
    problems = []
    for row in np.flatnonzero(~good).tolist():
        problem = f"the quaternion {quats[row].tolist()} is not a rotation: a unit quaternion is required"
        if np.isnan(quats[row]).any():
            problem = "the matrix is not a pose: an orthonormal rotation is required"
        if not near[row]:
            problem = f"the position is implausible: at most {MAX_POSITION_M:g} m is allowed"
        problems.append(f"line {table.lines[row]}: {problem}")
    kept = table.without(good, problems).checked()
    if not len(kept.lines):
        reason = f" ({kept.skipped})" if kept.skipped else ""
        raise InputError(f"{table.name} has no pose{reason}: at least one line with a pose is required")
    check_unit(kept.stamps_ns, table.name, is_stated=columns.states_time_unit)
    _check_stamps_differ(kept)
    _check_one_run(kept)
    _check_one_body(kept, positions[good])
    trajectory = Trajectory(kept.stamps_ns, positions[good], quats[good])
    skipped = [kept.skipped] if kept.skipped else []
    if covariance is not None:
        covariance, invalid = _valid_covariances(covariance[good])
        skipped += [f"covariances ignored because they are not positive semi-definite: {invalid}"] if invalid else []
    return LoadedTrajectory(
        path,
        trajectory,
        columns.format,
        stamps,
        by_index,
        columns,
        "; ".join(skipped),
        covariance,
        rows=table.row_numbers[good],
        row_count=len(table.lines) + len(table.skipped_lines),
    )


def _check_stamps_differ(table: Table) -> None:
    """Raise InputError if a stamp has more than `MAX_EQUAL` poses on average, as when its last digits are missing."""
    stamps_ns = np.sort(table.stamps_ns)  # hundred times as fast as `np.unique`, which hashes integers
    count, different = len(stamps_ns), 1 + np.count_nonzero(np.diff(stamps_ns))
    if count > MAX_EQUAL * different:
        raise InputError(
            f"{table.name}: the number of different stamps is {different} for {count} poses: one stamp for each pose "
            "is required; write the stamps with all their digits"
        )


def _check_one_body(table: Table, positions: FloatArray) -> None:
    """Raise InputError if positions `(N, 3)` with equal stamps are apart, as those of two bodies."""
    order = np.argsort(table.stamps_ns, kind="stable")
    is_equal = np.diff(table.stamps_ns[order]) == 0
    if np.count_nonzero(is_equal) <= MAX_BROKEN * len(order):
        return
    ordered = positions[order]
    apart_m = np.linalg.norm(np.diff(ordered, axis=0), axis=1)[is_equal]
    first_of_stamp = ordered[np.append(True, ~is_equal)]
    steps_m = np.linalg.norm(np.diff(first_of_stamp, axis=0), axis=1)
    typical_m = float(np.median(apart_m))
    if typical_m > max(SAME_PLACE_M, APART_STEPS * float(np.median(steps_m)) if len(steps_m) else 0.0):
        line = table.lines[order[1:][is_equal][0]]
        raise InputError(
            f"{table.name} line {line} and {len(apart_m) - 1} more have the stamp of another line, but positions that "
            f"are typically {typical_m:.3g} m apart: the poses of one body are required; give each body a file of its "
            "own"
        )


def _check_one_run(table: Table) -> None:
    """Raise InputError if a table has several runs over the same time, for example because the clock was restarted.

    A run is a part of the table with increasing stamps. A table may be sorted in descending order, consist of runs
    whose times do not overlap, in any order, or have stray rows anywhere.
    """
    steps = np.diff(table.stamps_ns)
    is_downwards = np.count_nonzero(steps < 0) > np.count_nonzero(steps > 0)
    stamps_ns = table.stamps_ns[::-1] if is_downwards else table.stamps_ns
    starts = np.append(0, np.flatnonzero(np.diff(stamps_ns) < 0) + 1)
    counts = np.diff(starts, append=len(stamps_ns))
    starts, counts = starts[counts >= RUN_ROWS], counts[counts >= RUN_ROWS]
    margins = np.maximum(counts // 10, 1)  # a stray stamp may begin or end a run
    first_ns, last_ns = stamps_ns[starts + margins], stamps_ns[starts + counts - 1 - margins]
    order = np.argsort(first_ns, kind="stable")
    overlaps = first_ns[order][1:] < np.maximum.accumulate(last_ns[order])[:-1]
    if overlaps.any():
        row = int(starts[order][1:][overlaps].max())
        line = table.lines[::-1][row] if is_downwards else table.lines[row]
        raise InputError(
            f"{table.name} line {line}: the stamps begin again within the time of other rows: one run is required; "
            "give each run a file of its own"
        )

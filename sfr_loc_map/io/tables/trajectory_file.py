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

from itertools import chain
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import read_table, split_lines
from sfr_loc_map.io.stamps.stamp_checks import check_unit
from sfr_loc_map.io.stamps.time_units import UnitOrigin
from sfr_loc_map.io.tables.column_detection import detect_columns
from sfr_loc_map.io.tables.date_cells import has_dates, with_complete_dates
from sfr_loc_map.io.tables.loaded_trajectory import LoadedTrajectory
from sfr_loc_map.io.tables.numbered_stamps import PoseStamps, stamps_of_frames, stamps_of_lines
from sfr_loc_map.io.tables.pose_columns import CSV_HEADER, FRAME, NANOSECONDS, PoseColumns
from sfr_loc_map.io.tables.row_poses import (
    Values,
    checked_poses,
    covariances_of,
    joined_stamps,
    poses_of,
    valid_covariances,
    values_by_key,
)
from sfr_loc_map.io.tables.run_checks import check_one_run_of_one_body
from sfr_loc_map.io.tables.table_head import HEAD_LINES, header_cells, separator_in
from sfr_loc_map.io.tables.text_table import BOM, TableRows, parse_table

COLUMNS_OPTION = "--columns 'COLUMNS'"
"""Option by which a user names the columns of a file, for messages; COLUMNS stands for the columns."""
ESTIMATE_OPTION, TRUTH_OPTION = "--columns 'estimate:COLUMNS'", "--columns 'truth:COLUMNS'"
CONFIGURED_OPTION = "--set 'truth.columns=COLUMNS'"  #: For a truth that `truth.source` names.


def read_trajectory_file(path: Path, columns: str = "", option: str = COLUMNS_OPTION) -> LoadedTrajectory:
    """Read a trajectory; the format is given by its header, else by the layout that the rows fit (`column_detection`).

    Stamps may be in any order, but the times of several runs must not overlap. `columns` names the columns if the file
    does not. Messages recommend `option` for naming the columns. InputError if the file cannot be read, if its columns
    or units are ambiguous or contradict each other, or if too many of its lines are invalid.
    """
    path = Path(path)
    name = f"'{path}'"
    blocks = read_table(path, "give a csv, TUM, KITTI or EuRoC file")
    first_block = next(blocks, b"")
    if has_dates(first_block):
        first_block = with_complete_dates(first_block)
        blocks = map(with_complete_dates, blocks)
    detected = detect_columns(_lines_of(first_block), name, columns, option)
    rows = parse_table(chain((first_block,), blocks), name, detected.row_form, skip=detected.skip, tolerant=True)
    return _loaded(path, rows, detected)


def _loaded(path: Path, rows: TableRows, columns: PoseColumns) -> LoadedTrajectory:
    """Return the valid poses of a table; the other rows are skipped and counted, up to `MAX_INVALID`."""
    values = values_by_key(rows, columns)
    positions, quats = poses_of(values, columns)
    stamps = _stamps_of(path, rows, values, columns)
    is_valid, problems = checked_poses(positions, quats)
    valid = rows.without(is_valid, problems).checked()
    if not len(valid.lines):
        reason = f" ({valid.skipped})" if valid.skipped else ""
        raise InputError(f"{rows.name} has no pose{reason}:", "at least one line with a pose is required")
    trajectory = Trajectory(stamps.stamps_ns[is_valid], positions[is_valid], quats[is_valid])
    check_unit(trajectory.stamps_ns, rows.name, is_stated=columns.unit_origin is UnitOrigin.STATED)
    check_one_run_of_one_body(rows.name, valid.lines, trajectory.stamps_ns, trajectory.positions)
    covariance, invalid = None, 0
    if columns.has_covariance:
        covariance, invalid = valid_covariances(covariances_of(values)[is_valid])
    notes = [valid.skipped] if valid.skipped else []
    notes += [f"covariances ignored because they are not positive semi-definite: {invalid}"] if invalid else []
    return LoadedTrajectory(
        path,
        trajectory,
        columns,
        stamps.origin,
        stamps.by_index,
        "; ".join(notes),
        covariance,
        rows=valid.row_numbers,
        row_count=valid.row_count,
    )


def _stamps_of(path: Path, rows: TableRows, values: Values, columns: PoseColumns) -> PoseStamps:
    """Return the stamps of all rows of a table: its own, or those of its frame numbers or lines."""
    if columns.stamp_key is None:
        return stamps_of_frames(path, rows, values[FRAME]) if FRAME in values else stamps_of_lines(path, rows)
    if NANOSECONDS in values:
        return PoseStamps(joined_stamps(rows, values[NANOSECONDS] * columns.fraction_ns))
    return PoseStamps(rows.stamps_ns)


def is_suite_table(path: Path) -> bool:
    """Return whether a line of a file is a header with the names of the csv of the suite, `CSV_HEADER`."""
    names = set(CSV_HEADER.lower().split(","))
    lines = _lines_of(next(read_table(path), b""))[:HEAD_LINES]
    return any(names <= set(header_cells(line.lower(), separator_in(line))) for line in lines)


def _lines_of(block: bytes) -> list[str]:
    """Return the lines of the first block of a table; a text that is not UTF-8 is one of Windows."""
    try:
        text = block.removeprefix(BOM).decode("utf-8")
    except UnicodeDecodeError:
        text = block.decode("cp1252", "replace")
    return split_lines(text)

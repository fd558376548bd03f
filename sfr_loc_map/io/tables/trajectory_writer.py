"""Trajectories as files: the csv of the suite, TUM, KITTI and EuRoC. The ending of a name selects the format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.atomic import write_text
from sfr_loc_map.errors import OutputError
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.stamps.stamp_text import seconds_text
from sfr_loc_map.io.tables.numbered_stamps import times_beside
from sfr_loc_map.io.tables.pose_columns import CSV_HEADER, KITTI_COLUMNS, TrajectoryFormat
from sfr_loc_map.suffixes import check_suffix, suffix_of

TUM_HEADER = "# t x y z qx qy qz qw"
EUROC_HEADER = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
EUROC_SUFFIX = ".euroc.csv"
FORMAT_BY_SUFFIX = {
    ".csv": TrajectoryFormat.CSV,
    ".txt": TrajectoryFormat.TUM,
    ".tum": TrajectoryFormat.TUM,
    ".kitti": TrajectoryFormat.KITTI,
}
"""Formats that are written, by the ending of the file name; `EUROC_SUFFIX` has priority."""
FILE_SUFFIXES = tuple(FORMAT_BY_SUFFIX)


def format_to_write(path: Path) -> TrajectoryFormat:
    """Return the format in which a file is written, by its name; OutputError for another ending."""
    check_suffix(path, FILE_SUFFIXES)
    return TrajectoryFormat.EUROC if path.name.lower().endswith(EUROC_SUFFIX) else FORMAT_BY_SUFFIX[suffix_of(path)]


def format_of_name(path: Path) -> TrajectoryFormat | None:
    """Return the format of a trajectory file by its name; None if it is not the name of a trajectory file."""
    return format_to_write(path) if suffix_of(path) in FORMAT_BY_SUFFIX else None


def files_written(path: Path) -> tuple[Path, ...]:
    """Return the files that `save_trajectory` writes for a name."""
    return (path, times_beside(path)) if format_of_name(path) is TrajectoryFormat.KITTI else (path,)


def save_trajectory(path: Path, trajectory: Trajectory, kind: TrajectoryFormat | None = None) -> None:
    """Write a trajectory with exact numbers; the stamps of KITTI poses are written to `NAME.times.txt`.

    The default `kind` is that of `format_to_write`. OutputError if the file cannot be written.
    """
    path = Path(path)
    kind = kind or format_to_write(path)
    if kind is TrajectoryFormat.KITTI and not trajectory.has_attitude:
        raise OutputError(
            f"cannot write '{path}': the trajectory has no attitudes, which the KITTI format requires; choose a name "
            "that ends in .csv or .txt"
        )
    write_text(trajectory_text(trajectory, kind), path)
    if kind is TrajectoryFormat.KITTI:
        times = "".join(f"{seconds_text(stamp_ns)}\n" for stamp_ns in trajectory.stamps_ns.tolist())
        write_text(times, times_beside(path))


def trajectory_text(trajectory: Trajectory, kind: TrajectoryFormat = TrajectoryFormat.CSV) -> str:
    """Return a trajectory as the text of a file; the KITTI format has no stamps."""
    if kind is TrajectoryFormat.KITTI:
        rotations = OPTICAL_IN_BODY.T @ matrix_from_quat(trajectory.quats_xyzw) @ OPTICAL_IN_BODY
        matrices = np.concatenate((rotations, (trajectory.positions @ OPTICAL_IN_BODY)[:, :, None]), axis=2)
        return "".join(f"{' '.join(map(repr, row))}\n" for row in matrices.reshape(-1, KITTI_COLUMNS).tolist())
    quats, separator, header = {
        TrajectoryFormat.TUM: (trajectory.quats_xyzw, " ", TUM_HEADER),
        TrajectoryFormat.EUROC: (trajectory.quats_xyzw[:, [3, 0, 1, 2]], ",", EUROC_HEADER),
    }.get(kind, (trajectory.att_q_ds_to_rb, ",", CSV_HEADER))
    stamps: list[Any] = trajectory.stamps_ns.tolist()
    if kind is TrajectoryFormat.TUM:
        stamps = list(map(seconds_text, stamps))
    numbers = np.hstack((trajectory.positions, quats)).tolist()
    body = [f"{stamp}{separator}{separator.join(map(repr, row))}" for stamp, row in zip(stamps, numbers, strict=True)]
    return "\n".join([header, *body]) + "\n"

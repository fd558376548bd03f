"""Poses as the KITTI odometry benchmark writes them: twelve numbers a line, no stamps (Geiger et al. 2012).

A line is the first three rows of the homogeneous matrix, row by row, of the left camera in its first frame: x right,
y down, z forward. Here both frames get the axes of the suite (x forward, y left, z up), so that a heading is one. A
rotation of both frames changes neither an absolute nor a relative pose error.

Stamps come from a file of seconds, one a line: `NAME.times.txt` or `times.txt` beside the poses, or, in the layout of
the benchmark, `sequences/NAME/times.txt` beside their folder. Without one the numbers of the lines are the stamps, 1 s
apart.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import plausible_positions, plausible_rotations
from sfr_loc_map.geometry.pose_convention import OPTICAL_IN_BODY
from sfr_loc_map.geometry.rotation import matrix_from_quat, quat_from_matrix
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S, read_table
from sfr_loc_map.io.text_rows import number_rows
from sfr_loc_map.io.trajectory_file import parse_seconds, seconds_text

COLUMNS = 12


def parse_kitti_poses(data: bytes, name: str) -> tuple[FloatArray, FloatArray]:
    """Return positions `(N, 3)` and quaternions `(N, 4)` of a text, in axes of the suite.

    Args:
        data: The text.
        name: Its name, for messages.

    Raises:
        InputError: If a line is no pose; names the line.
    """
    numbers, lines = number_rows(data, COLUMNS, name, "the first three rows of a pose matrix (KITTI)")
    matrices = numbers.reshape(-1, 3, 4)
    good = plausible_rotations(matrices[:, :, :3]) & plausible_positions(matrices[:, :, 3])
    if not good.all():
        line = lines[int(np.argmin(good))]
        raise InputError(f"{name} line {line}: this is no rotation and position; correct or leave out the line")
    rotations = OPTICAL_IN_BODY @ matrices[:, :, :3] @ OPTICAL_IN_BODY.T
    return matrices[:, :, 3] @ OPTICAL_IN_BODY.T, quat_from_matrix(rotations)


def kitti_text(trajectory: Trajectory) -> str:
    """Return poses as KITTI writes them, with optical axes; numbers read back to the same bits."""
    rotations = OPTICAL_IN_BODY.T @ matrix_from_quat(trajectory.quats_xyzw) @ OPTICAL_IN_BODY
    matrices = np.concatenate((rotations, (trajectory.positions @ OPTICAL_IN_BODY)[:, :, None]), axis=2)
    return "".join(f"{' '.join(map(repr, row))}\n" for row in matrices.reshape(-1, COLUMNS).tolist())


def times_text(stamps_ns: IntArray) -> str:
    """Return stamps as seconds, one a line."""
    return "".join(f"{seconds_text(stamp_ns)}\n" for stamp_ns in stamps_ns.tolist())


def times_beside(path: Path) -> Path:
    """Return the name under which stamps are written beside poses."""
    return path.with_name(f"{path.stem}.times.txt")


def find_times(path: Path) -> Path | None:
    """Return the file with the stamps of poses, None where there is none."""
    benchmark = path.parent.parent / "sequences" / path.stem / "times.txt"
    files = (times_beside(path), path.with_name("times.txt"), benchmark)
    return next((file for file in files if file.is_file() and file != path), None)


def read_times(path: Path, count: int) -> IntArray:
    """Return the stamps of a file of seconds `(N,)`, ns.

    Raises:
        InputError: If it cannot be read, or does not hold one for each pose.
    """
    stamps = []
    try:
        words = [line.strip().decode("utf-8", "replace") for line in read_table(path).splitlines()]
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror or error}; give the seconds of each pose") from error
    for number, word in enumerate(words, 1):
        if word and not word.startswith("#"):
            try:
                stamps.append(parse_seconds(word))
            except (ValueError, ArithmeticError) as error:
                raise InputError(f"'{path}' line {number}: '{word[:40]}' is not a number of seconds") from error
    if len(stamps) != count:
        raise InputError(f"'{path}' has {len(stamps)} times for {count} poses: one for each is needed")
    return np.array(stamps, np.int64)


def index_stamps(count: int) -> IntArray:
    """Return the numbers of lines as stamps, 1 s apart."""
    return np.arange(count, dtype=np.int64) * NS_PER_S

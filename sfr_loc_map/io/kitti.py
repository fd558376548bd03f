"""The layout of the KITTI odometry benchmark (Geiger et al. 2012).

    image_0/000000.png  image_1/000000.png   rectified images, left and right (or image_2, image_3: colour)
    calib.txt           P0: ... P3: ...      projection matrices of the rectified cameras, in the frame of camera 0
    times.txt           seconds, one a line
    poses.txt           optional; also found as ../../poses/NAME.txt: 3 x 4 matrices of camera 0 in its first frame

RB is the stereo bench frame SB itself, and DS is RB at the first pose: x forward, y left, z up.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.camera_info import rig_from_projections
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.image_file_sequence import ImageFileSequence, ImagePair, numbers_of, read_lines, whole_pairs
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.trajectory_file import check_order, parse_seconds

CAMERAS = ((0, 1), (2, 3))
"""Numbers of the left and right cameras that are looked for: grey, colour."""
BENCH = Transform.identity()
"""Pose of the bench in RB, which it is."""


def is_kitti(path: Path) -> bool:
    """Tell whether a path looks like a KITTI sequence."""
    return (path / "calib.txt").exists() and any((path / f"image_{left}").is_dir() for left, _ in CAMERAS)


def open_kitti(path: Path) -> Source:
    """Open a KITTI odometry sequence.

    Raises:
        InputError: If a file is missing or broken.
    """
    left, right = next(pair for pair in CAMERAS if (path / f"image_{pair[0]}").is_dir())
    stamps = _load_times(path / "times.txt")
    entries = [
        ImagePair(stamp, path / f"image_{left}" / f"{i:06d}.png", path / f"image_{right}" / f"{i:06d}.png")
        for i, stamp in enumerate(stamps)
    ]
    whole, left_out = whole_pairs(entries, f"'{path / 'times.txt'}'")
    height, width = read_grey(whole[0].left).shape
    projections = _load_calibration(path / "calib.txt")
    rig = _rig(projections, left, right, (width, height), path / "calib.txt")
    truth = _load_poses(path, stamps, rig, -projections[left][3] / projections[left][0])
    sequence = ImageFileSequence(rig, truth, whole, (width, height), lambda a, b: (a, b))
    return Source(path, "kitti", sequence, None, left_out)


def _load_times(path: Path) -> list[int]:
    stamps = []
    for number, line in enumerate(read_lines(path), start=1):
        try:
            stamps.append(parse_seconds(line.strip()))
        except (ValueError, ArithmeticError) as error:
            raise InputError(f"'{path}' line {number}: '{line.strip()[:40]}' is not a number of seconds") from error
    if not stamps:
        raise InputError(f"'{path}' holds no time: a line for each pair is needed")
    check_order(stamps, f"'{path}'", strict=True)
    return stamps


def _load_calibration(path: Path) -> dict[int, FloatArray]:
    projections = {}
    for line in read_lines(path):
        name, _, rest = line.partition(":")
        if name in ("P0", "P1", "P2", "P3"):
            projections[int(name[1])] = np.array(numbers_of(rest.split(), 12, f"'{path}' {name}"))
    return projections


def _rig(cameras: dict[int, FloatArray], left: int, right: int, size: tuple[int, int], path: Path) -> StereoRig:
    if left not in cameras or right not in cameras:
        raise InputError(f"'{path}' has {sorted(f'P{i}' for i in cameras)}: P{left} and P{right} are needed")
    names = (f"P{left}", f"P{right}")
    return replace(rig_from_projections(cameras[left], cameras[right], size, f"'{path}'", names), T_rb_sb=BENCH)


def _load_poses(path: Path, stamps: list[int], rig: StereoRig, offset_m: float) -> Trajectory | None:
    """Return the poses of RB: `T_sb_left inv(T_0_first) T_0_i inv(T_sb_left)`, of the left camera used.

    Args:
        path: Folder of the sequence.
        stamps: Stamps of the pairs.
        rig: Its rig.
        offset_m: Place of the left camera used along x of camera 0.
    """
    files = [path / "poses.txt", path.parent.parent / "poses" / f"{path.resolve().name}.txt"]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        return None
    rows = [numbers_of(line.split(), 12, f"'{file}' pose {i}") for i, line in enumerate(read_lines(file))]
    if len(rows) != len(stamps):
        raise InputError(f"'{file}' has {len(rows)} poses for {len(stamps)} times: one for each is needed")
    T_cam0_left = Transform(np.eye(3), np.array([offset_m, 0.0, 0.0]))
    try:
        matrices = [Transform.from_matrix(np.array(row).reshape(3, 4)) for row in rows]
    except GeometryError as error:
        raise InputError(f"'{file}': {error}; correct the file") from error
    poses = [T_cam0_left.inverse() @ pose @ T_cam0_left for pose in matrices]
    start, T_left_sb = rig.T_sb_left @ poses[0].inverse(), rig.T_sb_left.inverse()
    return Trajectory.from_poses((stamp, start @ pose @ T_left_sb) for stamp, pose in zip(stamps, poses, strict=True))

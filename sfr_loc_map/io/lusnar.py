"""The layout of LuSNAR, a simulated data set of the Moon (Liu et al. 2024, arXiv:2407.06512); one scene (`Moon_1`).

    image0/color/STAMP.png  image1/color/STAMP.png   left and right images, 1024 x 1024, named by nanoseconds
    gt.txt                                           optional: timestamp [ns], p_xyz [m], q_wxyz, ... of the rover

The scenes have these names; the data set's own description has `image1/RGB`, `image2/RGB` and `Rover_pose.txt`, which
are read too. There is no calibration file: cameras and their place on the rover are those of the paper's table. Its
rover and world frames have x forward, y right and z down; RB and DS are these, turned to have z up.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.euroc import load_body_truth
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.image_files import ImageFileSequence, ImagePair, stamped_files, whole_pairs
from sfr_loc_map.io.sequence import Source

LAYOUTS = (("image0/color", "image1/color"), ("image1/RGB", "image2/RGB"))
"""Folders of the left and right images: as the scenes have them, as their description has them."""
TRUTHS = ("gt.txt", "Rover_pose.txt")
SIDE_PX, FOCAL_PX, BASELINE_M = 1024, 610.17784, 0.31
CENTRE_PX = (SIDE_PX - 1) / 2
"""The published centre 512 counts from the corner of the first pixel, this one from its centre."""
LEFT_ON_ROVER_M = (1.0, -0.155, -1.5)
PITCH_DEG = -20.0
"""Place and pitch of the left camera in the rover frame, z down."""
FLIP = Transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
"""Turns a frame with y right and z down to one with y left and z up, and back."""


def is_lusnar(path: Path) -> bool:
    """Tell whether a path looks like a LuSNAR scene."""
    return _folders(path) is not None


def open_lusnar(path: Path) -> Source:
    """Open a LuSNAR scene."""
    folders = _folders(path)
    if folders is None:
        names = " or ".join(f"{left}/ and {right}/" for left, right in LAYOUTS)
        raise InputError(f"'{path}' is no LuSNAR scene: it has not {names}")
    left, right = folders
    stamps = stamped_files(left, "", ".png")
    entries = [ImagePair(stamp, file, right / file.name) for stamp, file in stamps.items()]
    whole, left_out = whole_pairs(entries, f"'{left}'")
    height, width = read_grey(whole[0].left).shape
    if (width, height) != (SIDE_PX, SIDE_PX):
        raise InputError(
            f"image '{whole[0].left}' is {width} x {height}: the published cameras of LuSNAR have {SIDE_PX} x {SIDE_PX}"
        )
    return Source(path, "lusnar", ImageFileSequence(_rig(), whole, _truth(path)), None, left_out)


def _folders(path: Path) -> tuple[Path, Path] | None:
    pairs = ((path / left, path / right) for left, right in LAYOUTS)
    return next((pair for pair in pairs if pair[0].is_dir() and pair[1].is_dir()), None)


def _rig() -> StereoRig:
    pitch = np.radians(PITCH_DEG)
    axes = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # of the camera, in x forward, y right, z down
    tilt = np.array([[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]])
    T_rover_left = Transform(tilt @ axes, np.array(LEFT_ON_ROVER_M))
    rig = StereoRig(SIDE_PX, SIDE_PX, FOCAL_PX, FOCAL_PX, CENTRE_PX, CENTRE_PX, BASELINE_M)
    return replace(rig, T_rb_sb=FLIP @ T_rover_left @ rig.T_sb_left.inverse())


def _truth(path: Path) -> Trajectory | None:
    file = next((path / name for name in TRUTHS if (path / name).is_file()), None)
    poses = load_body_truth(file) if file is not None else None
    if poses is None:
        return None
    stamps = poses.stamps_ns.tolist()
    return Trajectory.from_poses((stamp, FLIP @ poses.pose(i) @ FLIP) for i, stamp in enumerate(stamps))

"""The layout of MADMAX, drives in the Moroccan desert (Meyer et al. 2021); one run (`A-0`).

    img_rect_left/img_rect_left_STAMP.png img_rect_right/...   rectified images, named by nanoseconds
    ground_truth/gt_6DoF_gnss_and_imu.csv                      optional: UNIX time, place (ENU), orientation of B
    ../calibration/camera_rect_left_info.txt, ..right_info.txt camera_info of the rectified cameras as YAML
    ../calibration/tf__imu_to_camera_left.csv, tf__camera_left_to_camera_right.csv, tf__imu_to_B.csv   optional

The archives are unpacked in several ways: folders that end in `rect_left` and `ground_truth` are found, and the
calibration within the run or beside it. RB is the body frame B, DS the frame of the truth. Whether the files
`tf__A_to_B` hold the pose of B in A or its inverse follows from that of the two cameras: the right one is on the right.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import yaml

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import parse_yaml
from sfr_loc_map.io.camera_info import rig_from_projections
from sfr_loc_map.io.image_codec import read_grey
from sfr_loc_map.io.image_files import ImageFileSequence, pairs_of, stamped_files, whole_pairs
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.text_table import check_order, numbers_of, parse_seconds, parse_table, read_data, read_lines

_log = logging.getLogger(__name__)
LEFT, RIGHT = "rect_left", "rect_right"
TRUTH_FOLDER, TRUTH_FILE = "ground_truth", "gt_6DoF_gnss_and_imu.csv"
TRUTH_COLUMNS = ("UNIX time", "x-enu(m)", "y-enu(m)", "z-enu(m)", *(f"orientation.{name}" for name in "xyzw"))
CALIBRATIONS = ("calibration", "calibration/calibration", "../calibration", "../calibration/calibration")
CAMERA = "camera_rect_{side}_info.txt"
BETWEEN, TO_LEFT, TO_BODY = "tf__camera_left_to_camera_right.csv", "tf__imu_to_camera_left.csv", "tf__imu_to_B.csv"
BASELINE_SHARE = 0.05
"""Most that the distance of the cameras by their poses may differ from the baseline of the rectified images."""


def is_madmax(path: Path) -> bool:
    """Tell whether a path looks like a MADMAX run."""
    return path.is_dir() and _folder(path, LEFT) is not None and _folder(path, RIGHT) is not None


def open_madmax(path: Path) -> Source:
    """Open a MADMAX run."""
    left, right = (_require(_folder(path, name), path, f"*{name}/") for name in (LEFT, RIGHT))
    lefts, rights = stamped_files(left, "img_rect_left_", ".png"), stamped_files(right, "img_rect_right_", ".png")
    whole, _ = whole_pairs(pairs_of(lefts, rights, f"'{path}'"), f"'{path}'")
    single = len(lefts.keys() ^ rights.keys())
    if single:
        _log.warning("'%s': %d images without the other side left out", path, single)
    height, width = read_grey(whole[0].left).shape
    folders = (path / name for name in CALIBRATIONS)
    folder = next((item for item in folders if (item / CAMERA.format(side="left")).is_file()), None)
    folder = _require(folder, path, f"calibration/{CAMERA.format(side='left')}, in it or beside it")
    (p_left, turn), (p_right, _) = (_projection(folder / CAMERA.format(side=side)) for side in ("left", "right"))
    rig = rig_from_projections(p_left, p_right, (width, height), f"'{folder}'")
    rig = replace(rig, T_rb_sb=_extrinsics(folder, rig, turn))
    return Source(path, "madmax", ImageFileSequence(rig, whole, _truth(path)), None, single)


def _folder(path: Path, ending: str) -> Path | None:
    return next((item for item in sorted(path.iterdir()) if item.name.endswith(ending) and item.is_dir()), None)


def _require(place: Path | None, path: Path, name: str) -> Path:
    if place is None:
        raise InputError(f"'{path}' has no {name}: a run of MADMAX needs it")
    return place


class _CameraYaml(msgspec.Struct):
    P: Annotated[list[float], msgspec.Meta(min_length=12, max_length=12)]
    R: Annotated[list[float], msgspec.Meta(min_length=9, max_length=9)] | None = None


def _projection(file: Path) -> tuple[FloatArray, FloatArray]:
    """Return P `(12,)` and R `(3, 3)` of a camera_info; without R the identity."""
    try:
        content = parse_yaml("\n".join(line for line in read_lines(file) if line.strip() != "---"))
        camera = msgspec.convert(content, _CameraYaml, strict=False)  # YAML takes 1e-5 for a text
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"'{file}' is no camera_info with P: {' '.join(str(error).split())}") from error
    return np.array(camera.P), np.reshape(camera.R or np.eye(3), (3, 3))


def _extrinsics(folder: Path, rig: StereoRig, turn: FloatArray) -> Transform | None:
    """Return `T_rb_sb`, None without the files for it; `turn` takes the left camera to the rectified one."""
    files = [folder / name for name in (BETWEEN, TO_LEFT, TO_BODY)]
    if not all(file.is_file() for file in files):
        return None
    between, to_left, to_body = (_pose(file) for file in files)
    across = float(between.translation[0])
    if not abs(abs(across) - rig.baseline_m) <= BASELINE_SHARE * rig.baseline_m:
        raise InputError(
            f"'{files[0]}': the cameras are {across:g} m apart along x, by P {rig.baseline_m:g} m; correct the file"
        )
    if across < 0.0:  # the files hold the pose of the first frame in the second
        to_left, to_body = to_left.inverse(), to_body.inverse()
    try:
        T_imu_left = to_left @ Transform(turn, np.zeros(3)).inverse()
        T_rb_sb = to_body.inverse() @ T_imu_left @ rig.T_sb_left.inverse()
        return Transform.from_quat(T_rb_sb.translation, T_rb_sb.quat_xyzw)
    except GeometryError as error:
        raise InputError(f"'{folder}': {error}; correct the files tf__*.csv or R") from error


def _pose(file: Path) -> Transform:
    """Return the transform of a file: a header `#position.x, ..., orientation.w` and a line of numbers."""
    rows = read_lines(file)
    if not rows:
        raise InputError(f"'{file}' holds no transform: a line of seven numbers is needed")
    values = numbers_of(rows[0].replace(",", " ").split(), 7, f"'{file}'")
    try:
        return Transform.from_quat(values[:3], values[3:])
    except GeometryError as error:
        raise InputError(f"'{file}': {error}; correct the file") from error


def _truth(path: Path) -> Trajectory | None:
    """Return the poses in a folder that ends in `ground_truth`, in the run or in a folder of it, None without it."""
    folders = [path, *(item for item in sorted(path.iterdir()) if item.is_dir())]
    places = (place / TRUTH_FILE for folder in folders for place in sorted(folder.glob(f"*{TRUTH_FOLDER}")))
    file = next((file for file in places if file.is_file()), None)
    if file is None:
        return None
    heads = [line for line in read_lines(file) if line.startswith("%") and TRUTH_COLUMNS[0] in line]
    names = [name.strip(" %\t") for name in heads[-1].split(",")] if heads else []
    missing = [name for name in TRUTH_COLUMNS if name not in names]
    if missing:
        raise InputError(f"'{file}' has no column {', '.join(missing)}: a line '% {TRUTH_COLUMNS[0]}, ...' names them")
    places_of = [names.index(name) for name in TRUTH_COLUMNS]
    form, data = ", ".join(names), read_data(file)
    table = parse_table(
        data, f"'{file}'", form, places_of, stamp=parse_seconds, separator=",", more=True, comment=(b"%", b"#")
    )
    check_order(table.stamps_ns, f"'{file}'", strict=False)
    return table.trajectory(table.values[:, :3], table.values[:, 3:]) if table.lines else None

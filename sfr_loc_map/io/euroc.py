"""The layout of the EuRoC MAV data sets (Burri et al. 2016).

    mav0/cam0/{sensor.yaml,data.csv,data/*.png}   left camera: pinhole, radial-tangential distortion, T_BS
    mav0/cam1/...                                 right camera
    mav0/state_groundtruth_estimate0/data.csv     optional: timestamp [ns], p_xyz [m], q_wxyz, ... of B in the world

Images are rectified here, unless they are already: equal cameras without distortion, side by side. RB is the body frame
B, DS the world frame of the truth, whose rate is kept.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.plausibility import check_camera, check_distortion, check_extrinsics
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import parse_yaml
from sfr_loc_map.io.image_file_sequence import ImageFileSequence, ImagePair, numbers_of, read_lines, whole_pairs
from sfr_loc_map.io.raw_stereo import CalibratedCamera, rectified_pair
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.text_numbers import parse_stamp_ns
from sfr_loc_map.io.trajectory_file import check_order

TRUTH = "state_groundtruth_estimate0"


def is_euroc(path: Path) -> bool:
    """Tell whether a path looks like an EuRoC sequence: the folder `mav0` or the one that holds it."""
    return (path / "mav0" / "cam0").is_dir() or (path / "cam0" / "sensor.yaml").exists()


def open_euroc(path: Path) -> Source:
    """Open an EuRoC sequence.

    Raises:
        InputError: If a file is missing or broken, or the cameras cannot be rectified side by side.
    """
    folder = path / "mav0" if (path / "mav0").is_dir() else path
    left, right = (_load_camera(folder / name / "sensor.yaml") for name in ("cam0", "cam1"))
    rig, rectify = rectified_pair(f"'{folder}'", left, right)
    entries, left_out = whole_pairs(_pairs(folder), f"'{folder}'")
    sequence = ImageFileSequence(rig, load_body_truth(folder / TRUTH / "data.csv"), entries, left.size, rectify)
    return Source(path, "euroc", sequence, None, left_out)


def _load_camera(path: Path) -> CalibratedCamera:
    try:
        content: dict[str, Any] = parse_yaml("\n".join(line for line in read_lines(path) if line[:1] != "%"))
        values = {
            "resolution": (2, content["resolution"]),
            "intrinsics": (4, content["intrinsics"]),
            "distortion_coefficients": (4, content["distortion_coefficients"]),
            "T_BS": (16, content["T_BS"]["data"]),
        }
        models = (content["camera_model"], content["distortion_model"])
    except (yaml.YAMLError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"'{path}' is not a sensor.yaml of an EuRoC camera: {' '.join(str(error).split())}") from error
    if models not in (("pinhole", "radial-tangential"), ("pinhole", "radtan")):
        raise InputError(f"'{path}' has the camera model {models}: pinhole with radial-tangential distortion is read")
    numbers = {name: numbers_of([str(v) for v in item], n, f"'{path}' {name}") for name, (n, item) in values.items()}
    fx, fy, cx, cy = numbers["intrinsics"]
    width, height = numbers["resolution"]
    try:
        check_camera((width, height), (fx, fy), (cx, cy))
        check_distortion(numbers["distortion_coefficients"])
        pose = Transform.from_matrix(np.array(numbers["T_BS"]).reshape(4, 4))
        check_extrinsics(pose.translation)
    except GeometryError as error:
        raise InputError(f"'{path}': {error}; correct the file") from error
    return CalibratedCamera(
        (int(width), int(height)),
        np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        np.array(numbers["distortion_coefficients"]),
        pose,
    )


def _pairs(folder: Path) -> list[ImagePair]:
    left, right = (_load_list(folder / name / "data.csv") for name in ("cam0", "cam1"))
    entries = [ImagePair(stamp, left[stamp], right[stamp]) for stamp in sorted(left.keys() & right.keys())]
    if not entries:
        raise InputError(f"'{folder}': none of {len(left)} images of cam0 and {len(right)} of cam1 have equal stamps")
    return entries


def _load_list(path: Path) -> dict[int, Path]:
    files = {}
    for number, line in enumerate(read_lines(path), start=1):
        stamp, _, name = line.partition(",")
        files[_stamp(stamp, f"'{path}' entry {number}")] = path.parent / "data" / name.strip()
    check_order(list(files), f"'{path}'", strict=True)
    return files


def load_body_truth(path: Path) -> Trajectory | None:
    """Read poses `timestamp [ns], p_xyz [m], q_wxyz, ...`, what follows is left out; None without the file or a pose.

    Raises:
        InputError: If the file is broken, or its stamps go backwards.
    """
    if not path.exists():
        return None
    stamps, rows = [], []
    for number, line in enumerate(read_lines(path), start=1):
        words = line.split(",")
        stamps.append(_stamp(words[0], f"'{path}' entry {number}"))
        rows.append(numbers_of(words[1:8], 7, f"'{path}' entry {number}"))
    if not rows:
        return None
    check_order(stamps, f"'{path}'", strict=False)
    values = np.array(rows)
    try:
        return Trajectory(np.array(stamps, np.int64), values[:, :3].copy(), values[:, [4, 5, 6, 3]])
    except GeometryError as error:
        raise InputError(f"'{path}': {error}") from error


def _stamp(text: str, where: str) -> int:
    try:
        return parse_stamp_ns(text)
    except ValueError as error:
        raise InputError(f"{where}: stamp '{text[:40]}' is not whole nanoseconds") from error

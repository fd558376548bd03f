"""The layout of the EuRoC MAV data sets (Burri et al. 2016).

    mav0/cam0/{sensor.yaml,data.csv,data/*.png}   left camera: pinhole, radial-tangential distortion, T_BS
    mav0/cam1/...                                 right camera
    mav0/state_groundtruth_estimate0/data.csv     optional: timestamp [ns], p_xyz [m], q_wxyz, ... of B in the world

Images are rectified here, unless they are already: equal cameras without distortion, side by side. RB is the body frame
B, DS the world frame of the truth, whose rate is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from sfr_loc_map.bounded_input import parse_yaml
from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.plausibility import check_camera, check_distortion, check_extrinsics
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.camera_info import baseline_from_projection
from sfr_loc_map.io.image_file_sequence import ImageFileSequence, ImagePair, numbers_of, read_lines, whole_pairs
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.text_numbers import parse_stamp_ns
from sfr_loc_map.io.trajectory_file import check_order

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
TRUTH = "state_groundtruth_estimate0"
RECTIFIED_TOLERANCE = 1e-9
"""Cameras that differ from a rectified pair by no more, in radians and metres, are one."""


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """A camera as its sensor.yaml gives it."""

    size: tuple[int, int]
    k: FloatArray
    distortion: FloatArray
    T_body_cam: Transform


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
    if left.size != right.size:
        raise InputError(f"'{folder}': cam0 is {left.size}, cam1 {right.size}: both images need one size")
    entries, left_out = whole_pairs(_pairs(folder), f"'{folder}'")
    truth = _load_truth(folder / TRUTH / "data.csv")
    rig = _rectified_rig(folder, left, right)
    if rig is not None:
        return Source(
            path, "euroc", ImageFileSequence(rig, truth, entries, left.size, lambda a, b: (a, b)), None, left_out
        )
    rig, maps = _rectification(folder, left, right)

    def rectify(a: GreyImage, b: GreyImage) -> tuple[GreyImage, GreyImage]:
        images = [
            cv2.remap(image, column, row, cv2.INTER_LINEAR) for image, (column, row) in zip((a, b), maps, strict=True)
        ]
        return np.asarray(images[0], np.uint8), np.asarray(images[1], np.uint8)

    return Source(path, "euroc", ImageFileSequence(rig, truth, entries, left.size, rectify), None, left_out)


def _load_camera(path: Path) -> _Camera:
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
        raise InputError(f"'{path}' is no sensor.yaml of an EuRoC camera: {' '.join(str(error).split())}") from error
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
    return _Camera(
        (int(width), int(height)),
        np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        np.array(numbers["distortion_coefficients"]),
        pose,
    )


def _rectified_rig(folder: Path, left: _Camera, right: _Camera) -> StereoRig | None:
    """Return the rig of images that are rectified already, None where they are not."""
    T_left_right = left.T_body_cam.inverse() @ right.T_body_cam
    across = T_left_right.translation
    off = max(float(np.abs(T_left_right.rotation - np.eye(3)).max()), float(np.abs(across[1:]).max()))
    plain = not left.distortion.any() and not right.distortion.any() and np.array_equal(left.k, right.k)
    if not plain or off > RECTIFIED_TOLERANCE or not across[0] > 0.0:
        return None
    fx, cx, fy, cy = (float(left.k[i]) for i in ((0, 0), (0, 2), (1, 1), (1, 2)))
    try:
        rig = StereoRig(*left.size, fx, fy, cx, cy, round(float(across[0]), 12))  # what the product of poses adds
        T_rb_sb = left.T_body_cam @ rig.T_sb_left.inverse()
        return replace(rig, T_rb_sb=Transform.from_quat(T_rb_sb.translation, T_rb_sb.quat_xyzw))
    except GeometryError as error:
        raise InputError(f"'{folder}': {error}; correct its sensor.yaml") from error


def _rectification(folder: Path, left: _Camera, right: _Camera) -> tuple[StereoRig, list[Maps]]:
    """Return the rectified rig and, for left and right, the maps for `cv2.remap` (Bouguet's method, no black rim)."""
    T_right_left = right.T_body_cam.inverse() @ left.T_body_cam
    rotations_and_projections = cv2.stereoRectify(
        *(left.k, left.distortion, right.k, right.distortion, left.size),
        *(T_right_left.rotation, T_right_left.translation),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )
    r_left, r_right, p_left, p_right = (np.asarray(m, np.float64) for m in rotations_and_projections[:4])
    if not p_right[0, 3] < 0 or p_right[1, 3] != 0:
        raise InputError(
            f"'{folder}': cam1 is not to the right of cam0; are the cameras swapped or one above the other?"
        )
    fx, fy, cx, cy = (float(p_left[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    baseline = baseline_from_projection(fx, float(p_right[0, 3]))
    T_body_left = Transform(left.T_body_cam.rotation @ r_left.T, left.T_body_cam.translation)
    try:
        rig = StereoRig(*left.size, fx, fy, cx, cy, baseline)
        T_rb_sb = T_body_left @ rig.T_sb_left.inverse()
        rig = StereoRig(
            *left.size, fx, fy, cx, cy, baseline, Transform.from_quat(T_rb_sb.translation, T_rb_sb.quat_xyzw)
        )
    except GeometryError as error:
        raise InputError(f"'{folder}': the cameras cannot be rectified: {error}") from error
    cameras = ((left, r_left, p_left), (right, r_right, p_right))
    return rig, [_maps(*camera) for camera in cameras]


def _maps(camera: _Camera, rotation: FloatArray, projection: FloatArray) -> Maps:
    """Return the column and row, in the image as taken, of each pixel of the rectified one."""
    args = (camera.k, camera.distortion, rotation, projection[:, :3], camera.size, cv2.CV_32FC1)
    columns, rows = cv2.initUndistortRectifyMap(*args)
    return np.asarray(columns, np.float32), np.asarray(rows, np.float32)


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


def _load_truth(path: Path) -> Trajectory | None:
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

"""ORB-SLAM: settings with LEFT.K, RIGHT.K, ..., with Camera1, Camera2 and Stereo.T_c1_c2, or with Camera.bf."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.calibration.opened_file import OpenedFile, number_of, numbers_of, plain_name, whole_size
from sfr_loc_map.io.calibration.programs.shared import four_intrinsics, lens_model
from sfr_loc_map.io.calibration.projections import check_centre
from sfr_loc_map.io.calibration.rectification import RectifiableCamera
from sfr_loc_map.io.calibration.stereo_calibration import (
    CameraPair,
    PosedCamera,
    check_one_baseline,
    with_rectification,
)
from sfr_loc_map.message_text import counted
from sfr_loc_map.suite_names import SIDES


def read_orb_slam(opened: OpenedFile) -> CameraPair:
    """Read settings of ORB-SLAM: R and P of raw images (LEFT.K, ...), two raw cameras, or one rectified camera."""
    text = f"ORB-SLAM '{opened.file.name}'"
    if "left.k" in opened.content:
        left, right = (_side(opened.content, side.upper()).checked(text) for side in SIDES)
        return CameraPair(left, right, f"{text}, LEFT and RIGHT")
    first = "Camera1" if "camera1.fx" in opened.content else "Camera"
    if "camera2.fx" in opened.content:
        return _raw_pair(opened, first, text)
    return _rectified_pair(opened, first, text)


def _side(content: Mapping[str, Any], side: str) -> RectifiableCamera:
    """Return the camera of `LEFT` or `RIGHT` in older settings."""
    k, d, r, p = (numbers_of(content, f"{side}.{name}") for name in "KDRP")
    size = whole_size(number_of(content, f"{side}.width"), number_of(content, f"{side}.height"))
    return RectifiableCamera(size, lens_model(d, False), d, k, r, p)


def _raw_pair(opened: OpenedFile, first: str, text: str) -> CameraPair:
    """Return two raw cameras with the pose Stereo.T_c1_c2 of the right camera, which older files call Tlr."""
    content = opened.content
    size = _size(opened, first)
    numbers = numbers_of(content, "Stereo.T_c1_c2", "Tlr")
    if len(numbers) not in (12, 16):
        raise ValueError(f"Stereo.T_c1_c2 has {counted(len(numbers), 'number')}: 12 or 16 are required")
    T_left_right = np.eye(4)
    T_left_right[:3] = np.array(numbers[:12]).reshape(3, 4)
    if "stereo.b" in content:
        baseline_m = float(np.linalg.norm(T_left_right[:3, 3]))
        check_one_baseline({"Stereo.b": number_of(content, "Stereo.b"), "Stereo.T_c1_c2": baseline_m})
    is_fisheye = _is_kannala_brandt(content)
    cameras = []
    for name, pose in ((first, np.eye(4)), ("Camera2", T_left_right)):
        d = _distortion(content, name)
        intrinsics = _intrinsics(content, name)
        cameras.append(PosedCamera(size, intrinsics, d, Transform.from_matrix(pose), lens_model(d, is_fisheye)))
    return CameraPair(*with_rectification(text, *cameras), f"{text}, {first} and Camera2")


def _rectified_pair(opened: OpenedFile, name: str, text: str) -> CameraPair:
    """Return a pair of rectified images: one camera without distortion, and a baseline from Camera.bf or Stereo.b."""
    content = opened.content
    size = _size(opened, name)
    if _is_kannala_brandt(content) or any(_distortion(content, name)):
        raise ValueError(
            f"{name} has a distortion but there is no Camera2: the settings are of one raw camera, not "
            "of a stereo pair; give the calibration of both cameras"
        )
    fx, fy, cx, cy = _intrinsics(content, name)
    shifts = {"Stereo.b": fx * number_of(content, "Stereo.b")} if "stereo.b" in content else {}
    if "camera.bf" in content or not shifts:
        shifts["Camera.bf"] = number_of(content, "Camera.bf")
    if not fx > 0.0:
        raise ValueError(f"{name}.fx is {fx:g}: a positive focal length is required")
    check_one_baseline({origin: shift / fx for origin, shift in shifts.items()})
    for origin, shift in shifts.items():
        if not shift > 0.0:
            raise ValueError(f"{origin} is {number_of(content, origin):g}: a positive baseline is required")
    ps = [(fx, 0.0, cx, -move, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0) for move in (0.0, next(iter(shifts.values())))]
    left, right = (RectifiableCamera.of_rectified(size, np.array(p)) for p in ps)
    return CameraPair(left, right, f"{text}, rectified")


def _size(opened: OpenedFile, name: str) -> tuple[int, int]:
    """Return the size in the settings, or that of the images if the settings have no size."""
    if opened.size is not None and "camera.width" not in opened.content:
        cx, cy = _intrinsics(opened.content, name)[2:]
        check_centre(cx, cy, opened.size, f"calibration '{opened.file}'")
        return opened.size
    return whole_size(number_of(opened.content, "Camera.width"), number_of(opened.content, "Camera.height"))


def _intrinsics(content: Mapping[str, Any], name: str) -> tuple[float, float, float, float]:
    return four_intrinsics([number_of(content, f"{name}.{item}") for item in ("fx", "fy", "cx", "cy")])


def _distortion(content: Mapping[str, Any], name: str) -> tuple[float, ...]:
    """Return the coefficients in OpenCV's order; missing coefficients are 0."""
    names = ("k1", "k2", "k3", "k4") if _is_kannala_brandt(content) else ("k1", "k2", "p1", "p2", "k3")
    items = (f"{name}.{item}" for item in names)
    return tuple(number_of(content, item) if plain_name(item) in content else 0.0 for item in items)


def _is_kannala_brandt(content: Mapping[str, Any]) -> bool:
    return "kannala" in str(content.get("camera.type", "")).lower()

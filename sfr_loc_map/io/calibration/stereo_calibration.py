"""Two calibrated cameras as a rectified stereo rig: R and P of both cameras from their intrinsics and poses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import check_camera, check_distortion, check_extrinsics
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.calibration.projections import BASELINE_TOLERANCE
from sfr_loc_map.io.calibration.rectification import (
    FISHEYE,
    MIN_VALID,
    RectifiableCamera,
    StereoRectifier,
    check_coefficients,
    rig_of_cameras,
    valid_fraction,
)

FOCAL_RATIO = (0.5, 2.0)
"""Accepted ratios of the rectified to the original focal length. With wide fisheye lenses, OpenCV chooses a focal
length far below this range."""
RECTIFIED_TOLERANCE = 1e-9
"""Largest deviation of two cameras from a rectified pair, rad and m, that requires no rectification."""


class CameraPair(NamedTuple):
    """The left and the right camera as a calibration file states them, with R and P."""

    left: RectifiableCamera
    right: RectifiableCamera
    text: str  #: Program, file, left and right camera: `Kalibr 'camchain.yaml', cam0 and cam1`.
    T_rb_sb: Transform | None = None  #: Pose of the rig in RB, if the file has it.
    T_body_left: Transform | None = None  #: Pose of the left camera, before rectification, in the body of the file.
    names: tuple[str, str] | None = None
    """Names of the left and the right camera (`cam1`, `cam0`), if the geometry determines which camera is left."""

    def check_images(self, left: str, right: str, fix: str) -> None:
        """Raise InputError if the names of the left and right images are those of the right and left camera."""
        if self.names is None:
            return
        left_words, right_words = _different_words(left, right)
        left_camera, right_camera = _different_words(*self.names)
        if left_words & right_camera or right_words & left_camera:
            raise InputError(
                f"'{left}' is read as the left and '{right}' as the right images, but {self.names[0]} is the left "
                f"camera of the calibration ({self.text}):",
                f"are left and right swapped? {fix}",
            )


@dataclass(frozen=True, slots=True, eq=False)
class StereoCalibration:
    """The rectified rig of two cameras, and the rectification of their images."""

    pair: CameraPair
    rig: StereoRig  #: Rig of the rectified images, with its pose in RB if the file has it.
    rectifier: StereoRectifier | None  #: None if the images need no rectification.


def calibrated(pair: CameraPair, where: str) -> StereoCalibration:
    """Return the rectified rig of two cameras of one image size, and the rectification of their images.

    InputError, which begins with `where`, if the cameras are not a side-by-side pair with a plausible baseline, or if
    the images cannot be rectified.
    """
    names = f"{where}, left camera", f"{where}, right camera"
    rig, rectifier = rig_of_cameras((pair.left, pair.right), where, names)
    return StereoCalibration(pair, replace(rig, T_rb_sb=pair.T_rb_sb), rectifier)


def check_one_baseline(baselines_m: Mapping[str, float]) -> None:
    """Raise ValueError if two values in a calibration state different baselines (m, by the name of the value)."""
    for (name, baseline_m), (other, other_m) in pairwise(baselines_m.items()):
        if not abs(baseline_m - other_m) <= BASELINE_TOLERANCE * abs(other_m):
            raise ValueError(
                f"{name} states a baseline of {baseline_m:g} m, but {other} states {other_m:g} m: equal baselines are "
                "required"
            )


def _different_words(one: str, other: str) -> tuple[set[str], set[str]]:
    """Return the words (`cam0`) of each of two names that the other name does not have."""
    words, others = (set(re.findall(r"[a-z0-9]+", name.lower())) for name in (one, other))
    return words - others, others - words


@dataclass(frozen=True, slots=True, eq=False)
class PosedCamera:
    """A camera with its intrinsics and its pose, for which R and P of a rectification can be computed."""

    size: tuple[int, int]
    """Width and height of the images, pixels."""
    intrinsics: tuple[float, float, float, float]
    """fx, fy, cx, cy, pixels; pixel centres are at integer coordinates."""
    distortion: tuple[float, ...]
    """Distortion coefficients of the model, in OpenCV's order."""
    T_body_cam: Transform
    model: str = "plumb_bob"

    def __post_init__(self) -> None:
        fx, fy, cx, cy = self.intrinsics
        check_camera(self.size, (fx, fy), (cx, cy))
        check_distortion(self.distortion)
        check_coefficients(self.model, self.distortion, "the camera")
        check_extrinsics(self.T_body_cam.translation, "the camera", "its body")

    @property
    def k(self) -> FloatArray:
        """Camera matrix `(3, 3)`."""
        fx, fy, cx, cy = self.intrinsics
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def rectified_by(self, rotation: FloatArray, projection: FloatArray) -> RectifiableCamera:
        """Return the camera with the R `(3, 3)` and P `(3, 4)` that rectify its images."""
        numbers = (tuple(np.ravel(matrix).tolist()) for matrix in (self.k, rotation, projection))
        return RectifiableCamera(self.size, self.model, self.distortion, *numbers)


def with_rectification(name: str, left: PosedCamera, right: PosedCamera) -> tuple[RectifiableCamera, RectifiableCamera]:
    """Return both cameras with the R and P that rectify them; R = I if the pair is already rectified."""
    if left.size != right.size:
        sizes = " and ".join(f"{width} x {height}" for width, height in (left.size, right.size))
        raise InputError(f"{name}: the sizes of the left and right camera are {sizes} px:", "equal sizes are required")
    if (left.model in FISHEYE) != (right.model in FISHEYE):
        raise InputError(
            f"{name}: the lens models of the left and right camera are {left.model} and {right.model}:",
            "calibrate both cameras with one model",
        )
    T_right_left = right.T_body_cam.inverse() @ left.T_body_cam
    right_m = -T_right_left.rotation.T @ T_right_left.translation  # position in the frame of the left camera
    if right_m[0] <= 0.0 or abs(right_m[1]) > right_m[0]:
        raise _not_side_by_side(name, right_m)
    if _is_rectified(left, right, T_right_left.rotation, right_m):
        baseline_m = round(float(right_m[0]), 12)  # removes the rounding errors of the poses
        rotations = [np.eye(3), np.eye(3)]
        projections = [np.c_[left.k, np.zeros(3)], np.c_[left.k, (-(left.intrinsics[0] * baseline_m), 0.0, 0.0)]]
    else:
        rotations, projections = _bouguet(name, left, right, T_right_left)
        if not projections[1][0, 3] < 0 or projections[1][1, 3] != 0:
            raise _not_side_by_side(name, right_m)
    one, other = map(PosedCamera.rectified_by, (left, right), rotations, projections)
    return one, other


def _not_side_by_side(name: str, right_m: FloatArray) -> InputError:
    """Return the error for a right camera that is not to the right; `right_m` is its position in the left camera."""
    place = ", ".join(f"{value + 0.0:.4g}" for value in right_m)
    return InputError(
        f"{name}: the right camera is at ({place}) m in the frame of the left camera (x right, y down): a position to "
        "the right is required;",
        "are the cameras swapped, or one above the other? Correct the calibration",
    )


def _is_rectified(left: PosedCamera, right: PosedCamera, rotation: FloatArray, right_m: FloatArray) -> bool:
    """Return whether the images need no rectification; `rotation` and `right_m` are the pose between the cameras."""
    has_distortion = any(left.distortion) or any(right.distortion)
    turn = float(np.abs(rotation - np.eye(3)).max())
    shift_m = float(np.abs(right_m[1:]).max())
    is_parallel = max(turn, shift_m) <= RECTIFIED_TOLERANCE
    return is_parallel and not has_distortion and left.intrinsics == right.intrinsics


def _bouguet(
    name: str, left: PosedCamera, right: PosedCamera, T_right_left: Transform
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return R and P of both cameras by Bouguet's method in OpenCV, without black borders.

    If OpenCV's P covers the field of view poorly (wide fisheye lenses), P has the focal length of the cameras instead.
    """
    d_left, d_right = np.array(left.distortion), np.array(right.distortion)
    cameras = (left, right)
    pair = left.k, d_left, right.k, d_right, left.size, T_right_left.rotation, T_right_left.translation
    with refusing(f"{name}: the cameras cannot be rectified", "correct the calibration"):
        try:
            if left.model in FISHEYE:
                matrices = cv2.fisheye.stereoRectify(*pair, flags=cv2.CALIB_ZERO_DISPARITY, balance=0)[:4]
            else:
                matrices = cv2.stereoRectify(*pair, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0)[:4]
        except cv2.error as error:
            raise ValueError(str(error)) from error
    rotations, projections = (
        [np.asarray(matrix, np.float64) for matrix in part] for part in (matrices[:2], matrices[2:])
    )
    if _coverage_problem(cameras, rotations, projections):
        projections = [*_kept_projections(cameras, rotations, float(projections[1][0, 3] / projections[1][0, 0]))]
        if problem := _coverage_problem(cameras, rotations, projections):
            raise InputError(f"{name}: the cameras cannot be rectified: {problem};", "correct the calibration")
    return rotations, projections


def _kept_projections(
    cameras: Sequence[PosedCamera], rotations: Sequence[FloatArray], shift: float
) -> tuple[FloatArray, FloatArray]:
    """Return projections with the mean focal length that keep the cameras' principal points in place on average."""
    focal = float(np.mean([camera.intrinsics[:2] for camera in cameras]))
    axes = np.array([rotation[:, 2] for rotation in rotations])  # optical axes in the rectified frame
    centres = np.array([camera.intrinsics[2:] for camera in cameras])
    centre = (centres - focal * axes[:, :2] / axes[:, 2:]).mean(axis=0)
    one = np.array([[focal, 0.0, centre[0], 0.0], [0.0, focal, centre[1], 0.0], [0.0, 0.0, 1.0, 0.0]])
    other = one.copy()
    other[0, 3] = focal * shift
    return one, other


def _coverage_problem(
    cameras: Sequence[PosedCamera], rotations: Sequence[FloatArray], projections: Sequence[FloatArray]
) -> str:
    """Return why a rectification does not cover the field of view of the cameras; empty if there is no problem."""
    for camera, rotation, projection in zip(cameras, rotations, projections, strict=True):
        rectifiable = camera.rectified_by(rotation, projection)
        width, height = camera.size
        focal, centre = float(projection[0, 0]), projection[:2, 2]
        ratio = focal / float(np.mean(camera.intrinsics[:2]))
        if not FOCAL_RATIO[0] <= ratio <= FOCAL_RATIO[1]:
            return f"the rectified focal length is {focal:.4g} px, {ratio:.3g} times that of the camera"
        if not (0.0 <= centre[0] < width and 0.0 <= centre[1] < height):
            return (
                f"the rectified principal point ({centre[0]:.4g}, {centre[1]:.4g}) px is outside of the image of "
                f"{width} x {height} px"
            )
        fraction = valid_fraction(rectifiable.maps()[0], camera.size)
        if fraction < MIN_VALID:
            return f"raw pixels are mapped to {100.0 * fraction:.3g} % of the rectified image"
    return ""


def pose_of_rig(pair: CameraPair, rig: StereoRig) -> Transform | None:
    """Return the pose of the rectified rig of two cameras in the body of their file; None if the file has no body."""
    if pair.T_body_left is None:
        return None
    R_body_left = pair.T_body_left.rotation @ np.reshape(pair.left.r, (3, 3)).T
    T_body_sb = Transform(R_body_left, pair.T_body_left.translation) @ rig.T_sb_left.inverse()
    return Transform.from_quat(T_body_sb.translation, T_body_sb.quat_xyzw)

"""Rectification of raw images by D, K, R and P of sensor_msgs/CameraInfo; the remap tables are computed once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.plausibility import check_camera, check_distortion, check_extrinsics
from sfr_loc_map.geometry.stereo import SAME_PX, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import SIDES, refusing
from sfr_loc_map.io.calibration.camera_info import (
    TOLERANCE,
    have_one_camera_matrix,
    rig_from_camera_info,
    rig_from_projections,
)

Rectify = Callable[[GreyImage, GreyImage], tuple[GreyImage, GreyImage]]
COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,), "fisheye": (4,)}
"""Supported distortion models, and the numbers of coefficients that each may have."""
FISHEYE = ("equidistant", "fisheye")
FOCAL_RATIO = (0.5, 2.0)
"""Accepted ratio of rectified to original focal length. OpenCV's choice is far smaller for wide fisheye lenses."""
MIN_VALID = 0.25  #: Smallest accepted fraction of a rectified image that raw pixels cover.
SAME_DIRECTION = 1e-5  #: Smaller changes of a distortion coefficient or an entry of R are ignored (`SAME_PX`).
RECTIFIED_TOLERANCE = 1e-9
"""Largest deviation of calibrated cameras from a rectified pair, rad and m, that needs no rectification."""


@dataclass(frozen=True, slots=True)
class RawCamera:
    """The calibration of a camera whose images are not rectified: distortion, K, R and P of sensor_msgs/CameraInfo."""

    size: tuple[int, int]  #: Width and height, pixels.
    model: str  #: Model of the distortion, one of `COEFFICIENTS`.
    d: tuple[float, ...]  #: Coefficients of the distortion.
    k: tuple[float, ...]  #: Camera matrix of the raw image `(9,)`, row-major, pixels.
    r: tuple[float, ...]  #: Rotation to the rectified camera `(9,)`, row-major.
    p: tuple[float, ...]  #: Projection matrix of the rectified image `(12,)`, row-major, pixels.

    @classmethod
    def of(cls, name: str, info: Any) -> RawCamera:  # noqa: ANN401 - a CameraInfo of any library
        """Return the calibration in a sensor_msgs/CameraInfo; `name` is its topic (`loc/left/camera_info`)."""
        lists = (np.asarray(values, np.float64).reshape(-1).tolist() for values in (info.d, info.k, info.r, info.p))
        d, k, r, p = (tuple(values) for values in lists)
        model = str(info.distortion_model)
        if not model and not any(d):
            model = "plumb_bob"
        if model not in COEFFICIENTS:
            known = ", ".join(COEFFICIENTS)
            raise InputError(f"{name} has distortion model '{model[:40]}': one of {known} can be rectified")
        d = d or (0.0,) * COEFFICIENTS[model][0]  # a lens without distortion may have no coefficients
        if len(d) not in COEFFICIENTS[model]:
            wanted = " or ".join(map(str, COEFFICIENTS[model]))
            raise InputError(f"{name} has {len(d)} coefficients d: model {model} needs {wanted}")
        roi = info.roi
        has_full_size = (roi.width, roi.height) in ((0, 0), (info.width, info.height))
        is_cropped = not has_full_size or roi.x_offset or roi.y_offset
        if is_cropped or info.binning_x > 1 or info.binning_y > 1:
            raise InputError(f"{name} has binning or a region of interest: send full images without binning")
        is_complete = (len(k), len(r), len(p)) == (9, 9, 12) and np.isfinite([*d, *k, *r, *p]).all()
        if not is_complete or k[0] <= 0.0 or k[4] <= 0.0 or p[0] <= 0.0:
            raise InputError(f"{name} has no k or p, or numbers that are not finite: calibrate the camera")
        r = r if any(r) else tuple(np.eye(3).reshape(-1).tolist())
        rotation = np.reshape(r, (3, 3))
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
            raise InputError(f"{name}: r is not a rotation: calibrate the pair")
        return cls((int(info.width), int(info.height)), model, d, k, r, p)

    def maps(self) -> Sequence[Any]:
        """Return OpenCV's fixed-point maps (1/32 pixel) from rectified to raw pixels."""
        k = np.reshape(self.k, (3, 3))
        r = np.reshape(self.r, (3, 3))
        p = np.reshape(self.p, (3, 4))[:, :3]
        make = cv2.fisheye.initUndistortRectifyMap if self.model in FISHEYE else cv2.initUndistortRectifyMap
        return make(k, np.array(self.d), r, p, self.size, cv2.CV_16SC2)

    def is_same(self, other: RawCamera) -> bool:
        """Return whether both calibrations agree within `SAME_PX`, because drivers round the values of each message."""
        if (self.size, self.model, len(self.d)) != (other.size, other.model, len(other.d)):
            return False
        change_px = max(_largest_difference(self.k, other.k), _largest_difference(self.p, other.p))
        change = max(_largest_difference(self.d, other.d), _largest_difference(self.r, other.r))
        return change_px < SAME_PX and change < SAME_DIRECTION

    @property
    def info(self) -> SimpleNamespace:
        """The calibration with the fields of a sensor_msgs/CameraInfo."""
        width, height = self.size
        roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
        matrices = {"d": self.d, "k": self.k, "r": self.r, "p": self.p}
        rest = {"distortion_model": self.model, "roi": roi, "binning_x": 0, "binning_y": 0}
        return SimpleNamespace(width=width, height=height, **matrices, **rest)

    @property
    def is_rectified(self) -> bool:
        """Whether the images are already rectified."""
        if any(self.d):
            return False
        p = np.reshape(self.p, (3, 4))[:, :3].reshape(-1)
        rotation = _largest_difference(self.r, np.eye(3).reshape(-1))
        return max(rotation, _largest_difference(self.k, p)) <= TOLERANCE


def _largest_difference(numbers: ArrayLike, others: ArrayLike) -> float:
    """Return the largest absolute difference of two lists of equal length; NaN if a number is NaN."""
    return float(np.abs(np.subtract(numbers, others)).max())


class StereoRectifier:
    """Rectifies the image pairs of a left and a right camera."""

    def __init__(self, cameras: tuple[RawCamera, RawCamera], name: str = "the camera") -> None:
        """Compute the maps; InputError if raw pixels cover less than `MIN_VALID` of a rectified image."""
        self.cameras = cameras
        self._maps = tuple(camera.maps() for camera in cameras)
        for side, camera, maps in zip(SIDES, cameras, self._maps, strict=True):
            fraction = _valid_fraction(maps[0], camera.size)
            is_centred = all(
                0.0 <= centre < side_px for centre, side_px in zip(camera.p[2::4], camera.size, strict=False)
            )
            if fraction < MIN_VALID or not is_centred:
                raise InputError(
                    f"{name}/{side}: with its R and P the raw image covers {100.0 * fraction:.3g} % of the "
                    "rectified image "
                    f"(focal length {camera.p[0]:g} px, principal point ({camera.p[2]:g}, {camera.p[6]:g}) of "
                    f"{camera.size[0]} x {camera.size[1]}): calibrate the pair again, or give a calibration "
                    "whose R and P fit the images"
                )

    def rectify(self, left: GreyImage, right: GreyImage) -> tuple[GreyImage, GreyImage]:
        """Return the rectified images; pixels outside of the raw image are 0."""
        return _remapped(left, self._maps[0]), _remapped(right, self._maps[1])


def rectified_rig(
    infos: Sequence[Any], name: str, before: StereoRectifier | None = None
) -> tuple[StereoRig, StereoRectifier]:
    """Return the rig and the rectifier of two raw CameraInfo (`loc` or `nav`); reuse `before` if its cameras are equal.

    Both images are rectified to the P of the left camera, even if the P of the right camera differs.
    """
    left, right = (RawCamera.of(f"{name}/{side}/camera_info", info) for side, info in zip(SIDES, infos, strict=True))
    if left.size == right.size and right.p[0] > 0.0:
        right = replace(right, p=tuple(_in_common(np.array(left.p), np.array(right.p)).tolist()))
    one, other = (replace(camera, d=(), k=(0.0,) * 9, r=(0.0,) * 9).info for camera in (left, right))
    rig = rig_from_camera_info(one, other, name)
    return rig, _rectifier((left, right), name, before)


def rig_of_rectified(
    infos: Sequence[Any], name: str, before: StereoRectifier | None = None
) -> tuple[StereoRig, StereoRectifier | None]:
    """Return the rig of rectified images, from P of two CameraInfo, and a rectifier if the P differ.

    P of left and right may differ in focal length and principal point (OpenCV without CALIB_ZERO_DISPARITY, crops). A
    difference that moves no pixel by more than `SAME_PX` is ignored. For a larger difference the rectifier remaps the
    right images; `before` is reused if its cameras are equal.
    """
    left, right = infos
    p_left, p_right = (np.asarray(info.p, np.float64).reshape(-1) for info in infos)
    sizes_equal = (left.width, left.height) == (right.width, right.height)
    complete = p_left.shape == p_right.shape == (12,) and np.isfinite([p_left, p_right]).all()
    if not complete or not sizes_equal or p_left[0] <= 0.0 or p_right[0] <= 0.0 or p_right[5] <= 0.0:
        return rig_from_camera_info(left, right, name), None
    if have_one_camera_matrix(p_left, p_right):
        return rig_from_camera_info(left, right, name), None
    common = _in_common(p_left, p_right)
    other = SimpleNamespace(**{**_fields_of(right), "p": common})
    rig = rig_from_camera_info(left, other, name)
    size = (int(left.width), int(left.height))
    if _largest_shift_px(p_left, p_right, size) <= SAME_PX:
        return rig, None
    cameras = []
    for p, target in ((p_left, p_left), (p_right, common)):
        k = np.reshape(p, (3, 4))[:, :3].reshape(-1)
        parts = (tuple(values.tolist()) for values in (k, np.eye(3).reshape(-1), target))
        cameras.append(RawCamera(size, "plumb_bob", (0.0,) * 5, *parts))
    return rig, _rectifier((cameras[0], cameras[1]), name, before)


def _in_common(p_left: FloatArray, p_right: FloatArray) -> FloatArray:
    """Return the P `(12,)` of the right camera with the camera matrix of the left camera and an unchanged baseline."""
    common = p_left.copy()
    if have_one_camera_matrix(p_left, p_right):
        common[3] = p_right[3]
    else:
        common[3] = p_left[3] - p_left[0] * (p_left[3] / p_left[0] - p_right[3] / p_right[0])
    common[[7, 11]] = p_right[[7, 11]]
    return common


def _rectifier(cameras: tuple[RawCamera, RawCamera], name: str, before: StereoRectifier | None) -> StereoRectifier:
    """Return a rectifier of two cameras; reuse `before` if its cameras are equal, because maps are slow to compute."""
    if before is not None and all(map(RawCamera.is_same, before.cameras, cameras)):
        return before
    return StereoRectifier(cameras, name)


def _fields_of(info: Any) -> dict[str, Any]:  # noqa: ANN401 - a CameraInfo of any library
    """Return the fields of a CameraInfo from which a rig is computed."""
    return {name: getattr(info, name) for name in ("width", "height", "d", "k", "r", "p")}


def _largest_shift_px(p_left: FloatArray, p_right: FloatArray, size: tuple[int, int]) -> float:
    """Return the largest shift of a corner of the right image, along rows or columns, if the left P is used for it."""
    shifts = []
    for axis, (focal, centre) in enumerate(((0, 2), (5, 6))):
        for corner in (0.0, float(size[axis] - 1)):
            ray = (corner - p_right[centre]) / p_right[focal]
            shifts.append(abs(ray * p_left[focal] + p_left[centre] - corner))
    return float(max(shifts))


def _valid_fraction(places: Any, size: tuple[int, int]) -> float:  # noqa: ANN401 - of OpenCV
    """Return the fraction of a rectified image that raw pixels cover; `places` `(H, W, 2)` are raw pixel positions."""
    width, height = size
    u, v = places[:, :, 0], places[:, :, 1]
    return float(((u >= 0) & (u < width) & (v >= 0) & (v < height)).mean())


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedCamera:
    """A calibrated camera before rectification."""

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
        check_extrinsics(self.T_body_cam.translation)

    @property
    def k(self) -> FloatArray:
        """Camera matrix `(3, 3)`."""
        fx, fy, cx, cy = self.intrinsics
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def as_raw(self, rotation: FloatArray, projection: FloatArray) -> RawCamera:
        """Return the camera with the R `(3, 3)` and P `(3, 4)` that rectify its images."""
        numbers = (tuple(np.ravel(matrix).tolist()) for matrix in (self.k, rotation, projection))
        return RawCamera(self.size, self.model, self.distortion, *numbers)


def rectified_cameras(name: str, left: CalibratedCamera, right: CalibratedCamera) -> tuple[RawCamera, RawCamera]:
    """Return both cameras with the R and P that rectify them (Bouguet, no black border); R = I if already rectified."""
    if left.size != right.size:
        raise InputError(f"{name}: the left camera is {left.size}, the right {right.size}: both must have one size")
    fisheye = left.model in FISHEYE
    if fisheye != (right.model in FISHEYE):
        raise InputError(
            f"{name}: the left lens is {left.model}, the right {right.model}: calibrate both with one model"
        )
    T_right_left = right.T_body_cam.inverse() @ left.T_body_cam
    across = -T_right_left.rotation.T @ T_right_left.translation
    off = max(float(np.abs(T_right_left.rotation - np.eye(3)).max()), float(np.abs(across[1:]).max()))
    plain = not any(left.distortion) and not any(right.distortion) and left.intrinsics == right.intrinsics
    if plain and off <= RECTIFIED_TOLERANCE and across[0] > 0.0:
        shift = -(left.intrinsics[0] * round(float(across[0]), 12))  # without the rounding errors of the poses
        rotations, projections = (np.eye(3), np.eye(3)), (np.c_[left.k, np.zeros(3)], np.c_[left.k, (shift, 0.0, 0.0)])
    else:
        lenses = (np.array(values) for values in (left.k, left.distortion, right.k, right.distortion))
        with refusing(f"{name}: the cameras cannot be rectified", "correct the calibration"):
            try:
                *rotations, one, other = (cv2.fisheye if fisheye else cv2).stereoRectify(
                    *(*lenses, left.size, T_right_left.rotation, T_right_left.translation),
                    flags=cv2.CALIB_ZERO_DISPARITY,
                    **{"balance" if fisheye else "alpha": 0},
                )[:4]
            except cv2.error as error:
                raise ValueError(str(error)) from error
        projections = (one, other)
        if _coverage_problem((left, right), rotations, projections):
            projections = _kept_projections((left, right), rotations, float(other[0, 3] / other[0, 0]))
            if problem := _coverage_problem((left, right), rotations, projections):
                raise InputError(f"{name}: the cameras cannot be rectified: {problem}; correct the calibration")
            other = projections[1]
        if not other[0, 3] < 0 or other[1, 3] != 0:
            raise InputError(
                f"{name}: the right camera is not to the right of the left camera: are they swapped, or one above "
                "the other?"
            )
    one, other = map(CalibratedCamera.as_raw, (left, right), rotations, projections)
    return one, other


def _kept_projections(
    cameras: Sequence[CalibratedCamera], rotations: Sequence[FloatArray], shift: float
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
    cameras: Sequence[CalibratedCamera], rotations: Sequence[FloatArray], projections: Sequence[FloatArray]
) -> str:
    """Return why a rectification does not cover the field of view of the cameras; empty if there is no problem."""
    for camera, rotation, projection in zip(cameras, rotations, projections, strict=True):
        raw = camera.as_raw(rotation, projection)
        width, height = camera.size
        focal, centre = float(projection[0, 0]), projection[:2, 2]
        ratio = focal / float(np.mean(camera.intrinsics[:2]))
        if not FOCAL_RATIO[0] <= ratio <= FOCAL_RATIO[1]:
            return f"the rectified focal length is {focal:.4g} px, {ratio:.3g} times that of the camera"
        if not (0.0 <= centre[0] < width and 0.0 <= centre[1] < height):
            return f"the rectified principal point ({centre[0]:.4g}, {centre[1]:.4g}) is outside of the image"
        fraction = _valid_fraction(raw.maps()[0], camera.size)
        if fraction < MIN_VALID:
            return f"raw pixels are mapped to {100.0 * fraction:.3g} % of the rectified image"
    return ""


def rectified_pair(name: str, left: CalibratedCamera, right: CalibratedCamera) -> tuple[StereoRig, Rectify | None]:
    """Return the rectified rig, with its pose in the body, and the rectifying function; None if already rectified."""
    cameras = one, other = rectified_cameras(name, left, right)
    rig = rig_from_projections(np.array(one.p), np.array(other.p), one.size, name)
    T_body_left = Transform(left.T_body_cam.rotation @ np.reshape(one.r, (3, 3)).T, left.T_body_cam.translation)
    T_rb_sb = T_body_left @ rig.T_sb_left.inverse()
    with refusing(f"{name}: the cameras cannot be rectified", "correct the calibration"):
        rig = replace(rig, T_rb_sb=Transform.from_quat(T_rb_sb.translation, T_rb_sb.quat_xyzw))
    return rig, None if one.is_rectified and other.is_rectified else StereoRectifier(cameras).rectify


def _remapped(image: GreyImage, maps: Sequence[Any]) -> GreyImage:
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)

"""Rectification of raw images by D, K, R and P of sensor_msgs/CameraInfo; the remap tables are computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import SAME_PX, StereoRig
from sfr_loc_map.io.calibration.camera_info import (
    TOLERANCE,
    RectifiedCamera,
    check_centre,
    have_one_camera_matrix,
    rig_of_one_projection,
    size_of_full_images,
)
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.suite_names import SIDES

COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,), "fisheye": (4,)}
"""Supported distortion models, and the numbers of coefficients that each may have."""
FISHEYE = ("equidistant", "fisheye")
MAX_ROTATION_DEFECT = 1e-3  #: Largest accepted entry of R R^T - I.
MIN_VALID = 0.25  #: Smallest accepted fraction of a rectified image that raw pixels cover.
OTHER_SIZE = (1.2, 64.0)  #: Smallest and largest factor between the camera matrices of two image sizes.
SAME_FACTOR = 0.1  #: Largest deviation of focal lengths and principal points from this factor, in its logarithm.
SAME_DIRECTION = 1e-5
"""Change of a distortion coefficient or an entry of R below which a calibration counts as unchanged."""


@dataclass(frozen=True, slots=True)
class RectifiableCamera:
    """A camera with the rectification of its images: distortion, K, R and P of sensor_msgs/CameraInfo.

    `stereo_calibration.PosedCamera` is a camera for which R and P are not yet computed.
    """

    size: tuple[int, int]  #: Width and height, pixels.
    model: str  #: Model of the distortion, one of `COEFFICIENTS`.
    d: tuple[float, ...]  #: Coefficients of the distortion.
    k: tuple[float, ...]  #: Camera matrix of the raw image `(9,)`, row-major, pixels.
    r: tuple[float, ...]  #: Rotation from the raw to the rectified camera `(9,)`, row-major.
    p: tuple[float, ...]  #: Projection matrix of the rectified image `(12,)`, row-major, pixels.

    @classmethod
    def of_rectified(cls, size: tuple[int, int], p: FloatArray) -> RectifiableCamera:
        """Return a camera of images that are already rectified, from its P `(12,)`."""
        k, r, p_row = (tuple(np.ravel(matrix).tolist()) for matrix in (np.reshape(p, (3, 4))[:, :3], np.eye(3), p))
        return cls(size, "plumb_bob", (0.0,) * 5, k, r, p_row)

    @classmethod
    def of(cls, name: str, info: Any) -> RectifiableCamera:  # noqa: ANN401 - a CameraInfo of any library
        """Return the calibration in a sensor_msgs/CameraInfo; `name` is its topic (`loc/left/camera_info`)."""
        lists = (np.asarray(values, np.float64).reshape(-1).tolist() for values in (info.d, info.k, info.r, info.p))
        d, k, r, p = (tuple(values) for values in lists)
        size = size_of_full_images(name, info)
        return cls(size, str(info.distortion_model), d, k, r, p).checked(name)

    def checked(self, name: str) -> RectifiableCamera:
        """Return the calibration, with default values for a lens without distortion and for an empty R.

        Raises InputError, whose text begins with `name`, if the images cannot be rectified by this calibration.
        """
        model = self.model or ("" if any(self.d) else "plumb_bob")
        if model not in COEFFICIENTS:
            known = ", ".join(COEFFICIENTS)
            raise InputError(f"{name} has distortion model '{model[:40]}': one of {known} can be rectified")
        d = self.d or (0.0,) * COEFFICIENTS[model][0]
        check_coefficients(model, d, name)
        is_complete = (len(self.k), len(self.r), len(self.p)) == (9, 9, 12)
        is_finite = np.isfinite([*d, *self.k, *self.r, *self.p]).all()
        if not (is_complete and is_finite) or self.k[0] <= 0.0 or self.k[4] <= 0.0 or self.p[0] <= 0.0:
            raise InputError(f"{name} has no k or p, or contains a non-finite number: calibrate the camera")
        r = self.r if any(self.r) else tuple(np.eye(3).reshape(-1).tolist())
        check_camera_matrix(self.k, name)
        _check_scale(_intrinsics_of_k(self.k), _intrinsics_of_p(self.p), f"{name}: P has", "those of K")
        rotation = np.reshape(r, (3, 3))
        defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if defect > MAX_ROTATION_DEFECT or np.linalg.det(rotation) < 0.0:
            raise InputError(
                f"{name}: r is not a rotation: an orthonormal matrix with determinant +1 is required: calibrate the "
                "pair"
            )
        return replace(self, model=model, d=d, r=r)

    def maps(self) -> Sequence[Any]:
        """Return OpenCV's fixed-point maps (1/32 pixel) from rectified to raw pixels."""
        k = np.reshape(self.k, (3, 3))
        r = np.reshape(self.r, (3, 3))
        p = np.reshape(self.p, (3, 4))[:, :3]
        make = cv2.fisheye.initUndistortRectifyMap if self.model in FISHEYE else cv2.initUndistortRectifyMap
        return make(k, np.array(self.d), r, p, self.size, cv2.CV_16SC2)

    def is_same(self, other: RectifiableCamera) -> bool:
        """Return whether two calibrations are equal except for rounding (`SAME_PX`, `SAME_DIRECTION`) by a driver."""
        if (self.size, self.model, len(self.d)) != (other.size, other.model, len(other.d)):
            return False
        change_px = max(_largest_difference(self.k, other.k), _largest_difference(self.p, other.p))
        change = max(_largest_difference(self.d, other.d), _largest_difference(self.r, other.r))
        return change_px < SAME_PX and change < SAME_DIRECTION

    @property
    def rectified(self) -> RectifiedCamera:
        """The camera of the rectified images."""
        return RectifiedCamera(self.size, np.array(self.p))

    @property
    def is_rectified(self) -> bool:
        """Whether the images are already rectified."""
        if any(self.d):
            return False
        p = np.reshape(self.p, (3, 4))[:, :3].reshape(-1)
        rotation = _largest_difference(self.r, np.eye(3).reshape(-1))
        return max(rotation, _largest_difference(self.k, p)) <= TOLERANCE


def check_one_scale(left: RectifiableCamera, right: RectifiableCamera, name: str) -> None:
    """Raise InputError if the camera matrices of two cameras are those of two image sizes."""
    _check_scale(
        _intrinsics_of_k(left.k), _intrinsics_of_k(right.k), f"{name}: the right camera has", "those of the left camera"
    )


def _intrinsics_of_k(k: Sequence[float]) -> FloatArray:
    """Return fx, fy, cx, cy `(4,)` of a camera matrix `(9,)`."""
    return np.take(k, (0, 4, 2, 5))


def _intrinsics_of_p(p: ArrayLike) -> FloatArray:
    """Return fx, fy, cx, cy `(4,)` of a projection matrix `(12,)`."""
    return np.take(p, (0, 5, 2, 6))


def _check_scale(one: FloatArray, other: FloatArray, which: str, reference: str) -> None:
    """Raise InputError if intrinsics fx, fy, cx, cy `(4,)` are those of another image size.

    Another image size multiplies all of them by one factor. A rectification or another lens does not multiply the
    principal point by the factor of the focal lengths.
    """
    if min(one.min(), other.min()) <= 0.0:
        return
    ratios = np.log(other) - np.log(one)
    ratio = float(np.median(ratios))
    smallest, largest = np.log(OTHER_SIZE)
    if smallest <= abs(ratio) <= largest and float(np.abs(ratios - ratio).max()) <= SAME_FACTOR:
        factor = float(np.exp(ratio))
        raise InputError(
            f"{which} focal lengths and a principal point that are {factor:.3g} times {reference}, as of another image "
            "size: give a calibration for one image size"
        )


def check_coefficients(model: str, coefficients: Sequence[float], name: str) -> None:
    """Raise InputError if a distortion model does not have this number of coefficients."""
    if len(coefficients) not in COEFFICIENTS[model]:
        wanted = alternatives(map(str, COEFFICIENTS[model]))
        raise InputError(f"{name} has {len(coefficients)} coefficients d: model {model} requires {wanted}")


def check_camera_matrix(k: Sequence[float], name: str) -> None:
    """Raise InputError if numbers `(9,)` are not fx, 0, cx, 0, fy, cy, 0, 0, 1, but have a skew or are transposed."""
    if len(k) != 9 or not _largest_difference(np.take(k, (1, 3, 6, 7, 8)), (0, 0, 0, 0, 1)) <= SAME_PX:
        raise InputError(
            f"{name}: the camera matrix is {', '.join(f'{number:g}' for number in k)}: fx, 0, cx, 0, fy, cy, 0, 0, 1 "
            "is required; calibrate without skew, and write the matrix row by row (that of MATLAB is transposed)"
        )


def _largest_difference(numbers: ArrayLike, others: ArrayLike) -> float:
    """Return the largest absolute difference between two lists of equal length; NaN if a number is NaN."""
    return float(np.abs(np.subtract(numbers, others)).max())


class StereoRectifier:
    """Rectifies the image pairs of a left and a right camera."""

    def __init__(self, cameras: tuple[RectifiableCamera, RectifiableCamera], name: str = "the camera") -> None:
        """Compute the maps; raise InputError if raw pixels cover less than `MIN_VALID` of a rectified image."""
        self.cameras = cameras
        self._maps = tuple(camera.maps() for camera in cameras)
        for side, camera, maps in zip(SIDES, cameras, self._maps, strict=True):
            fraction = valid_fraction(maps[0], camera.size)
            (width, height), cx, cy = camera.size, camera.p[2], camera.p[6]
            if fraction < MIN_VALID:
                problem = f"the raw image covers {100.0 * fraction:.3g} % of the rectified image"
            elif not (0.0 <= cx < width and 0.0 <= cy < height):
                problem = "the principal point is outside of the rectified image"
            else:
                continue
            raise InputError(
                f"{name}/{side}: with its R and P {problem} (focal length {camera.p[0]:g} px, principal point ({cx:g}, "
                f"{cy:g}) of {width} x {height}): calibrate the pair again, or give a calibration whose R and P fit "
                "the images"
            )

    def rectify(self, left: GreyImage, right: GreyImage) -> tuple[GreyImage, GreyImage]:
        """Return the rectified images; pixels outside of the raw image are 0."""
        return _remapped(left, self._maps[0]), _remapped(right, self._maps[1])


def rig_of_raw_infos(
    infos: Sequence[Any], name: str, before: StereoRectifier | None = None
) -> tuple[StereoRig, StereoRectifier]:
    """Return the rig and the rectifier of raw images, from two CameraInfo; see `rig_of_raw`."""
    left, right = (
        RectifiableCamera.of(f"{name}/{side}/camera_info", info) for side, info in zip(SIDES, infos, strict=True)
    )
    return rig_of_raw((left, right), name, before)


def rig_of_rectified_infos(
    infos: Sequence[Any], name: str, before: StereoRectifier | None = None
) -> tuple[StereoRig, StereoRectifier | None]:
    """Return the rig of rectified images, from two CameraInfo, and a rectifier if needed; see `rig_of_rectified`."""
    left, right = (
        RectifiedCamera.of(f"{name}/{side}/camera_info", info) for side, info in zip(SIDES, infos, strict=True)
    )
    return rig_of_rectified((left, right), name, before)


def rig_of_raw(
    cameras: tuple[RectifiableCamera, RectifiableCamera], name: str, before: StereoRectifier | None = None
) -> tuple[StereoRig, StereoRectifier]:
    """Return the rig (`loc` or `nav`) and the rectifier of raw images; reuse `before` if its cameras are equal.

    Both images are rectified to the P of the left camera, even if the P of the right camera differs.
    """
    left, right = cameras
    check_one_scale(left, right, name)
    for side, camera in zip(SIDES, cameras, strict=True):
        check_centre(camera.k[2], camera.k[5], camera.size, f"{name}/{side}")
    if left.size == right.size and right.p[0] > 0.0:
        right = replace(right, p=tuple(_in_common(np.array(left.p), np.array(right.p)).tolist()))
    rig = rig_of_one_projection(left.rectified, right.rectified, name)
    return rig, _rectifier((left, right), name, before)


def rig_of_rectified(
    cameras: tuple[RectifiedCamera, RectifiedCamera], name: str, before: StereoRectifier | None = None
) -> tuple[StereoRig, StereoRectifier | None]:
    """Return the rig of rectified images (`loc` or `nav`), and a rectifier if the P of left and right differ.

    P of left and right may differ in focal length and principal point (OpenCV without CALIB_ZERO_DISPARITY, crops). A
    difference that moves no pixel by more than `SAME_PX` is ignored. For a larger difference the rectifier remaps the
    right images; `before` is reused if its cameras are equal.
    """
    left, right = cameras
    p_left, p_right = left.p, right.p
    complete = p_left.shape == p_right.shape == (12,) and np.isfinite([p_left, p_right]).all()
    if not complete or left.size != right.size or p_left[0] <= 0.0 or p_right[0] <= 0.0 or p_right[5] <= 0.0:
        return rig_of_one_projection(left, right, name), None
    _check_scale(_intrinsics_of_p(p_left), _intrinsics_of_p(p_right), f"{name}: P of right has", "those of P of left")
    for side, camera in zip(SIDES, cameras, strict=True):
        check_centre(camera.p[2], camera.p[6], camera.size, f"{name}/{side}")
    rig = rig_of_one_projection(left, replace(right, p=_in_common(p_left, p_right)), name)
    return rig, rectifier_of_rectified(left, right, name, before)


def rectifier_of_rectified(
    left: RectifiedCamera, right: RectifiedCamera, name: str, before: StereoRectifier | None = None
) -> StereoRectifier | None:
    """Return the rectifier that remaps right images to the camera matrix of the left camera.

    None if this moves no pixel by more than `SAME_PX`.
    """
    if have_one_camera_matrix(left.p, right.p) or _largest_shift_px(left.p, right.p, left.size) <= SAME_PX:
        return None
    remapped = replace(
        RectifiableCamera.of_rectified(right.size, right.p), p=tuple(_in_common(left.p, right.p).tolist())
    )
    return _rectifier((RectifiableCamera.of_rectified(left.size, left.p), remapped), name, before)


def common_projection(left: RectifiableCamera, right: RectifiableCamera) -> FloatArray:
    """Return the P `(12,)` of the right camera with the camera matrix of the left camera; unchanged if P is invalid."""
    p_left, p_right = np.array(left.p), np.array(right.p)
    is_valid = np.isfinite([p_left, p_right]).all() and min(p_left[0], p_right[0], p_right[5]) > 0.0
    return _in_common(p_left, p_right) if is_valid else p_right


def _in_common(p_left: FloatArray, p_right: FloatArray) -> FloatArray:
    """Return the P `(12,)` of the right camera with the camera matrix of the left camera and an unchanged baseline."""
    common = p_left.copy()
    if have_one_camera_matrix(p_left, p_right):
        common[3] = p_right[3]
    else:
        common[3] = p_left[3] - p_left[0] * (p_left[3] / p_left[0] - p_right[3] / p_right[0])
    common[[7, 11]] = p_right[[7, 11]]
    return common


def _rectifier(
    cameras: tuple[RectifiableCamera, RectifiableCamera], name: str, before: StereoRectifier | None
) -> StereoRectifier:
    """Return a rectifier of two cameras; reuse `before` if its cameras are equal, because maps are slow to compute."""
    if before is not None and all(map(RectifiableCamera.is_same, before.cameras, cameras)):
        return before
    return StereoRectifier(cameras, name)


def _largest_shift_px(p_left: FloatArray, p_right: FloatArray, size: tuple[int, int]) -> float:
    """Return the largest shift, px, of the right image's corners, along rows or columns, if the left P is used."""
    shifts = []
    for axis, (focal, centre) in enumerate(((0, 2), (5, 6))):
        for corner in (0.0, float(size[axis] - 1)):
            ray = (corner - p_right[centre]) / p_right[focal]
            shifts.append(abs(ray * p_left[focal] + p_left[centre] - corner))
    return float(max(shifts))


def valid_fraction(raw_pixels: Any, size: tuple[int, int]) -> float:  # noqa: ANN401 - of OpenCV
    """Return the fraction of a rectified image that raw pixels cover; `raw_pixels` `(H, W, 2)`."""
    width, height = size
    u, v = raw_pixels[:, :, 0], raw_pixels[:, :, 1]
    return float(((u >= 0) & (u < width) & (v >= 0) & (v < height)).mean())


def _remapped(image: GreyImage, maps: Sequence[Any]) -> GreyImage:
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)

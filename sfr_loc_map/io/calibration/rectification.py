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
from sfr_loc_map.io.calibration.projections import (
    TOLERANCE,
    check_centre,
    check_projection,
    have_one_camera_matrix,
    rig_from_projections,
)
from sfr_loc_map.message_text import alternatives

COEFFICIENTS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "equidistant": (4,), "fisheye": (4,)}
"""Supported distortion models, and the numbers of coefficients that each may have."""
RECTIFIED_ADVICE = (
    "give rectified images and their camera_info, or raw images on image_raw (nodes: parameter input.rectify)"
)
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
        k = np.reshape(p, (3, 4))[:, :3].reshape(-1)
        r = np.eye(3).reshape(-1)
        return cls(size, "plumb_bob", (0.0,) * 5, tuple(k.tolist()), tuple(r.tolist()), tuple(np.ravel(p).tolist()))

    @classmethod
    def of_rectified_info(cls, name: str, info: Any) -> RectifiableCamera:  # noqa: ANN401 - a CameraInfo of any library
        """Return the camera of rectified images from P in a message; D, K and R belong to the raw image.

        `name` is the topic. InputError for binning or a region of interest, to which P does not apply, and for a P that
        is not that of a rectified camera.
        """
        size, p = _size_of_full_images(name, info), np.asarray(info.p, np.float64)
        check_projection(p, name, RECTIFIED_ADVICE)
        return cls.of_rectified(size, p)

    @classmethod
    def of(cls, name: str, info: Any) -> RectifiableCamera:  # noqa: ANN401 - a CameraInfo of any library
        """Return the calibration in a sensor_msgs/CameraInfo; `name` is its topic (`loc/left/camera_info`)."""
        lists = (np.asarray(values, np.float64).reshape(-1).tolist() for values in (info.d, info.k, info.r, info.p))
        d, k, r, p = (tuple(values) for values in lists)
        size = _size_of_full_images(name, info)
        return cls(size, str(info.distortion_model), d, k, r, p).checked(name)

    def checked(self, name: str) -> RectifiableCamera:
        """Return the calibration, with default values for a lens without distortion and for an empty R.

        Raises InputError, whose text begins with `name`, if the images cannot be rectified by this calibration.
        """
        model = self.model or ("" if any(self.d) else "plumb_bob")
        if model not in COEFFICIENTS:
            known = ", ".join(COEFFICIENTS)
            raise InputError(f"{name} has distortion model '{model[:40]}':", f"one of {known} can be rectified")
        d = self.d or (0.0,) * COEFFICIENTS[model][0]
        check_coefficients(model, d, name)
        is_complete = (len(self.k), len(self.r), len(self.p)) == (9, 9, 12)
        is_finite = np.isfinite([*d, *self.k, *self.r, *self.p]).all()
        if not (is_complete and is_finite) or self.k[0] <= 0.0 or self.k[4] <= 0.0 or self.p[0] <= 0.0:
            raise InputError(f"{name} has no k or p, or contains a non-finite number:", "calibrate the camera")
        r = self.r if any(self.r) else tuple(np.eye(3).reshape(-1).tolist())
        check_camera_matrix(self.k, name)
        _check_scale(_intrinsics_of_k(self.k), _intrinsics_of_p(self.p), f"{name}: P has", "those of K")
        rotation = np.reshape(r, (3, 3))
        defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if defect > MAX_ROTATION_DEFECT or np.linalg.det(rotation) < 0.0:
            raise InputError(
                f"{name}: r is not a rotation: an orthonormal matrix with determinant +1 is required:",
                "calibrate the pair",
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
    def is_rectified(self) -> bool:
        """Whether the images are already rectified."""
        if any(self.d):
            return False
        p = np.reshape(self.p, (3, 4))[:, :3].reshape(-1)
        rotation = _largest_difference(self.r, np.eye(3).reshape(-1))
        return max(rotation, _largest_difference(self.k, p)) <= TOLERANCE


def _size_of_full_images(name: str, info: Any) -> tuple[int, int]:  # noqa: ANN401 - a CameraInfo of any library
    """Return the width and height in a message on the topic `name`.

    InputError without a size, and for binning or a region of interest.
    """
    if not (info.width and info.height):
        raise InputError(f"{name} has no image size (width and height):", "publish the size of the images")
    roi = info.roi
    has_full_size = (roi.width, roi.height) in ((0, 0), (info.width, info.height))
    is_cropped = not has_full_size or roi.x_offset or roi.y_offset
    if is_cropped or info.binning_x > 1 or info.binning_y > 1:
        raise InputError(f"{name} has binning or a region of interest:", "send full images without binning")
    return int(info.width), int(info.height)


def _intrinsics_of_k(k: Sequence[float]) -> FloatArray:
    """Return fx, fy, cx, cy `(4,)` of a camera matrix `(9,)`."""
    return np.take(k, (0, 4, 2, 5))


def _intrinsics_of_p(p: ArrayLike) -> FloatArray:
    """Return fx, fy, cx, cy `(4,)` of a projection matrix `(12,)`."""
    return np.take(p, (0, 5, 2, 6))


def _check_scale(one: FloatArray, other: FloatArray, which: str, reference: str) -> None:
    """Raise InputError if two sets of intrinsics fx, fy, cx, cy `(4,)` belong to different image sizes.

    A different image size multiplies all intrinsics by one factor. A rectification or a different lens does not
    multiply the principal point by the factor of the focal lengths.
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
            "size:",
            "give a calibration for one image size",
        )


def check_coefficients(model: str, coefficients: Sequence[float], name: str) -> None:
    """Raise InputError if a distortion model does not have this number of coefficients."""
    if len(coefficients) not in COEFFICIENTS[model]:
        wanted = alternatives(map(str, COEFFICIENTS[model]))
        raise InputError(f"{name} has {len(coefficients)} coefficients d:", f"model {model} requires {wanted}")


def check_camera_matrix(k: Sequence[float], name: str) -> None:
    """Raise InputError if numbers `(9,)` are not fx, 0, cx, 0, fy, cy, 0, 0, 1, but have a skew or are transposed."""
    if len(k) != 9 or not _largest_difference(np.take(k, (1, 3, 6, 7, 8)), (0, 0, 0, 0, 1)) <= SAME_PX:
        raise InputError(
            f"{name}: the camera matrix is {', '.join(f'{number:g}' for number in k)}: fx, 0, cx, 0, fy, cy, 0, 0, 1 "
            "is required;",
            "calibrate without skew, and write the matrix row by row (that of MATLAB is transposed)",
        )


def _largest_difference(numbers: ArrayLike, others: ArrayLike) -> float:
    """Return the largest absolute difference between two lists of equal length; NaN if a number is NaN."""
    return float(np.abs(np.subtract(numbers, others)).max())


class StereoRectifier:
    """Rectifies the image pairs of a left and a right camera."""

    def __init__(self, cameras: tuple[RectifiableCamera, RectifiableCamera], names: tuple[str, str]) -> None:
        """Compute the maps; raise InputError if raw pixels cover less than `MIN_VALID` of a rectified image.

        `names` of the cameras begin the messages.
        """
        self.cameras = cameras
        self._maps = tuple(camera.maps() for camera in cameras)
        for name, camera, maps in zip(names, cameras, self._maps, strict=True):
            fraction = valid_fraction(maps[0], camera.size)
            (width, height), cx, cy = camera.size, camera.p[2], camera.p[6]
            if fraction < MIN_VALID:
                problem = f"the raw image covers {100.0 * fraction:.3g} % of the rectified image"
            elif not (0.0 <= cx < width and 0.0 <= cy < height):
                problem = "the principal point is outside of the rectified image"
            else:
                continue
            raise InputError(
                f"{name}: with its R and P {problem} (focal length {camera.p[0]:g} px, principal point ({cx:g}, "
                f"{cy:g}) of {width} x {height}):",
                "calibrate the pair again, or give a calibration whose R and P fit the images",
            )

    def rectify(self, left: GreyImage, right: GreyImage) -> tuple[GreyImage, GreyImage]:
        """Return the rectified images; pixels outside of the raw image are 0."""
        return _remapped(left, self._maps[0]), _remapped(right, self._maps[1])


def rig_of_infos(
    infos: Sequence[Any], name: str, *, raw: bool, before: StereoRectifier | None = None
) -> tuple[StereoRig, StereoRectifier | None]:
    """Return the rig of two CameraInfo, left first, and the rectifier of its images; None if they need none.

    `raw` states whether the images are those before the rectification. Rectified images are described by P alone.
    `name` of the rig is `loc` or `nav`. See `rig_of_cameras` for `before` and the errors.
    """
    names = f"{name}/left/camera_info", f"{name}/right/camera_info"
    camera_of = RectifiableCamera.of if raw else RectifiableCamera.of_rectified_info
    left, right = map(camera_of, names, infos)
    return rig_of_cameras((left, right), f"camera_info of {name}", names, before)


def rig_of_cameras(
    cameras: tuple[RectifiableCamera, RectifiableCamera],
    where: str,
    names: tuple[str, str],
    before: StereoRectifier | None = None,
) -> tuple[StereoRig, StereoRectifier | None]:
    """Return the rig of a left and a right camera, and the rectifier of their images; None if they need none.

    Both images are rectified to the camera matrix in P of the left camera, even if that of the right camera differs
    (OpenCV without CALIB_ZERO_DISPARITY, crops). `before` is reused if its cameras are equal.

    Raises InputError, which begins with `where` or with the name of a camera, if the cameras are not a pair of one
    image size with a plausible baseline, or if the images cannot be rectified.
    """
    left, right = cameras
    p_left, p_right = np.array(left.p), _common_projection(np.array(left.p), np.array(right.p))
    for name, p in zip(names, (p_left, p_right), strict=True):
        check_projection(p, name)
    if left.size != right.size:
        sizes = " and ".join(f"{width} x {height}" for width, height in (left.size, right.size))
        raise InputError(f"{where}: the images of left and right are {sizes}:", "equal sizes are required")
    _check_scale(
        _intrinsics_of_k(left.k),
        _intrinsics_of_k(right.k),
        f"{where}: the right camera has",
        "those of the left camera",
    )
    for name, camera in zip(names, cameras, strict=True):
        check_centre(camera.k[2], camera.k[5], camera.size, name)
    rig = rig_from_projections(p_left, p_right, left.size, where)
    return rig, _rectifier(left, right, p_right, names, before)


def _rectifier(
    left: RectifiableCamera,
    right: RectifiableCamera,
    p_right: FloatArray,
    names: tuple[str, str],
    before: StereoRectifier | None,
) -> StereoRectifier | None:
    """Return the rectifier to P of the left camera and `p_right` `(12,)`.

    None if the images are already rectified and `p_right` moves no pixel by more than `SAME_PX`. `before` is reused if
    its cameras are equal, because maps are slow to compute.
    """
    if left.is_rectified and right.is_rectified:
        left, right = (RectifiableCamera.of_rectified(camera.size, np.array(camera.p)) for camera in (left, right))
        if _largest_shift_px(np.array(right.p), p_right, right.size) <= SAME_PX:
            return None
    cameras = left, replace(right, p=tuple(p_right.tolist()))
    if before is not None and all(map(RectifiableCamera.is_same, before.cameras, cameras)):
        return before
    return StereoRectifier(cameras, names)


def _common_projection(p_left: FloatArray, p_right: FloatArray) -> FloatArray:
    """Return the P `(12,)` of the right camera with the camera matrix of the left camera and an unchanged baseline.

    An invalid P is unchanged.
    """
    is_valid = np.isfinite([p_left, p_right]).all() and min(p_left[0], p_right[0], p_right[5]) > 0.0
    if not is_valid:
        return p_right
    common = p_left.copy()
    if have_one_camera_matrix(p_left, p_right):
        common[3] = p_right[3]
    else:
        common[3] = p_left[3] - p_left[0] * (p_left[3] / p_left[0] - p_right[3] / p_right[0])
    common[[7, 11]] = p_right[[7, 11]]
    return common


def _largest_shift_px(p: FloatArray, other_p: FloatArray, size: tuple[int, int]) -> float:
    """Return the largest shift, px, of an image's corners, along rows or columns, if its P is replaced by another."""
    shifts = []
    for axis, (focal, centre) in enumerate(((0, 2), (5, 6))):
        for corner in (0.0, float(size[axis] - 1)):
            ray = (corner - p[centre]) / p[focal]
            shifts.append(abs(ray * other_p[focal] + other_p[centre] - corner))
    return float(max(shifts))


def valid_fraction(raw_pixels: Any, size: tuple[int, int]) -> float:  # noqa: ANN401 - of OpenCV
    """Return the fraction of a rectified image that raw pixels cover; `raw_pixels` `(H, W, 2)`."""
    width, height = size
    u, v = raw_pixels[:, :, 0], raw_pixels[:, :, 1]
    return float(((u >= 0) & (u < width) & (v >= 0) & (v < height)).mean())


def _remapped(image: GreyImage, maps: Sequence[Any]) -> GreyImage:
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)

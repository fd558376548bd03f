"""Bounds of cameras and poses that are possible at all, for files, topics and parameters.

Rigs, transforms and trajectories are checked when they are made, because compiled code does not check its indices. The
bounds are far beyond any rover: they reject wrong units, swapped columns and broken messages, not unusual rigs. Checks
raise GeometryError, and comparisons are written so that NaN fails them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, Mask

MAX_IMAGE_PIXELS = 8192 * 8192  #: Pixels of the largest image: all allocations follow from the size in a header.
MAX_IMAGE_SIDE = 32_768  #: Longest side of an image, pixels: OpenCV's remap has 16 bits for it.
FOCAL_RATIOS = (0.01, 100.0)
"""Smallest and largest focal length over the longer side of the image: fields of view from 178 to 0.6 degrees."""
MAX_CENTRE_RATIO = 10.0
"""Largest distance of the principal point from the image centre over the longer side; images may be crops."""
BASELINE_M = (1e-4, 100.0)  #: Shortest and longest baseline, metres: from a microscope's to that of two masts.
MAX_DISTORTION = 100.0  #: Largest coefficient of lens distortion; rational models have values of some tens.
MAX_EXTRINSICS_M = 100.0  #: Largest coordinate of a camera in the frame of its rover, metres.
MAX_POSITION_M = 1e9  #: Largest coordinate of a position, metres: float64 then still resolves a micrometre.
QUATERNION_TOLERANCE = 1e-2
"""Largest difference of a quaternion's length from 1, and of a rotation matrix times its transpose from the identity:
files are rounded."""
QUATERNION_SQUARES = (1.0 - QUATERNION_TOLERANCE) ** 2, (1.0 + QUATERNION_TOLERANCE) ** 2
"""Smallest and largest sum of squares of a quaternion."""
MAX_VARIANCE = 1e6  #: Largest variance of a pose that is known at all, m^2 and rad^2: a standard deviation of 1 km.
MAX_ASYMMETRY = 1e-6  #: Largest asymmetry and largest negative eigenvalue of a covariance over its largest variance.
MIN_LARGEST_VARIANCE = 1e-30  #: Smallest divisor of these, m^2 and rad^2: a covariance may be 0.


def check_image_size(width: float, height: float, name: str = "image") -> None:
    """Check the size of an image, before anything is allocated for it."""
    sides_ok = all(1 <= n <= MAX_IMAGE_SIDE and n == int(n) for n in (width, height))
    if not (sides_ok and width * height <= MAX_IMAGE_PIXELS):
        size = f"{name} is {width} x {height}"
        raise GeometryError(f"{size}: whole numbers of pixels > 0, up to {MAX_IMAGE_PIXELS} in all, are required")


def check_camera(size: tuple[float, float], focal: tuple[float, float], centre: tuple[float, float]) -> None:
    """Check size (width, height), focal lengths (along rows, columns) and principal point of a camera, all pixels."""
    check_image_size(*size)
    side = max(size)
    low, high = (ratio * side for ratio in FOCAL_RATIOS)
    if not all(low <= f <= high for f in focal):
        raise GeometryError(
            f"focal lengths are {focal[0]:g} and {focal[1]:g} px: {low:g} to {high:g} px are allowed for images of "
            f"{size[0]} x {size[1]}"
        )
    if not all(abs(c - 0.5 * n) <= MAX_CENTRE_RATIO * side for c, n in zip(centre, size, strict=True)):
        raise GeometryError(
            f"principal point is ({centre[0]:g}, {centre[1]:g}): it is far outside an image of {size[0]} x {size[1]}"
        )


def check_extrinsics(position_m: FloatArray) -> None:
    """Check the position `(3,)` of a stereo rig on its rover, metres."""
    if not (np.abs(position_m) <= MAX_EXTRINSICS_M).all():
        raise GeometryError(
            f"the stereo rig is at {position_m.tolist()} m in RB: up to {MAX_EXTRINSICS_M:g} m are allowed"
        )


def check_distortion(coefficients: ArrayLike) -> None:
    """Check the coefficients of lens distortion."""
    values = np.asarray(coefficients, dtype=np.float64)
    if not (np.abs(values) <= MAX_DISTORTION).all():
        raise GeometryError(f"distortion is {values.tolist()}: finite numbers up to {MAX_DISTORTION:g} are allowed")


def plausible_rotations(rotations: FloatArray) -> Mask:
    """Return whether each matrix `(..., 3, 3)` is a rotation within the rounding of files, `(...,)`."""
    bounded = np.asarray((np.abs(rotations) <= 2.0).all(axis=(-2, -1)))
    safe = np.where(bounded[..., None, None], rotations, 0.0)
    defects = np.abs(safe @ np.swapaxes(safe, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    return np.asarray((defects <= QUATERNION_TOLERANCE) & (np.linalg.det(safe) > 0))


def plausible_positions(positions: FloatArray) -> Mask:
    """Return whether each position `(..., 3)`, metres, is finite and within `MAX_POSITION_M`, `(...,)`."""
    near = np.abs(positions) <= MAX_POSITION_M
    return np.asarray(near[..., 0] & near[..., 1] & near[..., 2])  # four times as fast as `all`


def plausible_quats(quats_xyzw: FloatArray) -> Mask:
    """Return whether each quaternion `(..., 4)` has the length of a rotation, `(...,)`."""
    with np.errstate(over="ignore"):
        squares = np.einsum("...i,...i->...", quats_xyzw, quats_xyzw)
    low, high = QUATERNION_SQUARES
    return np.asarray((low <= squares) & (squares <= high))


def is_plausible_covariance(covariance: FloatArray) -> bool:
    """Return whether `(6, 6)` can be the covariance of a pose: finite, bounded, symmetric, no negative variance."""
    if not (np.abs(covariance) <= MAX_VARIANCE).all():
        return False
    tolerance = MAX_ASYMMETRY * max(float(np.diag(covariance).max()), MIN_LARGEST_VARIANCE)
    is_symmetric = np.abs(covariance - covariance.T).max() <= tolerance
    return bool(is_symmetric and np.linalg.eigvalsh(covariance).min() >= -tolerance)

"""Plausibility bounds of cameras and poses, for files, topics and parameters.

Rigs, transforms and trajectories are checked when they are created, because compiled code does not check array bounds.
The limits far exceed the values of any rover. They reject wrong units, swapped columns and corrupt messages, but not
unusual rigs. The functions `check_*` raise GeometryError, and the other functions return what is plausible. Each
check is a comparison that must hold, so that NaN is rejected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, Mask

MAX_IMAGE_PIXELS = 8192 * 8192  #: Maximum pixels of an image. Bounds the memory that a wrong header allocates.
MAX_IMAGE_SIDE = 32_766  #: Maximum side of an image, pixels: OpenCV's remap requires sides below 32 767.
FOCAL_RATIOS = (0.01, 100.0)
"""Smallest and largest ratio of the focal length to the longer side of the image: fields of view from 178 to 0.6 deg.
"""
MAX_CENTRE_RATIO = 10.0
"""Largest distance of the principal point from the image centre along each axis, as a multiple of the longer side.
The ratio is large, because images may be cropped."""
BASELINE_M = (1e-4, 100.0)  #: Shortest and longest baseline, metres: from stereo microscopes to two masts.
MAX_DISTORTION = 100.0  #: Largest distortion coefficient; rational models reach several tens.
MAX_EXTRINSICS_M = 100.0  #: Largest coordinate of a camera in the frame of its rover, metres.
MAX_POSITION_M = 1e9  #: Largest coordinate of a position, metres: float64 still resolves 1 um at this distance.
ROTATION_TOLERANCE = 1e-2
"""Largest deviation of a quaternion's norm from 1, and of R R^T from I, because numbers in files are rounded."""
QUATERNION_SQUARES = (1.0 - ROTATION_TOLERANCE) ** 2, (1.0 + ROTATION_TOLERANCE) ** 2
"""Smallest and largest squared norm of a quaternion."""
LOST_VARIANCE = 9999.0  #: Diagonal of the covariance of an unknown pose, m^2 and rad^2.
MAX_VARIANCE = 1e6  #: Largest variance of a valid covariance, m^2 and rad^2: a standard deviation of 1 km.
MAX_ASYMMETRY = 1e-6  #: Largest asymmetry, and largest negative eigenvalue, relative to the largest variance.
MIN_LARGEST_VARIANCE = 1e-30
"""Lower bound of the largest variance to which `MAX_ASYMMETRY` is relative, m^2 and rad^2: all variances may be 0."""


def check_image_size(width: float, height: float, name: str = "image") -> None:
    """Check the size of an image before memory is allocated for it."""
    sides_ok = all(1 <= n <= MAX_IMAGE_SIDE and n == int(n) for n in (width, height))
    if not (sides_ok and width * height <= MAX_IMAGE_PIXELS):
        size = f"{name} is {width} x {height}"
        raise GeometryError(f"{size}: positive whole numbers, at most {MAX_IMAGE_PIXELS} pixels in total, are required")


def check_camera(size: tuple[float, float], focal: tuple[float, float], centre: tuple[float, float]) -> None:
    """Check size (width, height), focal lengths (fx, fy) and principal point of a camera, all in pixels."""
    check_image_size(*size)
    side = max(size)
    low, high = (ratio * side for ratio in FOCAL_RATIOS)
    if not all(low <= f <= high for f in focal):
        raise GeometryError(
            f"the focal lengths are {focal[0]:g} and {focal[1]:g} px: {low:g} to {high:g} px are required for images "
            f"of {size[0]} x {size[1]} px"
        )
    if not all(abs(c - 0.5 * n) <= MAX_CENTRE_RATIO * side for c, n in zip(centre, size, strict=True)):
        raise GeometryError(
            f"the principal point is ({centre[0]:g}, {centre[1]:g}) px: a point in or near the image of {size[0]} x "
            f"{size[1]} px is required"
        )


def check_extrinsics(position_m: FloatArray, name: str = "the stereo rig", frame: str = "RB") -> None:
    """Check the position `(3,)` of a stereo rig on its rover, or of a camera on its body, metres."""
    if not (np.abs(position_m) <= MAX_EXTRINSICS_M).all():
        raise GeometryError(
            f"{name} is at {position_m.tolist()} m in {frame}: at most {MAX_EXTRINSICS_M:g} m is allowed; are the "
            "units metres?"
        )


def check_distortion(coefficients: ArrayLike) -> None:
    """Check the coefficients of lens distortion."""
    values = np.asarray(coefficients, dtype=np.float64)
    if not (np.abs(values) <= MAX_DISTORTION).all():
        raise GeometryError(
            f"distortion is {', '.join(f'{value:g}' for value in values)}: finite numbers up to {MAX_DISTORTION:g} "
            "are required"
        )


def plausible_rotations(rotations: FloatArray) -> Mask:
    """Return whether each matrix `(..., 3, 3)` is a rotation within `ROTATION_TOLERANCE`, `(...,)`."""
    bounded = np.asarray((np.abs(rotations) <= 2.0).all(axis=(-2, -1)))
    safe = np.where(bounded[..., None, None], rotations, 0.0)
    defects = np.abs(safe @ np.swapaxes(safe, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    return np.asarray((defects <= ROTATION_TOLERANCE) & (np.linalg.det(safe) > 0))


def plausible_positions(positions: FloatArray) -> Mask:
    """Return whether each position `(..., 3)`, metres, is finite and within `MAX_POSITION_M`, `(...,)`."""
    near = np.abs(positions) <= MAX_POSITION_M
    return np.asarray(near[..., 0] & near[..., 1] & near[..., 2])  # four times as fast as `all`


def plausible_attitudes(quats_xyzw: FloatArray) -> Mask:
    """Return whether each quaternion `(N, 4)` has unit norm within `ROTATION_TOLERANCE`, `(N,)`.

    If every quaternion is zero, the rows are positions without attitude, and each row is valid.
    """
    with np.errstate(over="ignore"):
        squares = np.einsum("...i,...i->...", quats_xyzw, quats_xyzw)
    low, high = QUATERNION_SQUARES
    has_no_attitude = not quats_xyzw.any()  # NaN counts as an attitude
    return np.asarray((low <= squares) & (squares <= high)) | has_no_attitude


def plausible_poses(positions: FloatArray, quats_xyzw: FloatArray) -> Mask:
    """Return whether each row `(N,)` of positions `(N, 3)`, metres, and quaternions `(N, 4)` is a pose.

    If every quaternion is zero, the rows are positions without attitude.
    """
    return plausible_positions(positions) & plausible_attitudes(quats_xyzw)


def is_plausible_covariance(covariance: FloatArray) -> bool:
    """Return whether a matrix `(6, 6)` is a valid pose covariance: bounded, symmetric, positive semi-definite."""
    if not (np.abs(covariance) <= MAX_VARIANCE).all():
        return False
    tolerance = MAX_ASYMMETRY * max(float(np.diag(covariance).max()), MIN_LARGEST_VARIANCE)
    is_symmetric = np.abs(covariance - covariance.T).max() <= tolerance
    return bool(is_symmetric and np.linalg.eigvalsh(covariance).min() >= -tolerance)

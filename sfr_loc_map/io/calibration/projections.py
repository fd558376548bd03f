"""The projection matrices P of a rectified rig, and the checks of a rig of any format.

P[3] of the right camera is -fx baseline. Centre, baseline and unit are checked for files as for messages.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import refusing
from sfr_loc_map.suite_names import SIDES, Side

CENTRE_RATIOS = (0.3, 0.7)  #: Smallest and largest ratio of principal point to image size without cropping.
CENTRE_FACTOR = 1.5
"""Largest factor between the ratios along both axes without cropping: (0.5 + 0.1) / (0.5 - 0.1), for a principal point
that is 10 % of the image size from the centre."""
BASELINES_M = (1e-3, 5.0)
"""Smallest and largest accepted baseline, m. Larger numbers are probably in millimetres, smaller ones in kilometres, or
a baseline was given as Camera.bf, which is the baseline times fx."""
LONG_BASELINE_M = 1.0
"""Baseline, m, that rovers do not exceed. A larger number may be in another unit, or in squares of a board."""
BASELINE_TOLERANCE = 0.01  #: Largest difference between two statements of one baseline, as a fraction of the baseline.
TOLERANCE = 1e-6
"""Largest deviation of a coefficient from that of a rectified camera (P and K in pixels, R and D without unit)."""


def projection(rig: StereoRig, side: Side) -> FloatArray:
    """Return the projection matrix P `(12,)`, row-major, of one camera."""
    shift = 0.0 if side == "left" else -(rig.fx * rig.baseline_m)
    return np.array([rig.fx, 0.0, rig.cx, shift, 0.0, rig.fy, rig.cy, 0.0, 0.0, 0.0, 1.0, 0.0])


def baseline_from_projection(fx: float, shift: float) -> float:
    """Return the baseline, metres, from which P[3] = -fx baseline of the right camera was computed.

    The division alone may round the last digit differently. Of the neighbouring floats that give exactly this P[3], the
    float with the shortest decimal form is returned, so that messages preserve rigs exactly.
    """
    middle = -shift / fx
    near = {middle, *(float(f"{middle:.{digits}g}") for digits in (12, 13, 14, 15, 16))}
    for direction in (-math.inf, math.inf):
        step = math.nextafter(middle, direction)
        near |= {step, math.nextafter(step, direction)}
    exact = [b for b in near if -(fx * b) == shift]
    return min(exact, key=lambda b: (len(repr(b)), abs(b - middle))) if exact else middle


def with_baseline(p_left: ArrayLike, p_right: ArrayLike, baseline_m: float, text: str) -> FloatArray:
    """Return the P `(12,)` of a right camera with P[3] from a given baseline; `text` names the calibration.

    P[3] / P[0] is the offset of a camera along x, m. That of the left camera is not 0 if a third camera is the
    reference. InputError if both P `(12,)` state another baseline.
    """
    left, right = np.array(p_left, np.float64), np.array(p_right, np.float64)
    left_m, right_m = (float(p[3] / p[0]) if p[0] else 0.0 for p in (left, right))
    stated_m = left_m - right_m
    if stated_m and abs(stated_m - baseline_m) > BASELINE_TOLERANCE * abs(stated_m):
        raise InputError(
            f"calibration.baseline_m is {baseline_m:g} m, but P of {text} states {stated_m:g} m:",
            "omit calibration.baseline_m, or correct the calibration",
        )
    right[3] = right[0] * (left_m - baseline_m)
    return right


def check_centre(cx: float, cy: float, size: tuple[int, int], where: str) -> None:
    """Raise InputError if a calibration is probably for an image size other than `size`.

    The calibration itself may state `size`, but wrongly.

    Scaling an image multiplies both coordinates of the principal point by one factor, which cropping rarely does. The
    size is therefore wrong if the ratios to `size` are both below or both above `CENTRE_RATIOS`, and differ by at most
    the factor `CENTRE_FACTOR`. Two small ratios are also refused if one of them is not positive.
    """
    ratios = np.array([cx, cy]) / size
    low, high = CENTRE_RATIOS
    is_far = (ratios < low).all() or (ratios > high).all()
    smallest, largest = ratios.min(), ratios.max()
    if is_far and (smallest <= 0.0 or largest <= CENTRE_FACTOR * smallest):
        width, height = size
        raise InputError(
            f"{where}: the principal point is ({cx:g}, {cy:g}) px, far from the centre of images of {width} x {height} "
            "px:",
            "scale the calibration to the size of the images",
        )


def check_baseline(baseline_m: float, where: str) -> None:
    """Raise InputError if a baseline, m, is outside of `BASELINES_M`, because its unit is then not the metre."""
    shortest_m, longest_m = BASELINES_M
    if not shortest_m <= baseline_m <= longest_m:
        raise InputError(
            f"{where}: the baseline is {baseline_m:g} m: {shortest_m:g} to {longest_m:g} m is required;",
            "give the baseline in metres (P[3] and Camera.bf: in metres times fx)",
        )


def long_baseline(baseline_m: float, cameras: str) -> str:
    """Return a warning if a baseline exceeds those of rovers, because it may be in another unit; empty otherwise."""
    if baseline_m <= LONG_BASELINE_M:
        return ""
    return (
        f"the baseline of the {cameras} is {baseline_m:g} m, which is unusually long: verify that the baseline, P[3] "
        "and the squares of the calibration board are given in metres"
    )


def have_one_camera_matrix(p_left: FloatArray, p_right: FloatArray) -> bool:
    """Return whether two P `(12,)` differ only in their last column; False if a number is NaN."""
    return bool(np.abs(np.delete(p_left - p_right, [3, 7, 11])).max() <= TOLERANCE)


def rig_from_projections(
    p_left: FloatArray, p_right: FloatArray, size: tuple[int, int], where: str, names: tuple[str, str] = SIDES
) -> StereoRig:
    """Return the rig of two rectified cameras of equal size (width, height); both P `(12,)` refer to one frame.

    InputError if P do not describe a rectified pair with a baseline in `BASELINES_M`.
    """
    if not have_one_camera_matrix(p_left, p_right):
        raise InputError(
            f"{where}: P of {names[0]} and {names[1]} differ in more than P[3]:",
            "rectify both cameras to one camera matrix",
        )
    fx, cx, fy, cy = (float(p_left[i]) for i in (0, 2, 5, 6))
    shift = float(p_right[3] - p_left[3])
    if not shift < 0:
        found = f"P[3] of the {names[1]} camera is {p_right[3]:g}"
        hint = "are left and right swapped?" if shift > 0 else "calibrate both cameras as a pair"
        if p_left[3]:
            found = f"P[3] of the {names[0]} camera is {p_left[3]:g}, of the {names[1]} camera {p_right[3]:g}"
            hint = f"P[3] = 0 is required for the {names[0]} camera unless both P refer to a third camera"
        raise InputError(
            f"{where}: {found}, so the baseline is {-shift / (fx or 1.0) + 0.0:g} m: P[3] = -fx * baseline < 0 is "
            f"required for the {names[1]} camera;",
            hint,
        )
    with refusing(where, "correct the calibration"):
        baseline_m = baseline_from_projection(fx, shift) if fx else 0.0
        check_baseline(baseline_m, where)
        return StereoRig(*size, fx, fy, cx, cy, baseline_m)


def check_projection(p: FloatArray, where: str, advice: str = "correct the calibration") -> None:
    """Raise InputError unless P `(12,)` is that of a rectified camera. P of an uncalibrated camera is zero."""
    p_matrix = p.reshape(3, 4)
    if not p_matrix.any():
        raise InputError(
            f"{where} has no projection matrix p, as is usual for a camera that was not calibrated as part of a pair:",
            "calibrate both cameras as a pair",
        )
    fixed = p_matrix[[0, 1, 2, 2, 2, 1, 2], [1, 0, 0, 1, 3, 3, 2]]
    is_possible = bool(np.isfinite(p_matrix).all()) and p_matrix[0, 0] > 0
    if not is_possible or np.abs(fixed - [0, 0, 0, 0, 0, 0, 1]).max() > TOLERANCE:
        raise InputError(f"{where} is non-rectified (p is not that of a rectified left or right camera):", advice)

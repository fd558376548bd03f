"""The rotation of the right camera relative to its calibration, from the vertical disparity of a pair.

A camera that is rotated by the small angles `w` about its axes (x right, y down, z forward) sees the point `(x, y)`,
in normalised coordinates, to first order at

    x' = x - wy (1 + x^2) + wz y + wx x y
    y' = y + wx (1 + y^2) - wz x - wy x y

The change of x is an error of the disparity, which cannot be separated from depth. The change of y is vertical
disparity, which is measured: yaw (wy) as the saddle `x y`, roll (wz) as a tilt and pitch (wx) as an offset. An offset
of the principal point has the same effect as a pitch on y, but none on x. Residual lens distortion can have any of
these shapes, and its effect on x is about as large as that on y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.rectification_correction import (
    MIN_RESIDUAL_SIGMA,
    ROBUST_SIGMAS,
    SAMPLING_STRIDE,
    residual_and_mean,
)
from sfr_loc_map.mapping.robust_statistics import cauchy_weight, mad_sigma

F = np.float32

MIN_PIXELS = 5000  #: Valid samples that a measurement of the rotation requires.
MIN_ROTATION_PX = 0.05  #: Smallest vertical disparity, at the image's edge, that counts as a rotation; less is noise.
GRID_POINTS = 16  #: The vertical disparity is averaged over a grid of this many rows and columns.
DAMPING = 1e-12  #: Added to the diagonal of the normal equations, as a fraction of their trace.
SOBEL_DIFFERENCE = np.array([[-1.0, 0.0, 1.0]], F)
SOBEL_SMOOTHING = np.array([[0.125, 0.25, 0.125]], F)
"""Taps of the Sobel operator, whose result is in grey levels per pixel."""


@dataclass(frozen=True, slots=True)
class CameraRotation:
    """Rotation of the right camera relative to its calibration."""

    yaw_rad: float  #: About y; a positive yaw turns the camera to the right. 0 if too few pixels are valid.
    yaw_sigma_rad: float  #: Standard deviation of the yaw; infinite if too few pixels are valid.
    roll_rad: float  #: About z; a positive roll turns the camera clockwise.
    pitch_rad: float  #: About x; a positive pitch turns the camera up. Rotation that is equivalent to the offset.
    vertical_px: float  #: Root mean square of the vertical disparity over the image.
    bent_px: float  #: Root mean square of the vertical disparity without its offset and roll.


class VerticalFit(NamedTuple):
    """Least squares fit of the vertical disparity that the correction has left."""

    coefficients_px: FloatArray  #: `(5,)`, of 1, x, y, x y and y^2 in normalised coordinates of the right image.
    sigma_px: FloatArray  #: `(5,)`, standard deviations; infinite if too few pixels are valid.


def measure_right_camera(disparity: DisparityMap, rig: StereoRig) -> CameraRotation:
    """Return the rotation that explains the vertical disparity of a pair.

    The vertical disparity is the sum of the correction of the right image and of what the correction has left.
    """
    offset_px, tilt_px, stretch_px = disparity.correction.vertical_px
    coefficients, sigma = _fit_vertical_disparity(disparity, rig)
    constant, roll, stretch, saddle, square = coefficients
    side = GRID_POINTS * 1j
    v, u = np.mgrid[-1.0:1.0:side, -1.0:1.0:side]
    x = 0.5 * rig.width * u / rig.fx
    y = 0.5 * rig.height * v / rig.fy
    bent = stretch * y + saddle * x * y + square * y * y + stretch_px * v
    vertical = constant + roll * x + offset_px + tilt_px * u + bent
    return CameraRotation(
        yaw_rad=-float(saddle) / rig.fy,
        yaw_sigma_rad=float(sigma[3]) / rig.fy,
        roll_rad=-2.0 * tilt_px / rig.width - float(roll) / rig.fy,
        pitch_rad=(offset_px + float(constant)) / rig.fy,
        vertical_px=float(np.sqrt(np.mean(np.square(vertical)))),
        bent_px=float(np.std(bent)),
    )


def _fit_vertical_disparity(disparity: DisparityMap, rig: StereoRig) -> VerticalFit:
    """Return the robust fit of the vertical disparity of the corrected images."""
    residual, mean = residual_and_mean(disparity.left, disparity.right, disparity.px)
    slope_rows = cv2.filter2D(mean, -1, SOBEL_DIFFERENCE.T)[::SAMPLING_STRIDE]
    slope = cv2.filter2D(slope_rows, -1, SOBEL_SMOOTHING)[:, ::SAMPLING_STRIDE]
    sampled = np.s_[::SAMPLING_STRIDE, ::SAMPLING_STRIDE]
    residual = residual[sampled]
    usable = np.isfinite(residual) & disparity.valid[sampled]
    row, column = np.nonzero(usable)
    if len(row) < MIN_PIXELS:
        return VerticalFit(np.zeros(5), np.full(5, np.inf))
    r = residual[usable].astype(np.float64)
    g = slope[usable].astype(np.float64)
    x = (column * SAMPLING_STRIDE - disparity.px[sampled][usable] - rig.cx) / rig.fx
    y = (row * SAMPLING_STRIDE - rig.cy) / rig.fy
    sigma = mad_sigma(r) + MIN_RESIDUAL_SIGMA
    weight = cauchy_weight(r, ROBUST_SIGMAS * sigma)
    design = np.column_stack((np.ones(len(x)), x, y, x * y, y * y)) * g[:, None]
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    covariance = np.linalg.inv(normal + DAMPING * (np.trace(normal) + 1.0) * np.eye(5))
    coefficients = -(covariance @ (weighted.T @ r))
    return VerticalFit(coefficients, sigma * np.sqrt(np.diag(covariance)))


def without_roll(disparity: DisparityMap, rotation: CameraRotation, rig: StereoRig) -> DisparityMap:
    """Return the disparities without the error `-roll fy y` that a roll of the right camera causes.

    Rolls that shift the rows by less than `MIN_ROTATION_PX` at the image's edge are not compensated.
    """
    if abs(rotation.roll_rad) * 0.5 * rig.width < MIN_ROTATION_PX:
        return disparity
    rows = np.arange(rig.height, dtype=np.float64) - rig.cy
    compensated = disparity.px + F(rotation.roll_rad) * rows.astype(F)[:, None]
    return replace(disparity, px=np.asarray(compensated, F))

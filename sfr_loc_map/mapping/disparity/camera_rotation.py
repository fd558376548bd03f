"""Rotation of the right camera against its calibration, as far as vertical disparity shows it.

A camera that is rotated by the small angles `w` about its axes (x right, y down, z forward) sees the point `(x, y)`,
normalised, at `x - wy (1 + x^2) + wz y + wx x y`, `y + wx (1 + y^2) - wz x - wy x y` (first order). Along rows that is
an error of the disparity, which no pair can tell from depth. Across rows it is vertical disparity, which can be
measured: yaw as a saddle, roll as a tilt, pitch as an offset. An offset may as well be that of the principal point,
which leaves rows alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.photometric_residual import residual_at
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity
from sfr_loc_map.mapping.robust import mad_sigma

F = np.float32

STRIDE = 3
"""Every third pixel of every third row is used."""
MIN_PIXELS = 5000
TAIL = 2.0
"""Residuals of so many standard deviations have half their weight."""
MIN_ROLL_PX = 0.05
"""Vertical disparity at the edge of the image from which on a roll is compensated; less is within the measurement."""


@dataclass(frozen=True, slots=True)
class CameraRotation:
    """Rotation of the right camera against its calibration.

    Attributes:
        yaw_rad: About y; positive turns it to the right.
        yaw_sigma_rad: Standard deviation of the yaw.
        roll_rad: About z; positive turns it clockwise.
        pitch_rad: About x; positive turns it up. It is the rotation that the vertical offset amounts to.
    """

    yaw_rad: float
    yaw_sigma_rad: float
    roll_rad: float
    pitch_rad: float


def camera_rotation(left: FloatImage, refined: RefinedDisparity, valid: Mask, rig: StereoRig) -> CameraRotation:
    """Return the rotation that the vertical disparity of a pair shows; of too few pixels a yaw of 0, sigma infinite.

    The correction of rows has taken out an offset and tilts; what is left is fitted with them and the saddle of a yaw.

    Args:
        left: `(H, W)` float32.
        refined: Its disparities with the correction of the right image.
        valid: `(H, W)`, which disparities are valid.
        rig: Rig of the images.
    """
    offset_px, tilt_px, _ = refined.correction.vertical_px
    fit, deviation = _remaining_vertical(left, refined, valid, rig)
    return CameraRotation(
        yaw_rad=-float(fit[3]) / rig.fy,
        yaw_sigma_rad=float(deviation[3]) / rig.fy,
        roll_rad=-2.0 * tilt_px / rig.width - float(fit[1]) / rig.fy,
        pitch_rad=(offset_px + float(fit[0])) / rig.fy,
    )


def _remaining_vertical(
    left: FloatImage, refined: RefinedDisparity, valid: Mask, rig: StereoRig
) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients `(5,)` of 1, x, y, x y, y^2 of the vertical disparity, px, and their sigma."""
    residual, slope = _samples(left, refined.right, refined.disparity_px, valid)
    usable = np.isfinite(residual)
    v, u = np.nonzero(usable)
    if len(v) < MIN_PIXELS:
        return np.zeros(5), np.full(5, np.inf)
    r, g = residual[usable].astype(np.float64), slope[usable].astype(np.float64)
    disparity = refined.disparity_px[::STRIDE, ::STRIDE][usable]
    x, y = (u * STRIDE - disparity - rig.cx) / rig.fx, (v * STRIDE - rig.cy) / rig.fy
    sigma = mad_sigma(r) + 1e-3
    weight = 1.0 / (1.0 + np.square(r / (TAIL * sigma)))
    design = np.column_stack((np.ones(len(x)), x, y, x * y, y * y)) * g[:, None]
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    normal += 1e-12 * (np.trace(normal) + 1.0) * np.eye(5)
    inverse = np.linalg.inv(normal)
    return -(inverse @ (weighted.T @ r)), sigma * np.sqrt(np.diag(inverse))


@jit_rows_inline
def _template(left: FloatImage, right: FloatImage, disparity: FloatImage, y: int, x: int) -> np.float32:
    """Return the mean of a left pixel and its partner; the left one without a partner. The border is reflected."""
    rows, cols = left.shape
    y = abs(y) if y < rows else 2 * (rows - 1) - y
    x = abs(x) if x < cols else 2 * (cols - 1) - x
    value = residual_at(left, right, disparity, y, x)
    mean: np.float32 = left[y, x] + (F(0.5) * value if value == value else F(0.0))
    return mean


@jit_rows
def _samples(left: FloatImage, right: FloatImage, disparity: FloatImage, valid: Mask) -> tuple[FloatImage, FloatImage]:
    """Return residual and slope along the columns of every `STRIDE`-th pixel; NaN where not valid.

    The slope is that of the mean of both images, by the Sobel operator, grey levels per pixel.
    """
    rows, cols = (left.shape[0] + STRIDE - 1) // STRIDE, (left.shape[1] + STRIDE - 1) // STRIDE
    residual, slope = np.empty((rows, cols), F), np.zeros((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            y, x = STRIDE * i, STRIDE * j
            residual[i, j] = residual_at(left, right, disparity, y, x) if valid[y, x] else F(np.nan)
            if residual[i, j] == residual[i, j]:
                total = F(0.0)
                for k in range(-1, 2):
                    below = _template(left, right, disparity, y + 1, x + k)
                    total += F(2 - abs(k)) * (below - _template(left, right, disparity, y - 1, x + k))
                slope[i, j] = F(0.125) * total
    return residual, slope


def without_roll(disparity_px: FloatImage, rotation: CameraRotation, rig: StereoRig) -> FloatImage:
    """Return disparities `(H, W)` without what a roll of the right camera adds to them, `-roll fy y`.

    Less roll than shifts rows by `MIN_ROLL_PX` at the edges is left as it is.
    """
    if abs(rotation.roll_rad) * 0.5 * rig.width < MIN_ROLL_PX:
        return disparity_px
    rows = np.arange(rig.height, dtype=np.float64) - rig.cy
    return np.asarray(disparity_px + F(rotation.roll_rad) * rows.astype(F)[:, None], F)

"""Residual rectification error: unequal exposure and vertical disparity of a pair, measured and compensated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.photometric_residual import (
    fill_residual_row,
    photometric_residual,
    residual_at,
    shift_rows,
)
from sfr_loc_map.mapping.robust import mad_sigma

F = np.float32

STRIDE = 3
"""Every third pixel of every third row is used: a hundred thousand are plenty."""
ITERATIONS = 3
MIN_GREY, MAX_GREY = 2.0, 253.0
"""Grey levels beyond which a pixel may be saturated and does not count for the exposure."""
MIN_SPREAD = 8.0
"""Grey levels that an image must span for its contrast to be compared."""
MIN_EXPOSURE_PIXELS, MIN_ROW_PIXELS = 100, 1000
MIN_OFFSET_PX = 0.02
"""Rows are resampled only for more than this: resampling blurs, a hundredth of a pixel does not matter."""
MAX_STEP_PX = 0.5


@dataclass(frozen=True, slots=True)
class RectificationCorrection:
    """How the right image differs from a rectified, equally exposed one.

    Attributes:
        gain: Its contrast over that of the left image.
        offset: Its brightness where the left image's is 0, grey levels.
        vertical_px: Vertical disparity: its content lies lower than the left's by
            `vertical_px[0] + vertical_px[1] x + vertical_px[2] y` pixels, x and y from -1 to 1 over the left image.
    """

    gain: float
    offset: float
    vertical_px: tuple[float, float, float]

    @property
    def max_vertical_px(self) -> float:
        """Largest vertical disparity within the image, pixels."""
        return sum(abs(value) for value in self.vertical_px)


def correct_rectification(
    left: FloatImage, right: FloatImage, disparity_px: FloatImage
) -> tuple[RectificationCorrection, FloatImage]:
    """Measure gain, offset and vertical disparity; return them with the corrected right image.

    Args:
        left: `(H, W)` float32.
        right: `(H, W)` float32.
        disparity_px: `(H, W)` float32, right to about a pixel.
    """
    gain, offset = _exposure(left, right, disparity_px)
    equalised = (right - F(offset)) * F(1.0 / gain)
    corrected, vertical = equalised, np.zeros(3)
    for _ in range(ITERATIONS):
        step = _vertical_step(left, corrected, disparity_px)
        vertical += step
        if np.abs(vertical).sum() < MIN_OFFSET_PX:
            break
        corrected = _shifted_up(equalised, vertical)
        if np.abs(step).sum() < MIN_OFFSET_PX:
            break
    constant, tilt_x, tilt_y = (float(value) for value in vertical)
    return RectificationCorrection(gain, offset, (constant, tilt_x, tilt_y)), corrected


def _exposure(left: FloatImage, right: FloatImage, disparity: FloatImage) -> tuple[float, float]:
    """Return gain and offset of the right image against the left, from the spread of their common grey levels."""
    a = left[::4, ::4]
    b = photometric_residual(left, right, disparity)[::4, ::4] + a
    usable = (a > MIN_GREY) & (a < MAX_GREY) & (b > MIN_GREY) & (b < MAX_GREY)
    if usable.sum() < MIN_EXPOSURE_PIXELS:
        return 1.0, 0.0
    low_a, middle_a, high_a = np.quantile(a[usable], (0.1, 0.5, 0.9))
    low_b, middle_b, high_b = np.quantile(b[usable], (0.1, 0.5, 0.9))
    if high_a - low_a < MIN_SPREAD:
        return 1.0, float(middle_b - middle_a)
    gain = float(np.clip((high_b - low_b) / (high_a - low_a), 0.25, 4.0))
    return gain, float(middle_b - gain * middle_a)


def _vertical_step(left: FloatImage, right: FloatImage, disparity: FloatImage) -> FloatArray:
    """Return the change of the vertical disparity by one weighted least squares step over the whole image.

    Shifting the right image's content up by s changes the residual by `s` times the slope along columns. The step is 0
    where there is too little to measure it by.
    """
    residual, slope = _samples(left, right, disparity)
    usable = np.isfinite(residual)
    y, x = np.nonzero(usable)
    if len(y) < MIN_ROW_PIXELS:
        return np.zeros(3)
    r, g = residual[usable].astype(np.float64), slope[usable].astype(np.float64)
    weight = 1.0 / (1.0 + (r / (2.0 * (mad_sigma(r) + 1e-3))) ** 2)
    design = np.column_stack((np.ones(len(y)), 2.0 * x / residual.shape[1] - 1.0, 2.0 * y / residual.shape[0] - 1.0))
    design *= g[:, None]
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    if not normal.any():  # no slope anywhere
        return np.zeros(3)
    step = np.linalg.solve(normal + 1e-6 * np.trace(normal) * np.eye(3), -(weighted.T @ r))
    return np.asarray(np.clip(step, -MAX_STEP_PX, MAX_STEP_PX))


@jit_rows
def _samples(left: FloatImage, right: FloatImage, disparity: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return residual and slope along the columns of every `STRIDE`-th pixel; the residual is NaN without a partner.

    The slope is that of the mean of both images, by the Sobel operator, grey levels per pixel; 0 in the border rows.
    """
    height, width = left.shape
    shape = ((height + STRIDE - 1) // STRIDE, (width + STRIDE - 1) // STRIDE)
    residual, slope = np.empty(shape, F), np.zeros(shape, F)
    for i in prange(shape[0]):
        y = STRIDE * i
        for j in range(shape[1]):
            residual[i, j] = residual_at(left, right, disparity, y, STRIDE * j)
        if 0 < y < height - 1:
            for side in (-1, 1):
                mean = np.empty(width, F)
                fill_residual_row(left, right, disparity, y + side, mean)
                for x in range(width):
                    mean[x] = left[y + side, x] + (F(0.5) * mean[x] if mean[x] == mean[x] else F(0.0))
                for j in range(shape[1]):
                    x = STRIDE * j
                    beside = mean[abs(x - 1)] + mean[x + 1 if x < width - 1 else x - 1]
                    slope[i, j] = F(0.25) * mean[x] + F(0.125) * beside - slope[i, j]
    return residual, slope


def _shifted_up(image: FloatImage, vertical: FloatArray) -> FloatImage:
    """Return the image with its content moved up by a vertical disparity (cubic along columns)."""
    height, width = image.shape
    y, x = np.linspace(-1.0, 1.0, height)[:, None], np.linspace(-1.0, 1.0, width)[None]
    return shift_rows(image, (vertical[0] + vertical[1] * x + vertical[2] * y).astype(F))

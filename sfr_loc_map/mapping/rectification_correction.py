"""What a rectified pair should not have but may: unequal exposure and rows that do not quite correspond."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.mapping import photometric_residual as photometry

F = np.float32

STRIDE = 3
"""Every third pixel of every third row measures the alignment: a hundred thousand are plenty."""
ROUNDS = 3
DARKEST, BRIGHTEST = 2.0, 253.0
"""Grey levels beyond which a pixel may be cut off and says nothing of exposure."""
LEAST_SPREAD = 8.0
"""Grey levels that a picture must span for its contrast to be compared."""
LEAST_OFFSET_PX = 0.02
"""Rows are resampled only for more than this: resampling blurs, a hundredth of a pixel does not matter."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """How the right picture differs from a rectified, equally exposed one.

    Attributes:
        gain: Its contrast over that of the left picture.
        offset: Its brightness where the left picture's is 0, grey levels.
        rows_px: Its content lies lower than the left's by `rows_px[0] + rows_px[1] x + rows_px[2] y` pixels, x and y
            from -1 to 1 over the left picture.
    """

    gain: float
    offset: float
    rows_px: tuple[float, float, float]

    @property
    def largest_rows_px(self) -> float:
        """Largest row offset within the picture, pixels."""
        return abs(self.rows_px[0]) + abs(self.rows_px[1]) + abs(self.rows_px[2])


def align(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> tuple[Alignment, FloatImage]:
    """Measure the alignment and return it with the right picture set right.

    Args:
        left: `(H, W)` float32.
        right: `(H, W)` float32.
        disparity_px: `(H, W)` float32, right to about a pixel.
    """
    rows = np.zeros(3)
    gain, offset = _exposure(left, right, disparity_px)
    best = (right - F(offset)) * F(1.0 / gain)
    equal = best
    for _ in range(ROUNDS):
        step = _row_step(left, best, disparity_px)
        rows += step
        if np.abs(rows).sum() < LEAST_OFFSET_PX:
            break
        best = _rows_moved(equal, rows)
        if np.abs(step).sum() < LEAST_OFFSET_PX:
            break
    return Alignment(gain, offset, (float(rows[0]), float(rows[1]), float(rows[2]))), best


def _exposure(left: FloatImage, right: FloatImage, disparity: FloatImage) -> tuple[float, float]:
    """Return gain and offset of the right picture against the left, from the spread of the grey levels they share."""
    a = left[::4, ::4]
    b = photometry.residual_of(left, right, disparity)[::4, ::4] + a
    usable = (a > DARKEST) & (a < BRIGHTEST) & (b > DARKEST) & (b < BRIGHTEST)
    if usable.sum() < 100:
        return 1.0, 0.0
    low_a, middle_a, high_a = np.quantile(a[usable], (0.1, 0.5, 0.9))
    low_b, middle_b, high_b = np.quantile(b[usable], (0.1, 0.5, 0.9))
    if high_a - low_a < LEAST_SPREAD:
        return 1.0, float(middle_b - middle_a)
    gain = float(np.clip((high_b - low_b) / (high_a - low_a), 0.25, 4.0))
    return gain, float(middle_b - gain * middle_a)


def _row_step(left: FloatImage, right: FloatImage, disparity: FloatImage) -> NDArray[np.float64]:
    """Return the change of the row offset by one weighted least squares step over the whole picture.

    Moving the right picture's content up by s changes the residual by `s` times the slope along columns.
    """
    residual = photometry.residual_of(left, right, disparity)
    template = left + F(0.5) * np.nan_to_num(residual)
    slope = np.asarray(cv2.Sobel(template, cv2.CV_32F, 0, 1, ksize=3, scale=0.125), F)[::STRIDE, ::STRIDE]
    residual = residual[::STRIDE, ::STRIDE]
    usable = np.isfinite(residual)
    y, x = np.nonzero(usable)
    if len(y) < 1000:
        return np.zeros(3)
    r, g = residual[usable].astype(np.float64), slope[usable].astype(np.float64)
    spread = 1.4826 * float(np.median(np.abs(r))) + 1e-3
    weight = 1.0 / (1.0 + (r / (2.0 * spread)) ** 2)
    design = np.column_stack((np.ones(len(y)), 2.0 * x / residual.shape[1] - 1.0, 2.0 * y / residual.shape[0] - 1.0))
    design *= g[:, None]
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    step = np.linalg.solve(normal + 1e-6 * np.trace(normal) * np.eye(3), -(weighted.T @ r))
    return np.asarray(np.clip(step, -0.5, 0.5))


def _rows_moved(image: FloatImage, rows: NDArray[np.float64]) -> FloatImage:
    """Return the picture with its content moved up by the row offset (cubic along columns)."""
    height, width = image.shape
    y, x = np.linspace(-1.0, 1.0, height)[:, None], np.linspace(-1.0, 1.0, width)[None]
    shift = (rows[0] + rows[1] * x + rows[2] * y).astype(F)
    return photometry.rows_shifted(image, shift)

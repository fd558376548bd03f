"""Change detection: which cells of the left image have moved since an earlier image, independently of any pose.

A cell is compared with the same cell of an earlier image. Brightness and contrast are fitted first. The residual is
either noise, which is independent from pixel to pixel, or correlated between neighbours. Correlated residuals show that
the content of the cell has moved by a third of a pixel or more. A textured cell without them has not moved.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline

LEVEL: Final = 1  #: Pyramid level that is compared: it has half the noise of the image but most of its texture.
CELL_SIDE: Final = 8  #: Side of a cell, px of that level: 64 px decide, and an object of 16 px of the image fills one.
CELL: Final = CELL_SIDE << LEVEL  #: Side of a cell, pixels of the image.
NOISE_CORRELATION: Final = 0.35
"""Correlation of neighbouring pixels of the residual above which it is not noise. The standard error of a correlation
of 49 products is 0.14, so that noise exceeds 0.35 in about one of a hundred cells."""
MIN_CHANGE: Final = 0.03
"""Threshold of change: covariance of neighbouring residuals over the smaller gradient variance. Content that moves by a
third of a pixel exceeds it."""
MAX_CELL_NOISE: Final = 0.33
"""Maximum variance of the residual of a cell that stays, over its smaller gradient variance. With more noise a motion
of half a pixel would not be detected."""
MIN_GRADIENT: Final = 1.0
"""Minimum gradient variance of a textured cell, grey levels squared per pixel squared. The rounding of images to whole
grey levels gives at most 0.17."""
CONTRAST: Final = 4.0
"""Variance of a cell, grey levels squared, at which the gain is halfway between 1 and its fit. Below a standard
deviation of two grey levels the noise dominates the fit."""


class Change(NamedTuple):
    """Left image against an earlier one, by cell `(R, C)`."""

    changed: Mask  #: The content has moved.
    stays: Mask  #: The cell is textured and its content has not moved.


@jit_fast_ir_inline
def _fill_residual(before: FloatImage, now: FloatImage, residual: FloatImage) -> np.float32:
    """Fill what a change of brightness and contrast leaves of the difference of two cells; return its variance."""
    count = np.float32(CELL_SIDE * CELL_SIDE)
    sum_before = sum_now = sum_squares = sum_products = np.float32(0.0)
    for j in range(CELL_SIDE):
        for i in range(CELL_SIDE):
            sum_before += before[j, i]
            sum_now += now[j, i]
            sum_squares += before[j, i] * before[j, i]
            sum_products += before[j, i] * now[j, i]
    mean_before = sum_before / count
    mean_now = sum_now / count
    variance_before = sum_squares / count - mean_before * mean_before
    covariance = sum_products / count - mean_before * mean_now
    gain = (covariance + np.float32(CONTRAST)) / (variance_before + np.float32(CONTRAST))
    sum_residuals = np.float32(0.0)
    for j in range(CELL_SIDE):
        for i in range(CELL_SIDE):
            residual[j, i] = now[j, i] - mean_now - gain * (before[j, i] - mean_before)
            sum_residuals += residual[j, i] * residual[j, i]
    return sum_residuals / count


@jit_fast_ir_inline
def _neighbour_covariance(residual: FloatImage) -> np.float32:
    """Return the covariance of neighbouring pixels of a residual, the larger one of along rows and along columns."""
    along_u = along_v = np.float32(0.0)
    for j in range(CELL_SIDE - 1):
        for i in range(CELL_SIDE - 1):
            along_u += residual[j, i] * residual[j, i + 1]
            along_v += residual[j, i] * residual[j + 1, i]
    covariance: np.float32 = max(along_u, along_v) / np.float32((CELL_SIDE - 1) ** 2)
    return covariance


@jit_fast_ir_inline
def _gradient_variance(cell: FloatImage) -> np.float32:
    """Return the smaller eigenvalue of the covariance of the gradients of a cell (compare Shi and Tomasi 1994).

    The mean gradient is subtracted because a constant slope that moves is a change of brightness. The smaller
    eigenvalue counts because an edge may move along itself.
    """
    count = np.float32((CELL_SIDE - 1) ** 2)
    sum_uu = sum_uv = sum_vv = sum_u = sum_v = np.float32(0.0)
    for j in range(CELL_SIDE - 1):
        for i in range(CELL_SIDE - 1):
            du = cell[j, i + 1] - cell[j, i]
            dv = cell[j + 1, i] - cell[j, i]
            sum_u += du
            sum_v += dv
            sum_uu += du * du
            sum_uv += du * dv
            sum_vv += dv * dv
    mean_u = sum_u / count
    mean_v = sum_v / count
    uu = sum_uu / count - mean_u**2
    uv = sum_uv / count - mean_u * mean_v
    vv = sum_vv / count - mean_v**2
    smaller: np.float32 = 0.5 * (uu + vv) - np.sqrt(0.25 * (uu - vv) ** 2 + uv * uv)
    return smaller


@jit_fast
def change_of(before: FloatImage, now: FloatImage) -> Change:
    """Compare the cells of two images of the level."""
    rows = now.shape[0] // CELL_SIDE
    columns = now.shape[1] // CELL_SIDE
    changed = np.zeros((rows, columns), np.bool_)
    stays = np.zeros((rows, columns), np.bool_)
    residual = np.empty((CELL_SIDE, CELL_SIDE), np.float32)
    for row in range(rows):
        for column in range(columns):
            cell_before = before[
                CELL_SIDE * row : CELL_SIDE * row + CELL_SIDE, CELL_SIDE * column : CELL_SIDE * column + CELL_SIDE
            ]
            cell_now = now[
                CELL_SIDE * row : CELL_SIDE * row + CELL_SIDE, CELL_SIDE * column : CELL_SIDE * column + CELL_SIDE
            ]
            noise = _fill_residual(cell_before, cell_now, residual)
            structure = _neighbour_covariance(residual)
            texture = _gradient_variance(cell_now)
            changed[row, column] = structure > NOISE_CORRELATION * noise and structure > MIN_CHANGE * texture
            stays[row, column] = not changed[row, column] and texture > MIN_GRADIENT + noise / MAX_CELL_NOISE
    return Change(changed, stays)


def cell_counts(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the numbers of rows and columns of cells in an image of a shape (height, width)."""
    height, width = shape
    return (height >> LEVEL) // CELL_SIDE, (width >> LEVEL) // CELL_SIDE

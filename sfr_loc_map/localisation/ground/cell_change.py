"""Change detection: find the cells of the left image whose content has moved since an earlier image, without a pose.

Each cell is compared with the same cell of an earlier image after a fit of brightness and contrast. Image noise leaves
a residual that is independent from pixel to pixel. Content that has moved by a third of a pixel or more leaves a
residual that is correlated between neighbouring pixels. A textured cell with an uncorrelated residual is stationary.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline

LEVEL: Final = 1  #: Pyramid level of the comparison, with half the noise of the image and most of its texture.
CELL_SIDE: Final = 8  #: Side of a cell, px of the level. A cell covers 16 x 16 px of the image.
CELL: Final = CELL_SIDE << LEVEL  #: Side of a cell, pixels of the image.
NOISE_CORRELATION: Final = 0.35
"""Maximum correlation of neighbouring pixels in a residual of pure noise. The standard error of a correlation from 49
products is 0.14, so noise exceeds 0.35 in about one of a hundred cells."""
MIN_CHANGE: Final = 0.03
"""Minimum ratio of the covariance of neighbouring residuals to the gradient variance (`_gradient_variance`) in a
changed cell. Content that moves by a third of a pixel exceeds this ratio."""
MAX_CELL_NOISE: Final = 0.33
"""Maximum ratio of the residual variance to the gradient variance in a stationary cell. With more noise, a motion of
half a pixel would not be detected."""
MIN_GRADIENT: Final = 1.0
"""Minimum gradient variance of a textured cell, grey levels squared per pixel squared. Rounding to whole grey levels
contributes at most 0.17."""
CONTRAST: Final = 4.0
"""Variance of a cell, grey levels squared, at which the gain is halfway between 1 and its least-squares estimate. Noise
dominates that estimate if the standard deviation of the cell is below two grey levels."""


class Change(NamedTuple):
    """Comparison of the left image with an earlier one: masks `(R, C)` over R rows and C columns of cells."""

    changed: Mask  #: Cells whose content has moved.
    stationary: Mask  #: Textured cells whose content has not moved.


@jit_fast_ir_inline
def _fill_residual(before: FloatImage, now: FloatImage, residual: FloatImage) -> np.float32:
    """Fill the residual of two cells after a fit of brightness and contrast; return its variance."""
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
    """Return the covariance of neighbouring pixels of a residual, along rows or along columns, whichever is larger."""
    along_u = along_v = np.float32(0.0)
    for j in range(CELL_SIDE - 1):
        for i in range(CELL_SIDE - 1):
            along_u += residual[j, i] * residual[j, i + 1]
            along_v += residual[j, i] * residual[j + 1, i]
    covariance: np.float32 = max(along_u, along_v) / np.float32((CELL_SIDE - 1) ** 2)
    return covariance


@jit_fast_ir_inline
def _gradient_variance(cell: FloatImage) -> np.float32:
    """Return the smaller eigenvalue of the gradients' covariance in a cell (compare Shi and Tomasi 1994).

    The mean gradient is subtracted because the motion of a constant gradient only changes the brightness. The smaller
    eigenvalue is used because a motion along an edge does not change the image.
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
    """Compare the cells of two images of pyramid level `LEVEL`."""
    rows = now.shape[0] // CELL_SIDE
    columns = now.shape[1] // CELL_SIDE
    changed = np.zeros((rows, columns), np.bool_)
    stationary = np.zeros((rows, columns), np.bool_)
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
            stationary[row, column] = not changed[row, column] and texture > MIN_GRADIENT + noise / MAX_CELL_NOISE
    return Change(changed, stationary)


def cell_counts(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the numbers of rows and columns of cells in an image of shape (height, width)."""
    height, width = shape
    return (height >> LEVEL) // CELL_SIDE, (width >> LEVEL) // CELL_SIDE

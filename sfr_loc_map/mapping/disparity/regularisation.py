"""The smoothness term: weighted second differences of the disparity field, `A`, and their adjoint, `A'`.

The energy is `sum w_x (d_xx)^2 + w_y (d_yy)^2 + w_m (d_xy)^2`; its gradient is `A' W A d`. Differences that would reach
beyond the border have the weight 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32


class SmoothnessWeights(NamedTuple):
    """Weights of the second differences, 1 / pixels^2, `(h, w)` float32 each.

    Attributes:
        along_x: Of the differences along rows.
        along_y: Of the differences along columns.
        mixed: Of the mixed differences between a cell, its right and its lower neighbours.
    """

    along_x: FloatImage
    along_y: FloatImage
    mixed: FloatImage


@jit_rows
def smoothness_weight(
    field: FloatImage, scale_x: FloatImage, scale_y: FloatImage, factor: np.float32
) -> SmoothnessWeights:
    """Weight the second differences of a field by how far they exceed their scale (Cauchy: `1 / (scale^2 + q^2)`).

    Args:
        field: `(h, w)`.
        scale_x: `(h, w)`, typical size of second differences along rows.
        scale_y: `(h, w)`, the same along columns; the mixed one takes the geometric mean.
        factor: Multiplies both scales.
    """
    rows, cols = field.shape
    along_x, along_y, mixed = np.empty_like(field), np.empty_like(field), np.empty_like(field)
    for i in prange(rows):
        for j in range(cols):
            tx, ty = factor * scale_x[i, j], factor * scale_y[i, j]
            wx = wy = wm = F(0.0)
            if 0 < j < cols - 1:
                q = field[i, j - 1] - F(2.0) * field[i, j] + field[i, j + 1]
                wx = F(1.0) / (tx * tx + q * q)
            if 0 < i < rows - 1:
                q = field[i - 1, j] - F(2.0) * field[i, j] + field[i + 1, j]
                wy = F(1.0) / (ty * ty + q * q)
            if i < rows - 1 and j < cols - 1:
                q = field[i, j] - field[i + 1, j] - field[i, j + 1] + field[i + 1, j + 1]
                wm = F(2.0) / (tx * ty + q * q)
            along_x[i, j], along_y[i, j], mixed[i, j] = wx, wy, wm
    return SmoothnessWeights(along_x, along_y, mixed)


@jit_rows_inline
def _fill_differences(
    field: FloatImage, row: int, weights: SmoothnessWeights, i: int, along_x: FloatImage, along_y: FloatImage
) -> None:
    """Fill the weighted second differences along both axes of one row of a grid, `(w + 2,)` each with a border of 0.

    Args:
        field: `(n, w)`, some rows of the grid.
        row: That of the field.
        weights: Of the grid.
        i: The same row within the grid.
        along_x: Filled.
        along_y: Filled.
    """
    cols = field.shape[1]
    above, centre, below = field[max(row - 1, 0)], field[row], field[min(row + 1, len(field) - 1)]
    # One loop for each array that is filled: in one with more the compiler does not see that they are apart.
    inside, beside, weight = along_x[2:cols], centre[1:], weights.along_x[i, 1:]
    for j in range(len(inside)):
        inside[j] = weight[j] * (centre[j] - F(2.0) * beside[j] + beside[j + 1])
    inside, weight = along_y[1:], weights.along_y[i]
    for j in range(cols):
        inside[j] = weight[j] * (above[j] - F(2.0) * centre[j] + below[j])


@jit_rows_inline
def _fill_mixed(field: FloatImage, row: int, weights: SmoothnessWeights, i: int, mixed: FloatImage) -> None:
    """Fill the weighted mixed differences of one row `(w + 2,)`, as `_fill_differences`."""
    centre, below = field[row], field[min(row + 1, len(field) - 1)]
    inside, weight = mixed[1:-2], weights.mixed[i]
    right, below_right = centre[1:], below[1:]
    for j in range(len(inside)):
        inside[j] = weight[j] * (centre[j] - below[j] - right[j] + below_right[j])


@jit_rows_inline
def _clear(row: FloatImage, inside: bool) -> None:
    """Set a row's differences to 0, of one inside the grid those only that nothing fills."""
    if inside:
        row[0] = row[1] = row[len(row) - 2] = row[len(row) - 1] = F(0.0)
    else:
        for j in range(len(row)):
            row[j] = F(0.0)


@jit_rows_inline
def fill_smoothness(field: FloatImage, top: int, weights: SmoothnessWeights, first: int, out: FloatImage) -> None:
    """Fill some rows of `A' W A field`, the gradient of the smoothness term.

    Args:
        field: `(n, w)`, rows of the grid from `top` on: those to fill and two more on either side, where there are.
        top: Row of the grid.
        weights: Of the grid.
        first: Row of the grid, the first to fill.
        out: `(m, w)`, filled.
    """
    rows, cols = weights.mixed.shape
    size = (len(out) + 2, cols + 2)
    along_x, along_y, mixed = np.empty(size, F), np.empty(size, F), np.empty(size, F)
    for n in range(len(out) + 2):
        i = first - 1 + n
        _clear(along_x[n], 0 <= i < rows)
        _clear(along_y[n], 0 <= i < rows)
        _clear(mixed[n], 0 <= i < rows)
        if 0 <= i < rows:
            _fill_differences(field, i - top, weights, i, along_x[n], along_y[n])
            _fill_mixed(field, i - top, weights, i, mixed[n])
    for n in range(len(out)):
        row, x, y0, y1, y2 = out[n], along_x[n + 1], along_y[n], along_y[n + 1], along_y[n + 2]
        m0, m1 = mixed[n], mixed[n + 1]
        x1, x2, y0, y1, y2 = x[1:], x[2:], y0[1:], y1[1:], y2[1:]
        for j in range(cols):
            row[j] = (x[j] - F(2.0) * x1[j] + x2[j]) + (y0[j] - F(2.0) * y1[j] + y2[j])
        m0_right, m1_right = m0[1:], m1[1:]
        for j in range(cols):
            row[j] += m1_right[j] - m1[j] - m0_right[j] + m0[j]


@jit_rows
def inverse_diagonal(information: FloatImage, weights: SmoothnessWeights) -> FloatImage:
    """Return one over the diagonal of `diag(information) + A' W A` `(h, w)`."""
    rows, cols = information.shape
    along_x, along_y, mixed = weights.along_x, weights.along_y, weights.mixed
    out = np.empty((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            value = information[i, j] + F(4.0) * (along_x[i, j] + along_y[i, j]) + mixed[i, j]
            if j > 0:
                value += along_x[i, j - 1] + mixed[i, j - 1]
            if j < cols - 1:
                value += along_x[i, j + 1]
            if i > 0:
                value += along_y[i - 1, j] + mixed[i - 1, j]
                if j > 0:
                    value += mixed[i - 1, j - 1]
            if i < rows - 1:
                value += along_y[i + 1, j]
            out[i, j] = F(1.0) / (value + F(1e-12))
    return out

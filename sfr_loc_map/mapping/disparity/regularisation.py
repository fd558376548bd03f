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


class SecondDifferences(NamedTuple):
    """Weighted second differences of a field `(h, w)`, with a border of 0: `(h + 2, w + 2)` float32 each."""

    along_x: FloatImage
    along_y: FloatImage
    mixed: FloatImage

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> SecondDifferences:
        """Return those of a flat field of a shape `(h, w)`."""
        size = (shape[0] + 2, shape[1] + 2)
        return cls(np.zeros(size, F), np.zeros(size, F), np.zeros(size, F))


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


@jit_rows
def apply_operator(field: FloatImage, weights: SmoothnessWeights, out: SecondDifferences) -> None:
    """Fill the inside of `out` with the weighted second differences of a field `(h, w)`, `W A field`."""
    rows, cols = field.shape
    out_x, out_y, out_mixed = out.along_x, out.along_y, out.mixed
    for i in prange(rows):
        above, below = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(1, cols - 1):
            centre = field[i, j]
            twice = F(2.0) * centre
            mixed = centre - field[below, j] - field[i, j + 1] + field[below, j + 1]
            out_x[i + 1, j + 1] = weights.along_x[i, j] * (field[i, j - 1] - twice + field[i, j + 1])
            out_y[i + 1, j + 1] = weights.along_y[i, j] * (field[above, j] - twice + field[below, j])
            out_mixed[i + 1, j + 1] = weights.mixed[i, j] * mixed
        for j in (0, cols - 1):
            right = min(j + 1, cols - 1)
            mixed = field[i, j] - field[below, j] - field[i, right] + field[below, right]
            along_y = field[above, j] - F(2.0) * field[i, j] + field[below, j]
            out_x[i + 1, j + 1] = F(0.0)
            out_y[i + 1, j + 1] = weights.along_y[i, j] * along_y
            out_mixed[i + 1, j + 1] = weights.mixed[i, j] * mixed


@jit_rows_inline
def apply_adjoint(q: SecondDifferences, i: int, j: int) -> np.float32:
    """Return `A' q` at cell (i, j): the transpose of taking second differences."""
    along_x = q.along_x[i + 1, j] - F(2.0) * q.along_x[i + 1, j + 1] + q.along_x[i + 1, j + 2]
    along_y = q.along_y[i, j + 1] - F(2.0) * q.along_y[i + 1, j + 1] + q.along_y[i + 2, j + 1]
    mixed = q.mixed[i + 1, j + 1] - q.mixed[i + 1, j] - q.mixed[i, j + 1] + q.mixed[i, j]
    total: np.float32 = along_x + along_y + mixed
    return total


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

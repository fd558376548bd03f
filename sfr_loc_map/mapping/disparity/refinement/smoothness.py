"""The smoothness term of the refinement: scale and weights of the second differences, operator and diagonal.

The smoothness energy of a field d is `sum w_x (d_xx)^2 + w_y (d_yy)^2 + w_m (d_xy)^2`. With A the operator of the
second differences and W their weights, half its gradient is `A' W A d`. Differences that reach beyond the border have
the weight 0. `conjugate_gradients` solves the data term and this term together.

A second difference far above the scale of the ground loses weight, for example at the edge of a rock. The scale is
proportional to the typical second differences of the field, which are measured in each pair, around each cell and along
each axis. These differences are computed on a grid with a multiple of the spacing of the cells (`SCALE_LEVEL`), so that
they exceed the noise of the field.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatImage, median
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.filters import box_mean, downsample_mean, second_differences, upsample_bilinear

SCALE_LEVEL = 2
"""Number of doublings of the cells' spacing at which the differences are measured, so that they exceed the noise."""
SCALE_FACTOR = 4.9
"""Ratio of the scale of the Cauchy weights to the measured second differences, both at the spacing of the
measurement."""
EDGE_FACTOR = 10.0  #: Second differences above this multiple of the median are edges, not the shape of the ground.
LOCAL_MAGNITUDE_WINDOW = 9
"""Side of the window over which the measured second differences are averaged, in units of their spacing, 4 cells."""
SCALE_WINDOW = 5  #: Side of the window over which the local magnitudes are then averaged, in the same units.
MIN_SCALE = 0.1  #: Minimum ratio of a local magnitude to the median of the image, so that flat regions can still bend.
MIN_TYPICAL_PX = 1e-3  #: Lower bound of the median of the second differences, pixels, which must not be 0.
GRID_FACTOR = 2.8
"""Growth of the typical second difference per doubling of the spacing, `2^1.5`: between fractal ground (2 or less) and
a surface of constant curvature (4)."""
MIN_DIAGONAL = F(1e-12)  #: Value added to the diagonal, 1 / px^2, because the diagonal must not be 0.
BLOCK_ROWS = 32  #: Rows of a block, which one thread computes, so that intermediate results stay in its cache.


class SmoothnessWeights(NamedTuple):
    """Weights of the second differences, 1 / pixels^2, `(h, w)` float32 each."""

    along_x: FloatImage  #: Weights of the differences along rows.
    along_y: FloatImage  #: Weights of the differences along columns.
    mixed: FloatImage  #: Weights of the mixed differences of a cell with its right and its lower neighbours.


def cauchy_scale_of(cells: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the scale of the Cauchy weights along rows and along columns on the finest grid, `(h, w)` each, pixels.

    The scale follows from second differences on a coarser grid.
    """
    along_x, along_y = second_differences(downsample_mean(cells, 2**SCALE_LEVEL))
    factor = F(SCALE_FACTOR / GRID_FACTOR**SCALE_LEVEL)
    scale_x = upsample_bilinear(_local_magnitude(along_x), cells.shape) * factor
    scale_y = upsample_bilinear(_local_magnitude(along_y), cells.shape) * factor
    return scale_x, scale_y


def _local_magnitude(differences: FloatImage) -> FloatImage:
    """Return the typical magnitude of differences around each element: the squared mean of the roots of magnitudes.

    Single large differences, for example at edges, have little influence on this mean and are clipped to `EDGE_FACTOR`
    medians.
    """
    magnitude = np.abs(differences)
    typical = max(median(magnitude), MIN_TYPICAL_PX)
    clipped = np.minimum(magnitude, F(EDGE_FACTOR * typical))
    local = np.square(box_mean(np.sqrt(clipped), LOCAL_MAGNITUDE_WINDOW))
    return box_mean(np.maximum(local, F(MIN_SCALE * typical)), SCALE_WINDOW)


@jit_rows
def smoothness_weights(
    field: FloatImage, scale_x: FloatImage, scale_y: FloatImage, factor: np.float32
) -> SmoothnessWeights:
    """Return the Cauchy weights of the second differences q of a field.

    The weights are `1 / (scale^2 + q^2)` along rows and along columns, and `2 / (scale^2 + q^2)` for the mixed
    differences. At equal scales the energy is then proportional to `d_xx^2 + 2 d_xy^2 + d_yy^2`, which is invariant to
    rotation. The scales `(h, w)`, multiplied by the factor, are the typical sizes of second differences along rows and
    along columns. The scale of the mixed differences is the geometric mean of both.
    """
    rows, cols = field.shape
    along_x = np.empty_like(field)
    along_y = np.empty_like(field)
    mixed = np.empty_like(field)
    for i in prange(rows):
        for j in range(cols):
            tx = factor * scale_x[i, j]
            ty = factor * scale_y[i, j]
            wx = F(0.0)
            wy = F(0.0)
            wm = F(0.0)
            if 0 < j < cols - 1:
                q = field[i, j - 1] - F(2.0) * field[i, j] + field[i, j + 1]
                wx = F(1.0) / (tx * tx + q * q)
            if 0 < i < rows - 1:
                q = field[i - 1, j] - F(2.0) * field[i, j] + field[i + 1, j]
                wy = F(1.0) / (ty * ty + q * q)
            if i < rows - 1 and j < cols - 1:
                q = field[i, j] - field[i + 1, j] - field[i, j + 1] + field[i + 1, j + 1]
                wm = F(2.0) / (tx * ty + q * q)
            along_x[i, j] = wx
            along_y[i, j] = wy
            mixed[i, j] = wm
    return SmoothnessWeights(along_x, along_y, mixed)


@jit_rows_inline
def _write_differences(
    field: FloatImage,
    i_in_field: int,
    weights: SmoothnessWeights,
    i: int,
    along_x: FloatImage,
    along_y: FloatImage,
    mixed: FloatImage,
) -> None:
    """Write the weighted second differences of row i of a grid, `(w + 2,)` each, except their border.

    Element k of an output belongs to column k - 1 of the grid. Differences along x exist at columns 1 to w - 2,
    differences along y at all columns, and mixed differences, of columns j and j + 1, at columns 0 to w - 2.

    The field `(n, w)` consists of rows of the grid, and row i of the grid is row `i_in_field` of the field.
    """
    cols = field.shape[1]
    above = field[max(i_in_field - 1, 0)]
    centre = field[i_in_field]
    below = field[min(i_in_field + 1, len(field) - 1)]
    right = centre[1:]
    below_right = below[1:]
    # One loop per output array: with several outputs the compiler assumes that they overlap and does not vectorise.
    inside = along_x[2:cols]
    weight = weights.along_x[i, 1:]
    for j in range(len(inside)):
        inside[j] = weight[j] * (centre[j] - F(2.0) * right[j] + right[j + 1])
    inside = along_y[1:]
    weight = weights.along_y[i]
    for j in range(cols):
        inside[j] = weight[j] * (above[j] - F(2.0) * centre[j] + below[j])
    inside = mixed[1:-2]
    weight = weights.mixed[i]
    for j in range(len(inside)):
        inside[j] = weight[j] * (centre[j] - below[j] - right[j] + below_right[j])


@jit_rows_inline
def write_smoothness(field: FloatImage, top: int, weights: SmoothnessWeights, first: int, out: FloatImage) -> None:
    """Write rows `(m, w)` of `A' W A field` to `out`, starting at row `first` of the grid.

    The field `(n, w)` begins at row `top` of the grid. It contains the rows to write and, within the grid, two more
    rows on either side. The weighted differences have one border row on either side, which is 0 outside the grid, and
    one border column on either side, which is 0:

        rows of the grid   first - 2 | first - 1 | first ... first + m - 1 | first + m | first + m + 1
        field                  x           x                  x                  x             x
        differences                      n = 0             1 ... m             m + 1
        out                                              0 ... m - 1

    Element k of a row of differences belongs to column k - 1. In the second loop, element j of the shifted rows is
    therefore column j - 1 (no shift), j (`[1:]`) or j + 1 (`[2:]`).
    """
    rows, cols = weights.mixed.shape
    size = (len(out) + 2, cols + 2)
    along_x = np.empty(size, F)
    along_y = np.empty(size, F)
    mixed = np.empty(size, F)
    for n in range(len(out) + 2):
        i = first - 1 + n
        for row in (along_x[n], along_y[n], mixed[n]):
            if 0 <= i < rows:  # the inside is written below
                row[0] = F(0.0)
                row[1] = F(0.0)
                row[cols] = F(0.0)
                row[cols + 1] = F(0.0)
            else:
                for j in range(cols + 2):
                    row[j] = F(0.0)
        if 0 <= i < rows:
            _write_differences(field, i - top, weights, i, along_x[n], along_y[n], mixed[n])
    for n in range(len(out)):
        row = out[n]
        x0 = along_x[n + 1]
        x1 = x0[1:]
        x2 = x0[2:]
        y0 = along_y[n][1:]
        y1 = along_y[n + 1][1:]
        y2 = along_y[n + 2][1:]
        for j in range(cols):
            row[j] = (x0[j] - F(2.0) * x1[j] + x2[j]) + (y0[j] - F(2.0) * y1[j] + y2[j])
        m0 = mixed[n]
        m1 = mixed[n + 1]
        m0_right = m0[1:]
        m1_right = m1[1:]
        for j in range(cols):
            row[j] += m1_right[j] - m1[j] - m0_right[j] + m0[j]


@jit_rows
def inverse_diagonal(information: FloatImage, weights: SmoothnessWeights) -> FloatImage:
    """Return the inverse of the diagonal of `diag(information) + A' W A` `(h, w)`."""
    rows, cols = information.shape
    along_x = weights.along_x
    along_y = weights.along_y
    mixed = weights.mixed
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
            out[i, j] = F(1.0) / (value + MIN_DIAGONAL)
    return out


@jit_rows
def smoothness_gradient(field: FloatImage, weights: SmoothnessWeights) -> FloatImage:
    """Return `A' W A field` `(h, w)`: half the gradient of the smoothness energy.

    In numpy, with the field d and the weights w (differences along y are computed like those along x, transposed):

        xx = w.along_x[:, 1:-1] * np.diff(d, 2, axis=1)
        out[:, :-2] += xx; out[:, 1:-1] -= 2 * xx; out[:, 2:] += xx
        xy = w.mixed[:-1, :-1] * np.diff(np.diff(d, axis=0), axis=1)
        out[:-1, :-1] += xy; out[1:, :-1] -= xy; out[:-1, 1:] -= xy; out[1:, 1:] += xy

    The kernels compute the same result in blocks of rows, without intermediate images.
    """
    rows, cols = field.shape
    out = np.empty((rows, cols), F)
    for block in prange((rows + BLOCK_ROWS - 1) // BLOCK_ROWS):
        first = BLOCK_ROWS * block
        last = min(first + BLOCK_ROWS, rows)
        write_smoothness(field, 0, weights, first, out[first:last])
    return out

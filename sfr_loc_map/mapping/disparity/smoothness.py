"""The smoothness term, and the linear solve by which it and the data term change the disparity field.

The smoothness energy is `sum w_x (d_xx)^2 + w_y (d_yy)^2 + w_m (d_xy)^2`, weighted second differences `A` of the field
d; its gradient is `A' W A d`. Differences that would reach beyond the border have the weight 0. The change s solves
`(H + A' W A) s = b - A' W A d`, H the information of the data term and b its information vector, by preconditioned
conjugate gradients (Shewchuk 1994, section B3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline, on_one_thread

F = np.float32

MAX_STEP_PX = F(1.0)  #: No field changes by more than this in one solve: beyond it the linearisation does not hold.
MIN_SHARED = 100_000  #: Cells from which on threads share a grid.
BLOCK_ROWS = 32
"""Rows that a thread takes at once: what lies between their input and their output stays in its cache."""
SUMMED_ROWS = 4  #: Rows that are summed side by side, each in its order: one sum alone waits for itself.


class SmoothnessWeights(NamedTuple):
    """Weights of the second differences, 1 / pixels^2, `(h, w)` float32 each."""

    along_x: FloatImage  # of the differences along rows
    along_y: FloatImage  # of the differences along columns
    mixed: FloatImage  # of the mixed differences between a cell, its right and its lower neighbours


@jit_rows
def smoothness_weight(
    field: FloatImage, scale_x: FloatImage, scale_y: FloatImage, factor: np.float32
) -> SmoothnessWeights:
    """Weight the second differences of a field by how far they exceed their scale (Cauchy: `1 / (scale^2 + q^2)`).

    Scales `(h, w)` are the typical size of second differences along rows and along columns, both to be multiplied by a
    factor; the mixed one takes the geometric mean.
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
    field: FloatImage,
    row: int,
    weights: SmoothnessWeights,
    i: int,
    along_x: FloatImage,
    along_y: FloatImage,
    mixed: FloatImage,
) -> None:
    """Fill the weighted second differences of row i of a grid, `(w + 2,)` each with a border that stays.

    The field is `(n, w)`, some rows of the grid, `row` being i among them.
    """
    cols = field.shape[1]
    above, centre, below = field[max(row - 1, 0)], field[row], field[min(row + 1, len(field) - 1)]
    right, below_right = centre[1:], below[1:]
    # One loop for each array that is filled: in one with more the compiler does not see that they are apart.
    inside, weight = along_x[2:cols], weights.along_x[i, 1:]
    for j in range(len(inside)):
        inside[j] = weight[j] * (centre[j] - F(2.0) * right[j] + right[j + 1])
    inside, weight = along_y[1:], weights.along_y[i]
    for j in range(cols):
        inside[j] = weight[j] * (above[j] - F(2.0) * centre[j] + below[j])
    inside, weight = mixed[1:-2], weights.mixed[i]
    for j in range(len(inside)):
        inside[j] = weight[j] * (centre[j] - below[j] - right[j] + below_right[j])


@jit_rows_inline
def fill_smoothness(field: FloatImage, top: int, weights: SmoothnessWeights, first: int, out: FloatImage) -> None:
    """Fill rows `(m, w)` of `A' W A field` from the grid's row `first` on: the gradient of the smoothness term.

    The field `(n, w)` begins at the row `top`: the rows to fill and two more on either side, where there are.
    """
    rows, cols = weights.mixed.shape
    size = (len(out) + 2, cols + 2)
    along_x, along_y, mixed = np.empty(size, F), np.empty(size, F), np.empty(size, F)
    for n in range(len(out) + 2):
        i = first - 1 + n
        for row in (along_x[n], along_y[n], mixed[n]):
            if 0 <= i < rows:  # the others are filled
                row[0] = row[1] = row[cols] = row[cols + 1] = F(0.0)
            else:
                for j in range(cols + 2):
                    row[j] = F(0.0)
        if 0 <= i < rows:
            _fill_differences(field, i - top, weights, i, along_x[n], along_y[n], mixed[n])
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


class SolverState(NamedTuple):
    """State of a solve, `(h, w)` float32 each."""

    step: FloatImage  # the solution so far
    residual: FloatImage  # right side minus the system's matrix times the step
    direction: FloatImage  # search direction
    before: FloatImage  # the search direction before
    product: FloatImage  # the system's matrix times the direction


def conjugate_gradient_step(
    field: FloatImage,
    information: FloatImage,
    information_vector: FloatImage,
    weights: SmoothnessWeights,
    iterations: int,
) -> FloatImage:
    """Return the change of a field on one grid `(h, w)`, pixels, at most `MAX_STEP_PX`."""
    with on_one_thread(field.size < MIN_SHARED):
        preconditioner = inverse_diagonal(information, weights)
        state = SolverState(*(np.zeros(field.shape, F) for _ in SolverState._fields))
        _multiply(state.step, weights, preconditioner, F(1.0), state._replace(before=field))
        power, keep = _start(information_vector, preconditioner, state), 0.0
        for _ in range(iterations):
            state = state._replace(direction=state.before, before=state.direction)
            curvature = _multiply(information, weights, preconditioner, F(keep), state)
            if not curvature > 0.0:
                break
            new_power = _advance(state, preconditioner, F(power / curvature))
            keep, power = new_power / power, new_power
    return np.asarray(np.clip(state.step, -MAX_STEP_PX, MAX_STEP_PX), F)


@jit_rows_inline
def _ordered_sum(sums: FloatArray) -> float:
    total = 0.0
    for value in sums:
        total += value
    return total


@jit_rows_inline
def _fill_sums(a: FloatImage, b: FloatImage, sums: FloatArray) -> None:
    """Fill the sum of each row of `a b`, products and sums in float32."""
    rows, cols = a.shape
    for i in range(0, rows - SUMMED_ROWS + 1, SUMMED_ROWS):
        s0 = s1 = s2 = s3 = F(0.0)
        for j in range(cols):
            s0 += a[i, j] * b[i, j]
            s1 += a[i + 1, j] * b[i + 1, j]
            s2 += a[i + 2, j] * b[i + 2, j]
            s3 += a[i + 3, j] * b[i + 3, j]
        sums[i], sums[i + 1], sums[i + 2], sums[i + 3] = s0, s1, s2, s3
    for i in range(rows - rows % SUMMED_ROWS, rows):
        total = F(0.0)
        for j in range(cols):
            total += a[i, j] * b[i, j]
        sums[i] = total


@jit_rows
def _start(information_vector: FloatImage, preconditioner: FloatImage, state: SolverState) -> float:
    """Fill the residual of step 0, `product` being the gradient of the smoothness; return `r M r`.

    M is the preconditioner. The search direction becomes 0.
    """
    rows, cols = information_vector.shape
    residual, direction, product = state.residual, state.direction, state.product
    sums = np.zeros(rows)
    for i in prange(rows):
        total = F(0.0)
        for j in range(cols):
            rest = information_vector[i, j] - product[i, j]
            residual[i, j], direction[i, j] = rest, F(0.0)
            total += rest * (preconditioner[i, j] * rest)
        sums[i] = total
    return _ordered_sum(sums)


@jit_rows
def _multiply(
    information: FloatImage,
    weights: SmoothnessWeights,
    preconditioner: FloatImage,
    keep: np.float32,
    state: SolverState,
) -> float:
    """Fill the next conjugate direction and its product with the system's matrix; return direction times product."""
    rows, cols = information.shape
    residual, before, direction, product = state.residual, state.before, state.direction, state.product
    sums = np.zeros(rows)
    for block in prange((rows + BLOCK_ROWS - 1) // BLOCK_ROWS):
        first, last = BLOCK_ROWS * block, min(BLOCK_ROWS * (block + 1), rows)
        top, end = max(first - 2, 0), min(last + 2, rows)
        near = np.empty((end - top, cols), F)
        for i in range(top, end):
            out, factor, rest, old = near[i - top], preconditioner[i], residual[i], before[i]
            for j in range(cols):
                out[j] = factor[j] * rest[j] + keep * old[j]
        out_rows = product[first:last]
        fill_smoothness(near, top, weights, first, out_rows)
        for i in range(first, last):
            row, known, along, copy = product[i], information[i], near[i - top], direction[i]
            for j in range(cols):
                row[j] = known[j] * along[j] + row[j]
                copy[j] = along[j]
        _fill_sums(out_rows, near[first - top : last - top], sums[first:last])
    return _ordered_sum(sums)


@jit_rows
def _advance(state: SolverState, preconditioner: FloatImage, length: np.float32) -> float:
    """Go along the direction and return the new `r M r`."""
    rows, cols = preconditioner.shape
    step, residual, direction, product = state.step, state.residual, state.direction, state.product
    sums = np.zeros(rows)
    for block in prange((rows + BLOCK_ROWS - 1) // BLOCK_ROWS):
        first, last = BLOCK_ROWS * block, min(BLOCK_ROWS * (block + 1), rows)
        squares = np.empty((last - first, cols), F)
        for i in range(first, last):
            changed, along = step[i], direction[i]
            for j in range(cols):
                changed[j] += length * along[j]
            rest, by_matrix, square = residual[i], product[i], squares[i - first]
            for j in range(cols):
                rest[j] -= length * by_matrix[j]
                square[j] = rest[j] * rest[j]
        _fill_sums(squares, preconditioner[first:last], sums[first:last])
    return _ordered_sum(sums)

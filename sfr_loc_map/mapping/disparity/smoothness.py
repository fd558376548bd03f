"""The smoothness term of the refinement, and the linear solve of data term and smoothness term together.

The smoothness energy of a field d is `sum w_x (d_xx)^2 + w_y (d_yy)^2 + w_m (d_xy)^2`. With A the operator of the
second differences and W their weights, half its gradient is `A' W A d`. Differences that reach beyond the border have
the weight 0. The change s of the field solves `(H + A' W A) s = b - A' W A d`, with H the information of the data term
and b its information vector, by preconditioned conjugate gradients (Shewchuk 1994, section B3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline, on_one_thread

MAX_SOLVED_STEP_PX = F(1.0)
"""Largest change of a field in one solve, pixels: the linearisation holds within about a pixel."""
MIN_PARALLEL_CELLS = 100_000  #: Smaller grids are solved by one thread: to wake another one takes 0.1 ms.
MIN_DIAGONAL = F(1e-12)  #: Added to the diagonal, 1 / px^2: it must not be 0.
BLOCK_ROWS = 32  #: Rows that a thread takes at once, so that intermediate results stay in its cache.
SUMMED_ROWS = 4  #: Rows that are summed in one loop, each in its order: a single sum waits for its own result.


class SmoothnessWeights(NamedTuple):
    """Weights of the second differences, 1 / pixels^2, `(h, w)` float32 each."""

    along_x: FloatImage  #: Weights of the differences along rows.
    along_y: FloatImage  #: Weights of the differences along columns.
    mixed: FloatImage  #: Weights of the mixed differences of a cell with its right and its lower neighbours.


@jit_rows
def smoothness_weight(
    field: FloatImage, scale_x: FloatImage, scale_y: FloatImage, factor: np.float32
) -> SmoothnessWeights:
    """Return the Cauchy weights of the second differences q of a field.

    They are `1 / (scale^2 + q^2)` along rows and along columns, and `2 / (scale^2 + q^2)` of the mixed differences. At
    equal scales the energy is then that of `d_xx^2 + 2 d_xy^2 + d_yy^2`, which is the same in any direction.
    Scales `(h, w)` times the factor are the typical sizes of second differences along rows and along columns. The scale
    of the mixed differences is their geometric mean.
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
def _fill_differences(
    field: FloatImage,
    row: int,
    weights: SmoothnessWeights,
    i: int,
    along_x: FloatImage,
    along_y: FloatImage,
    mixed: FloatImage,
) -> None:
    """Fill the weighted second differences of row i of a grid, `(w + 2,)` each; their border is not written.

    The field `(n, w)` is a part of the grid's rows, in which row i has the index `row`.
    """
    cols = field.shape[1]
    above = field[max(row - 1, 0)]
    centre = field[row]
    below = field[min(row + 1, len(field) - 1)]
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
def fill_smoothness(field: FloatImage, top: int, weights: SmoothnessWeights, first: int, out: FloatImage) -> None:
    """Fill rows `(m, w)` of `A' W A field` from the grid's row `first` on.

    The field `(n, w)` begins at the row `top` of the grid. It has the rows to fill and, within the grid, two more rows
    on either side.
    """
    rows, cols = weights.mixed.shape
    size = (len(out) + 2, cols + 2)
    along_x = np.empty(size, F)
    along_y = np.empty(size, F)
    mixed = np.empty(size, F)
    for n in range(len(out) + 2):
        i = first - 1 + n
        for row in (along_x[n], along_y[n], mixed[n]):
            if 0 <= i < rows:  # the inside is filled below
                row[0] = F(0.0)
                row[1] = F(0.0)
                row[cols] = F(0.0)
                row[cols + 1] = F(0.0)
            else:
                for j in range(cols + 2):
                    row[j] = F(0.0)
        if 0 <= i < rows:
            _fill_differences(field, i - top, weights, i, along_x[n], along_y[n], mixed[n])
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
    """Return one over the diagonal of `diag(information) + A' W A` `(h, w)`."""
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
    """Return `A' W A field` `(h, w)`: half the gradient of the smoothness energy."""
    rows, cols = field.shape
    out = np.empty((rows, cols), F)
    for block in prange((rows + BLOCK_ROWS - 1) // BLOCK_ROWS):
        first = BLOCK_ROWS * block
        last = min(first + BLOCK_ROWS, rows)
        fill_smoothness(field, 0, weights, first, out[first:last])
    return out


class SolverState(NamedTuple):
    """Arrays of conjugate gradients, `(h, w)` float32 each; the kernels below update them in place.

    Between iterations `direction` and `previous_direction` change places, so that no array is copied.
    """

    step: FloatImage  #: Solution after the iterations so far.
    residual: FloatImage  #: Right-hand side minus the system's matrix times the step.
    direction: FloatImage  #: Search direction.
    previous_direction: FloatImage  #: Search direction of the previous iteration.
    product: FloatImage  #: The system's matrix times the direction.


def conjugate_gradient_step(
    field: FloatImage,
    information: FloatImage,
    information_vector: FloatImage,
    weights: SmoothnessWeights,
    iterations: int,
) -> FloatImage:
    """Return the change of a field on one grid `(h, w)`, pixels, at most `MAX_SOLVED_STEP_PX`.

    It is the solution of `(diag(information) + A' W A) s = information_vector - A' W A field` after a number of
    preconditioned conjugate gradient iterations, in the notation of Shewchuk (1994), section B3: direction d, residual
    r, preconditioner M, `delta = r' M r`, `alpha = delta / d' q` with q the matrix times d, and `beta` the ratio of
    successive deltas.
    """
    with on_one_thread(field.size < MIN_PARALLEL_CELLS):
        preconditioner = inverse_diagonal(information, weights)
        residual = information_vector - smoothness_gradient(field, weights)
        delta = _preconditioned_norm(residual, preconditioner)
        step, direction, previous_direction, product = (np.zeros(field.shape, F) for _ in range(4))
        state = SolverState(step, residual, direction, previous_direction, product)
        beta = 0.0
        for _ in range(iterations):
            state = state._replace(direction=state.previous_direction, previous_direction=state.direction)
            curvature = _update_direction(information, weights, preconditioner, F(beta), state)
            if not curvature > 0.0:
                break
            new_delta = _update_step(state, preconditioner, F(delta / curvature))
            beta = new_delta / delta
            delta = new_delta
    return np.asarray(np.clip(state.step, -MAX_SOLVED_STEP_PX, MAX_SOLVED_STEP_PX), F)


@jit_rows_inline
def _ordered_sum(sums: FloatArray) -> float:
    """Return the sum in the order of the rows, so that it does not depend on the number of threads."""
    total = 0.0
    for value in sums:
        total += value
    return total


@jit_rows_inline
def _fill_sums(a: FloatImage, b: FloatImage, sums: FloatArray) -> None:
    """Fill the sum of each row of `a b`, products and sums in float32."""
    rows, cols = a.shape
    for i in range(0, rows - SUMMED_ROWS + 1, SUMMED_ROWS):
        s0 = F(0.0)
        s1 = F(0.0)
        s2 = F(0.0)
        s3 = F(0.0)
        for j in range(cols):
            s0 += a[i, j] * b[i, j]
            s1 += a[i + 1, j] * b[i + 1, j]
            s2 += a[i + 2, j] * b[i + 2, j]
            s3 += a[i + 3, j] * b[i + 3, j]
        sums[i] = s0
        sums[i + 1] = s1
        sums[i + 2] = s2
        sums[i + 3] = s3
    for i in range(rows - rows % SUMMED_ROWS, rows):
        total = F(0.0)
        for j in range(cols):
            total += a[i, j] * b[i, j]
        sums[i] = total


@jit_rows
def _preconditioned_norm(residual: FloatImage, preconditioner: FloatImage) -> float:
    """Return `r' M r` with the residual r and the preconditioner M."""
    rows, cols = residual.shape
    sums = np.zeros(rows)
    for i in prange(rows):
        total = F(0.0)
        for j in range(cols):
            total += residual[i, j] * (preconditioner[i, j] * residual[i, j])
        sums[i] = total
    return _ordered_sum(sums)


@jit_rows
def _update_direction(
    information: FloatImage,
    weights: SmoothnessWeights,
    preconditioner: FloatImage,
    beta: np.float32,
    state: SolverState,
) -> float:
    """Fill the direction `d = M r + beta d_previous` and its product q with the system's matrix; return `d' q`.

    Both are filled block by block, so that the direction is in the cache when it is multiplied. The product of a block
    requires two more rows of the direction on either side, which both blocks compute.
    """
    rows, cols = information.shape
    residual = state.residual
    previous = state.previous_direction
    direction = state.direction
    product = state.product
    sums = np.zeros(rows)
    for block in prange((rows + BLOCK_ROWS - 1) // BLOCK_ROWS):
        first = BLOCK_ROWS * block
        last = min(BLOCK_ROWS * (block + 1), rows)
        top = max(first - 2, 0)
        end = min(last + 2, rows)
        extended = np.empty((end - top, cols), F)  # rows top to end of the direction
        for i in range(top, end):
            out = extended[i - top]
            factor = preconditioner[i]
            rest = residual[i]
            old = previous[i]
            for j in range(cols):
                out[j] = factor[j] * rest[j] + beta * old[j]
        out_rows = product[first:last]
        fill_smoothness(extended, top, weights, first, out_rows)
        for i in range(first, last):
            row = product[i]
            known = information[i]
            along = extended[i - top]
            copy = direction[i]
            for j in range(cols):
                row[j] = known[j] * along[j] + row[j]
                copy[j] = along[j]
        _fill_sums(out_rows, extended[first - top : last - top], sums[first:last])
    return _ordered_sum(sums)


@jit_rows
def _update_step(state: SolverState, preconditioner: FloatImage, alpha: np.float32) -> float:
    """Add `alpha` times the direction to the step, subtract `alpha` times q from the residual r, return `r' M r`."""
    rows, cols = preconditioner.shape
    step = state.step
    residual = state.residual
    direction = state.direction
    product = state.product
    sums = np.zeros(rows)
    for block in prange((rows + BLOCK_ROWS - 1) // BLOCK_ROWS):
        first = BLOCK_ROWS * block
        last = min(BLOCK_ROWS * (block + 1), rows)
        squares = np.empty((last - first, cols), F)
        for i in range(first, last):
            changed = step[i]
            along = direction[i]
            for j in range(cols):
                changed[j] += alpha * along[j]
            rest = residual[i]
            by_matrix = product[i]
            square = squares[i - first]
            for j in range(cols):
                rest[j] -= alpha * by_matrix[j]
                square[j] = rest[j] * rest[j]
        _fill_sums(squares, preconditioner[first:last], sums[first:last])
    return _ordered_sum(sums)

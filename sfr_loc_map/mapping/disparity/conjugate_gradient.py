"""One linear solve for the change of the disparity field, by preconditioned conjugate gradients.

The system is `(H + A' W A) s = b - A' W A d`: H the information of the data term, b its information vector, W the
smoothness weights, d the present field, s the step that is sought (Shewchuk 1994, section B3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline, on_one_thread
from sfr_loc_map.mapping.disparity.regularisation import SmoothnessWeights, fill_smoothness, inverse_diagonal

F = np.float32

MAX_STEP_PX = F(1.0)
"""No field changes by more than this in one solve: beyond it the linearisation does not hold."""


MIN_SHARED = 100_000
"""Cells from which on threads share a grid."""
BLOCK_ROWS = 32
"""Rows that a thread takes at once: what lies between their input and their output stays in its cache."""
SUMMED_ROWS = 4
"""Rows that are summed side by side, each in its order: one sum alone waits for itself."""


class SolverState(NamedTuple):
    """State of a solve, `(h, w)` float32 each.

    Attributes:
        step: The solution so far.
        residual: Right side minus the system's matrix times the step.
        direction: Search direction.
        before: The search direction before.
        product: The system's matrix times the direction.
    """

    step: FloatImage
    residual: FloatImage
    direction: FloatImage
    before: FloatImage
    product: FloatImage

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> SolverState:
        """Return that of a solve from step 0, its residual yet to be filled."""
        return cls(*(np.zeros(shape, F) for _ in cls._fields))


def conjugate_gradient_step(
    field: FloatImage,
    information: FloatImage,
    information_vector: FloatImage,
    weights: SmoothnessWeights,
    iterations: int,
) -> FloatImage:
    """Return the change of a field on one grid `(h, w)`, pixels, at most `MAX_STEP_PX`.

    Args:
        field: `(h, w)`, the present field.
        information: `(h, w)`, of each cell.
        information_vector: `(h, w)`, information times the change that the images alone ask for.
        weights: Of the second differences of the field.
        iterations: Conjugate gradient steps.
    """
    with on_one_thread(field.size < MIN_SHARED):
        preconditioner = inverse_diagonal(information, weights)
        state = SolverState.zeros(field.shape)
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

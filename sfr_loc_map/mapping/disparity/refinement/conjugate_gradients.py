"""The linear solve of the refinement: data term and smoothness term together, by conjugate gradients.

The change s of a field d solves `(H + A' W A) s = b - A' W A d`, with H the information of the data term, b its
information vector, and `A' W A` the operator of the smoothness (`smoothness`). The solver follows Shewchuk (1994),
section B3, with a diagonal preconditioner. Its arrays (`SolverState`) are written in place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline, on_one_thread
from sfr_loc_map.mapping.disparity.refinement.smoothness import (
    BLOCK_ROWS,
    SmoothnessWeights,
    inverse_diagonal,
    smoothness_gradient,
    write_smoothness,
)

MAX_SOLVED_STEP_PX = F(1.0)
"""Largest change of a field in one solve, pixels: the linearisation is valid within about one pixel."""
MIN_PARALLEL_CELLS = 100_000  #: Smaller grids are solved by one thread, because waking a thread takes 0.1 ms.
SUMMED_ROWS = 4  #: Number of rows that are summed in one loop, so that additions do not wait for each other.


class SolverState(NamedTuple):
    """Arrays of conjugate gradients, `(h, w)` float32 each; the kernels below write to them.

    Between iterations `direction` and `previous_direction` are swapped, so that no array is copied.
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

    The change s solves `(diag(information) + A' W A) s = information_vector - A' W A field` approximately, by at most
    `iterations` preconditioned conjugate gradient iterations. The notation is that of Shewchuk (1994), section B3:
    direction d, residual r, preconditioner M, `delta = r' M r`, `alpha = delta / d' q` with q the matrix times d, and
    `beta` the ratio of successive deltas. In numpy, with `A(d) = information * d + smoothness_gradient(d, weights)`:

        s = 0; r = b - A' W A field; d = 0; delta = sum(r * M * r); beta = 0
        repeat: d = M * r + beta * d; q = A(d); alpha = delta / sum(d * q); s += alpha * d; r -= alpha * q
                previous, delta = delta, sum(r * M * r); beta = delta / previous

    The kernels compute the same result in blocks of rows, in an order that does not depend on the number of threads.
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
            if delta <= 0.0 or curvature <= 0.0 or math.isnan(curvature):
                break
            new_delta = _update_step(state, preconditioner, F(delta / curvature))
            beta = new_delta / delta
            delta = new_delta
    return np.asarray(np.clip(state.step, -MAX_SOLVED_STEP_PX, MAX_SOLVED_STEP_PX), F)


@jit_rows_inline
def _ordered_sum(sums: FloatArray) -> float:
    """Return the sum in the order of the rows, so that the result does not depend on the number of threads."""
    total = 0.0
    for value in sums:
        total += value
    return total


@jit_rows_inline
def _write_sums(a: FloatImage, b: FloatImage, sums: FloatArray) -> None:
    """Write the sum of the products `a b` over each row, computed in float32."""
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
    """Write the direction `d = M r + beta d_previous` and its product q with the system's matrix; return `d' q`.

    Direction and product are written block by block, so that the direction is in the cache when it is multiplied. The
    product of a block requires two more rows of the direction on either side. Adjacent blocks both compute these rows.
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
        extended = np.empty((end - top, cols), F)  # rows `top` to `end` of the direction
        for i in range(top, end):
            out = extended[i - top]
            factor = preconditioner[i]
            rest = residual[i]
            old = previous[i]
            for j in range(cols):
                out[j] = factor[j] * rest[j] + beta * old[j]
        out_rows = product[first:last]
        write_smoothness(extended, top, weights, first, out_rows)
        for i in range(first, last):
            row = product[i]
            known = information[i]
            along = extended[i - top]
            copy = direction[i]
            for j in range(cols):
                row[j] = known[j] * along[j] + row[j]
                copy[j] = along[j]
        _write_sums(out_rows, extended[first - top : last - top], sums[first:last])
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
            squared = squares[i - first]
            for j in range(cols):
                rest[j] -= alpha * by_matrix[j]
                squared[j] = rest[j] * rest[j]
        _write_sums(squares, preconditioner[first:last], sums[first:last])
    return _ordered_sum(sums)

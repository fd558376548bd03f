"""The field of least misfit and bending: one linear system per round and grid, by conjugate gradients."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32


@jit_rows
def stiffness_of(
    field: FloatImage, scale_x: FloatImage, scale_y: FloatImage, factor: np.float32, out: FloatImage
) -> None:
    """Weigh the second differences of a field by how far they exceed their scale (Cauchy: `1 / (scale^2 + q^2)`).

    Args:
        field: `(h, w)`.
        scale_x: `(h, w)`, usual size of second differences along rows.
        scale_y: `(h, w)`, the same along columns; the mixed one takes the geometric mean.
        factor: Multiplies both scales.
        out: `(3, h, w)`, filled: weights of the differences along x, along y and of the mixed one.
    """
    rows, cols = field.shape
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
            out[0, i, j], out[1, i, j], out[2, i, j] = wx, wy, wm


@jit_rows
def bend(field: FloatImage, stiffness: FloatImage, out: FloatImage) -> None:
    """Fill the inside of `out` `(3, h + 2, w + 2)` with the weighted second differences of a field.

    Stiffness is 0 where a difference would reach beyond the border.
    """
    rows, cols = field.shape
    for i in prange(rows):
        above, below = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(1, cols - 1):
            centre = field[i, j]
            twice = F(2.0) * centre
            mixed = centre - field[below, j] - field[i, j + 1] + field[below, j + 1]
            out[0, i + 1, j + 1] = stiffness[0, i, j] * (field[i, j - 1] - twice + field[i, j + 1])
            out[1, i + 1, j + 1] = stiffness[1, i, j] * (field[above, j] - twice + field[below, j])
            out[2, i + 1, j + 1] = stiffness[2, i, j] * mixed
        for j in (0, cols - 1):
            beside = min(j + 1, cols - 1)
            mixed = field[i, j] - field[below, j] - field[i, beside] + field[below, beside]
            out[0, i + 1, j + 1] = F(0.0)
            out[1, i + 1, j + 1] = stiffness[1, i, j] * (field[above, j] - F(2.0) * field[i, j] + field[below, j])
            out[2, i + 1, j + 1] = stiffness[2, i, j] * mixed


@jit_rows_inline
def _unbend(q: FloatImage, i: int, j: int) -> np.float32:
    """Return the transpose of taking differences, at cell (i, j) of fluxes that have a border of 0."""
    y, x = i + 1, j + 1
    along_x = q[0, y, x - 1] - F(2.0) * q[0, y, x] + q[0, y, x + 1]
    along_y = q[1, y - 1, x] - F(2.0) * q[1, y, x] + q[1, y + 1, x]
    mixed = q[2, y, x] - q[2, y, x - 1] - q[2, y - 1, x] + q[2, y - 1, x - 1]
    total: np.float32 = along_x + along_y + mixed
    return total


@jit_rows_inline
def _added(sums: NDArray[np.float64]) -> float:
    total = 0.0
    for value in sums:
        total += value
    return total


@jit_rows
def start(gradient: FloatImage, bent: FloatImage, inverse_diagonal: FloatImage, state: FloatImage) -> float:
    """Fill `state` `(4, h, w)` (step, residual, direction, product) for a solve from step 0; return r M r."""
    rows, cols = gradient.shape
    sums = np.zeros(rows)
    for i in prange(rows):
        total = F(0.0)
        for j in range(cols):
            rest = gradient[i, j] - _unbend(bent, i, j)
            scaled = inverse_diagonal[i, j] * rest
            state[0, i, j], state[1, i, j], state[2, i, j] = F(0.0), rest, scaled
            total += rest * scaled
        sums[i] = total
    return _added(sums)


@jit_rows
def multiply(hessian: FloatImage, bent: FloatImage, state: FloatImage) -> float:
    """Fill the product of the system's matrix with the direction; return direction times product."""
    rows, cols = hessian.shape
    sums = np.zeros(rows)
    for i in prange(rows):
        total = F(0.0)
        for j in range(cols):
            value = hessian[i, j] * state[2, i, j] + _unbend(bent, i, j)
            state[3, i, j] = value
            total += value * state[2, i, j]
        sums[i] = total
    return _added(sums)


@jit_rows
def advance(state: FloatImage, inverse_diagonal: FloatImage, length: np.float32) -> float:
    """Go along the direction and return the new r M r."""
    rows, cols = inverse_diagonal.shape
    sums = np.zeros(rows)
    for i in prange(rows):
        total = F(0.0)
        for j in range(cols):
            state[0, i, j] += length * state[2, i, j]
            rest = state[1, i, j] - length * state[3, i, j]
            state[1, i, j] = rest
            total += rest * rest * inverse_diagonal[i, j]
        sums[i] = total
    return _added(sums)


@jit_rows
def turn(state: FloatImage, inverse_diagonal: FloatImage, keep: np.float32) -> None:
    """Take the next conjugate direction."""
    rows, cols = inverse_diagonal.shape
    for i in prange(rows):
        for j in range(cols):
            state[2, i, j] = inverse_diagonal[i, j] * state[1, i, j] + keep * state[2, i, j]


@jit_rows
def inverse_diagonal_of(hessian: FloatImage, stiffness: FloatImage) -> FloatImage:
    """Return one over the diagonal of the system's matrix `(h, w)`."""
    rows, cols = hessian.shape
    out = np.empty((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            value = hessian[i, j] + F(4.0) * (stiffness[0, i, j] + stiffness[1, i, j]) + stiffness[2, i, j]
            if j > 0:
                value += stiffness[0, i, j - 1] + stiffness[2, i, j - 1]
            if j < cols - 1:
                value += stiffness[0, i, j + 1]
            if i > 0:
                value += stiffness[1, i - 1, j] + stiffness[2, i - 1, j]
                if j > 0:
                    value += stiffness[2, i - 1, j - 1]
            if i < rows - 1:
                value += stiffness[1, i + 1, j]
            out[i, j] = F(1.0) / (value + F(1e-12))
    return out


MAX_STEP_PX = F(1.0)
"""No field changes by more than this in one solve: beyond it the linearisation says nothing."""


def solved_step(
    field: FloatImage, hessian: FloatImage, gradient: FloatImage, stiffness: FloatImage, iterations: int
) -> FloatImage:
    """Return the change of a field on one grid (preconditioned conjugate gradients, Shewchuk 1994, section B3).

    Args:
        field: `(h, w)`.
        hessian: `(h, w)`, information of each cell.
        gradient: `(h, w)`, information times the change that the pictures ask for.
        stiffness: `(3, h, w)`, as `stiffness_of` fills it.
        iterations: Steps.
    """
    inverse_diagonal = inverse_diagonal_of(hessian, stiffness)
    bent = np.zeros((3, field.shape[0] + 2, field.shape[1] + 2), F)
    state = np.empty((4, *field.shape), F)
    bend(field, stiffness, bent)
    power = start(gradient, bent, inverse_diagonal, state)
    for _ in range(iterations):
        bend(state[2], stiffness, bent)
        product = multiply(hessian, bent, state)
        if not product > 0.0:
            break
        new_power = advance(state, inverse_diagonal, F(power / product))
        turn(state, inverse_diagonal, F(new_power / power))
        power = new_power
    return np.asarray(np.clip(state[0], -MAX_STEP_PX, MAX_STEP_PX), F)

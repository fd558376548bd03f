"""One linear solve for the change of the disparity field, by preconditioned conjugate gradients.

The system is `(H + A' W A) s = b - A' W A d`: H the information of the data term, b its information vector, W the
smoothness weights, d the present field, s the step that is sought (Shewchuk 1994, section B3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.regularisation import (
    SecondDifferences,
    SmoothnessWeights,
    apply_adjoint,
    apply_operator,
    inverse_diagonal,
)

F = np.float32

MAX_STEP_PX = F(1.0)
"""No field changes by more than this in one solve: beyond it the linearisation does not hold."""


class SolverState(NamedTuple):
    """State of a solve, `(h, w)` float32 each.

    Attributes:
        step: The solution so far.
        residual: Right side minus the system's matrix times the step.
        direction: Search direction.
        product: The system's matrix times the direction.
    """

    step: FloatImage
    residual: FloatImage
    direction: FloatImage
    product: FloatImage

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> SolverState:
        """Return a state yet to be filled."""
        return cls(np.empty(shape, F), np.empty(shape, F), np.empty(shape, F), np.empty(shape, F))


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
    preconditioner = inverse_diagonal(information, weights)
    differences = SecondDifferences.zeros(field.shape)
    state = SolverState.empty(field.shape)
    apply_operator(field, weights, differences)
    power = _start(information_vector, differences, preconditioner, state)
    for _ in range(iterations):
        apply_operator(state.direction, weights, differences)
        curvature = _apply_system(information, differences, state)
        if not curvature > 0.0:
            break
        new_power = _advance(state, preconditioner, F(power / curvature))
        _update_direction(state, preconditioner, F(new_power / power))
        power = new_power
    return np.asarray(np.clip(state.step, -MAX_STEP_PX, MAX_STEP_PX), F)


@jit_rows_inline
def _ordered_sum(sums: FloatArray) -> float:
    total = 0.0
    for value in sums:
        total += value
    return total


@jit_rows
def _start(
    information_vector: FloatImage, differences: SecondDifferences, preconditioner: FloatImage, state: SolverState
) -> float:
    """Fill the state for a solve from step 0; return `r M r`, M the preconditioner."""
    rows, cols = information_vector.shape
    step, residual, direction = state.step, state.residual, state.direction
    sums = np.zeros(rows)
    for i in prange(rows):
        total = F(0.0)
        for j in range(cols):
            rest = information_vector[i, j] - apply_adjoint(differences, i, j)
            scaled = preconditioner[i, j] * rest
            step[i, j], residual[i, j], direction[i, j] = F(0.0), rest, scaled
            total += rest * scaled
        sums[i] = total
    return _ordered_sum(sums)


@jit_rows
def _apply_system(information: FloatImage, differences: SecondDifferences, state: SolverState) -> float:
    """Fill the product of the system's matrix with the direction; return direction times product."""
    rows, cols = information.shape
    direction, product = state.direction, state.product
    sums = np.zeros(rows)
    for i in prange(rows):
        for j in range(cols):
            product[i, j] = information[i, j] * direction[i, j] + apply_adjoint(differences, i, j)
        total = F(0.0)
        for j in range(cols):
            total += product[i, j] * direction[i, j]
        sums[i] = total
    return _ordered_sum(sums)


@jit_rows
def _advance(state: SolverState, preconditioner: FloatImage, length: np.float32) -> float:
    """Go along the direction and return the new `r M r`."""
    rows, cols = preconditioner.shape
    step, residual, direction, product = state.step, state.residual, state.direction, state.product
    sums = np.zeros(rows)
    for i in prange(rows):
        for j in range(cols):
            step[i, j] += length * direction[i, j]
            residual[i, j] -= length * product[i, j]
        total = F(0.0)
        for j in range(cols):
            total += residual[i, j] * residual[i, j] * preconditioner[i, j]
        sums[i] = total
    return _ordered_sum(sums)


@jit_rows
def _update_direction(state: SolverState, preconditioner: FloatImage, keep: np.float32) -> None:
    """Take the next conjugate direction."""
    rows, cols = preconditioner.shape
    residual, direction = state.residual, state.direction
    for i in prange(rows):
        for j in range(cols):
            direction[i, j] = preconditioner[i, j] * residual[i, j] + keep * direction[i, j]

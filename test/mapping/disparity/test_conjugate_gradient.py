"""Conjugate gradients against a dense solve."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.conjugate_gradient import MAX_STEP_PX, conjugate_gradient_step

F = np.float32
SHAPE = (7, 8)


@pytest.fixture
def system(weights_of: Any, regulariser: Any) -> tuple[Any, ...]:
    """A field, information, information vector, weights, and the dense matrix and right side of their system."""
    rng = np.random.default_rng(2)
    field = rng.normal(10.0, 0.1, SHAPE).astype(F)
    information = rng.uniform(0.5, 2.0, SHAPE).astype(F)
    vector = (information * rng.normal(0.0, 0.2, SHAPE)).astype(F)
    weights = weights_of(SHAPE, 7)
    smoothness = regulariser(weights)
    matrix = np.diag(information.ravel().astype(float)) + smoothness
    return field, information, vector, weights, matrix, vector.ravel() - smoothness @ field.ravel()


def test_enough_iterations_give_the_dense_solution(system: tuple[Any, ...]) -> None:
    *arguments, matrix, rhs = system
    expected = np.linalg.solve(matrix, rhs).reshape(SHAPE)
    assert np.abs(expected).max() < MAX_STEP_PX
    np.testing.assert_allclose(conjugate_gradient_step(*arguments, 80), expected, atol=2e-4)


def test_the_energy_decreases_with_every_iteration(system: tuple[Any, ...]) -> None:
    *arguments, matrix, rhs = system
    steps = [conjugate_gradient_step(*arguments, n).ravel().astype(float) for n in range(1, 8)]
    energies = [0.5 * s @ matrix @ s - rhs @ s for s in steps]
    assert energies[0] < 0.0
    assert all(later <= earlier + 1e-6 for earlier, later in pairwise(energies))


def test_the_first_iteration_is_the_steepest_preconditioned_descent(system: tuple[Any, ...]) -> None:
    *arguments, matrix, rhs = system
    direction = rhs / np.diag(matrix)
    expected = direction * (rhs @ direction) / (direction @ matrix @ direction)
    np.testing.assert_allclose(conjugate_gradient_step(*arguments, 1).ravel(), expected, atol=1e-4)


def test_a_plane_without_data_stays(weights_of: Any) -> None:
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    zero = np.zeros(SHAPE, F)
    field = (8.0 + 0.5 * u + 0.25 * v).astype(F)
    np.testing.assert_array_equal(conjugate_gradient_step(field, zero, zero, weights_of(SHAPE), 5), zero)


def test_steps_are_limited(weights_of: Any) -> None:
    one = np.ones(SHAPE, F)
    step = conjugate_gradient_step(5.0 * one, one, -3.0 * one, weights_of(SHAPE), 30)
    np.testing.assert_allclose(step, -MAX_STEP_PX)

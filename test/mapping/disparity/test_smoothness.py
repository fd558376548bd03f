"""The regulariser: symmetric, positive semidefinite, 0 on planes; its energy; the solve against a dense one."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.refinement.conjugate_gradients import MAX_SOLVED_STEP_PX, conjugate_gradient_step
from sfr_loc_map.mapping.disparity.refinement.smoothness import SmoothnessWeights, inverse_diagonal, write_smoothness

F = np.float32
SHAPES = [(6, 7), (9, 5)]
SHAPE = (7, 8)


def dense_regulariser(weights: SmoothnessWeights) -> np.ndarray:
    """Return `A' W A` `(h w, h w)`, column by column, its first four rows and the others filled for themselves."""
    shape = weights.along_x.shape
    columns = []
    for k in range(shape[0] * shape[1]):
        unit, product = np.zeros(shape, F), np.empty(shape, F)
        unit.flat[k] = 1.0
        write_smoothness(unit[:6], 0, weights, 0, product[:4])
        write_smoothness(unit[2:], 2, weights, 4, product[4:])
        columns.append(product.ravel())
    return np.stack(columns, axis=1).astype(np.float64)


def random_weights(shape: tuple[int, int], seed: int = 0) -> SmoothnessWeights:
    """Return weights from 0.5 to 2, 0 where a difference would reach beyond the border."""
    rng = np.random.default_rng(seed)
    along_x, along_y, mixed = (rng.uniform(0.5, 2.0, shape).astype(F) for _ in range(3))
    along_x[:, [0, -1]] = 0.0
    along_y[[0, -1]] = 0.0
    mixed[-1], mixed[:, -1] = 0.0, 0.0
    return SmoothnessWeights(along_x, along_y, mixed)


def energy(field: np.ndarray, weights: Any) -> float:
    """Return the weighted sum of squared second differences, in plain numpy."""
    x, y, m = (np.asarray(w, float) for w in weights)
    along_x, along_y = np.diff(field, 2, axis=1), np.diff(field, 2, axis=0)
    mixed = np.diff(np.diff(field, axis=0), axis=1)
    return float((x[:, 1:-1] * along_x**2).sum() + (y[1:-1] * along_y**2).sum() + (m[:-1, :-1] * mixed**2).sum())


@pytest.mark.parametrize("shape", SHAPES)
def test_the_regulariser_is_the_gradient_of_the_energy_and_costs_planes_nothing(shape: tuple[int, int]) -> None:
    weights, field = random_weights(shape, 4), np.random.default_rng(5).normal(0.0, 1.0, shape)
    matrix = dense_regulariser(weights)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-5)
    eigenvalues = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    assert eigenvalues[0] > -1e-5
    assert (eigenvalues < 1e-4).sum() == 3  # planes, nothing else
    assert field.ravel() @ matrix @ field.ravel() == pytest.approx(energy(field, weights), rel=1e-5)
    steps = 1e-3 * np.eye(field.size).reshape(-1, *shape)
    gradient = [(energy(field + step, weights) - energy(field - step, weights)) / 2e-3 for step in steps]
    np.testing.assert_allclose(2.0 * matrix @ field.ravel(), gradient, atol=1e-3)
    information = np.random.default_rng(3).uniform(0.0, 3.0, shape).astype(F)
    diagonal = np.diag(matrix).reshape(shape) + information
    np.testing.assert_allclose(inverse_diagonal(information, weights), 1.0 / diagonal, rtol=1e-5)


def test_the_solve_descends_to_the_dense_solution() -> None:
    rng = np.random.default_rng(2)
    field = rng.normal(10.0, 0.1, SHAPE).astype(F)
    information = rng.uniform(0.5, 2.0, SHAPE).astype(F)
    vector = (information * rng.normal(0.0, 0.2, SHAPE)).astype(F)
    weights = random_weights(SHAPE, 7)
    matrix = np.diag(information.ravel().astype(float)) + dense_regulariser(weights)
    rhs = vector.ravel() - dense_regulariser(weights) @ field.ravel()
    expected = np.linalg.solve(matrix, rhs).reshape(SHAPE)
    assert np.abs(expected).max() < MAX_SOLVED_STEP_PX

    def solved(iterations: int) -> np.ndarray:
        return conjugate_gradient_step(field, information, vector, weights, iterations)

    np.testing.assert_allclose(solved(80), expected, atol=2e-4)
    direction = rhs / np.diag(matrix)
    first = direction * (rhs @ direction) / (direction @ matrix @ direction)
    np.testing.assert_allclose(solved(1).ravel(), first, atol=1e-4)
    energies = [0.5 * s @ matrix @ s - rhs @ s for s in (solved(n).ravel().astype(float) for n in range(1, 8))]
    assert all(later <= earlier + 1e-6 for earlier, later in pairwise([0.0, *energies]))

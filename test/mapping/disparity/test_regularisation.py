"""The regulariser: symmetric, positive semidefinite, 0 on planes; its energy that of second differences."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.regularisation import fill_smoothness, inverse_diagonal, smoothness_weight

F = np.float32
SHAPES = [(6, 7), (9, 5)]


def test_rows_of_the_product_do_not_depend_on_what_else_is_filled(weights_of: Any) -> None:
    shape = (14, 9)
    field, weights = np.random.default_rng(1).normal(0.0, 1.0, shape).astype(F), weights_of(shape)
    whole = np.empty(shape, F)
    fill_smoothness(field, 0, weights, 0, whole)
    for first, last in ((0, 4), (4, 9), (9, 14)):
        top, out = max(first - 2, 0), np.empty((last - first, shape[1]), F)
        fill_smoothness(field[top : last + 2], top, weights, first, out)
        np.testing.assert_array_equal(out, whole[first:last])


@pytest.mark.parametrize("shape", SHAPES)
def test_the_regulariser_is_symmetric_and_positive_semidefinite(
    shape: tuple[int, int], weights_of: Any, regulariser: Any
) -> None:
    matrix = regulariser(weights_of(shape))
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-5)
    eigenvalues = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    assert eigenvalues[0] > -1e-5
    assert (eigenvalues < 1e-4).sum() == 3  # planes, nothing else


@pytest.mark.parametrize("shape", SHAPES)
def test_planes_cost_nothing(shape: tuple[int, int], weights_of: Any) -> None:
    v, u = np.mgrid[: shape[0], : shape[1]]
    product = np.empty(shape, F)
    fill_smoothness((5.0 + 0.25 * u - 0.5 * v).astype(F), 0, weights_of(shape), 0, product)
    np.testing.assert_allclose(product, 0.0, atol=1e-5)


def energy(field: np.ndarray, weights: Any) -> float:
    """Return the weighted sum of squared second differences, in plain numpy."""
    x, y, m = (np.asarray(w, float) for w in weights)
    along_x, along_y = np.diff(field, 2, axis=1), np.diff(field, 2, axis=0)
    mixed = np.diff(np.diff(field, axis=0), axis=1)
    return float((x[:, 1:-1] * along_x**2).sum() + (y[1:-1] * along_y**2).sum() + (m[:-1, :-1] * mixed**2).sum())


@pytest.mark.parametrize("shape", SHAPES)
def test_the_quadratic_form_is_the_energy_and_its_gradient_the_product(
    shape: tuple[int, int], weights_of: Any, regulariser: Any
) -> None:
    weights, field = weights_of(shape, 4), np.random.default_rng(5).normal(0.0, 1.0, shape)
    matrix = regulariser(weights)
    assert field.ravel() @ matrix @ field.ravel() == pytest.approx(energy(field, weights), rel=1e-5)
    gradient = np.empty(field.size)
    for k in range(field.size):
        step = np.zeros(field.size)
        step[k] = 1e-3
        high, low = (energy(field + s * step.reshape(shape), weights) for s in (1.0, -1.0))
        gradient[k] = (high - low) / 2e-3
    np.testing.assert_allclose(2.0 * matrix @ field.ravel(), gradient, atol=1e-3)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_inverse_diagonal(shape: tuple[int, int], weights_of: Any, regulariser: Any) -> None:
    weights = weights_of(shape, 2)
    information = np.random.default_rng(3).uniform(0.0, 3.0, shape).astype(F)
    diagonal = np.diag(regulariser(weights)).reshape(shape) + information
    np.testing.assert_allclose(inverse_diagonal(information, weights), 1.0 / diagonal, rtol=1e-5)


def test_weights_follow_the_scale_and_fade_at_edges() -> None:
    field = np.zeros((8, 10), F)
    field[:, 5:] = 3.0
    scale_x, scale_y = np.full_like(field, 0.2), np.full_like(field, 0.1)
    weights = smoothness_weight(field, scale_x, scale_y, F(2.0))
    np.testing.assert_allclose(weights.along_x[:, 1:4], 1.0 / 0.4**2, rtol=1e-5)
    np.testing.assert_allclose(weights.along_x[:, 4:6], 1.0 / (0.4**2 + 9.0), rtol=1e-5)
    np.testing.assert_allclose(weights.along_y[1:-1], 1.0 / 0.2**2, rtol=1e-5)
    np.testing.assert_allclose(weights.mixed[:-1, :-1], 2.0 / (0.4 * 0.2), rtol=1e-5)
    for border in (weights.along_x[:, [0, -1]], weights.along_y[[0, -1]], weights.mixed[-1], weights.mixed[:, -1]):
        np.testing.assert_array_equal(border, 0.0)

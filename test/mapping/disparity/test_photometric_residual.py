"""The data term: exact interpolation, the gradient of the residual's square, the robust weights."""

from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.photometric_residual import (
    cell_means,
    mean_template,
    normal_equations,
    photometric_residual,
    shift_rows,
    slopes,
)

F = np.float32
ROWS, COLS = 24, 40
V, U = np.mgrid[:ROWS, :COLS].astype(np.float64)
INNER = np.s_[2:-2, 6:-3]
"""Cells far from the border."""


def smooth(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return grey levels of long waves."""
    return 120.0 + 40.0 * np.sin(u / 6.0 + 0.3 * np.sin(v / 9.0)) + 20.0 * np.cos(u / 9.0 - v / 8.0)


def quadratic(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return 50.0 + 2.0 * u + 0.05 * u * u - 0.7 * v + 0.04 * v * v


@pytest.mark.parametrize("disparity", [0.0, 3.0, 2.25, 4.7])
def test_warping_is_exact_for_quadratics(disparity: float) -> None:
    zero = np.zeros((ROWS, COLS), F)
    warped = photometric_residual(zero, quadratic(U, V).astype(F), np.full((ROWS, COLS), disparity, F))
    inside = np.s_[:, 6:-3]
    np.testing.assert_allclose(warped[inside], quadratic(U - disparity, V)[inside], rtol=1e-5)


@pytest.mark.parametrize("shift", [0.0, 2.0, -1.3, 0.45])
def test_shifting_rows_is_exact_for_quadratics(shift: float) -> None:
    shifted = shift_rows(quadratic(U, V).astype(F), np.full((ROWS, COLS), shift, F))
    np.testing.assert_allclose(shifted[4:-4], quadratic(U, V + shift)[4:-4], rtol=1e-5)


def test_the_residual_is_right_minus_left_and_nan_outside() -> None:
    left, right = smooth(U, V).astype(F), (smooth(U, V) + 5.0).astype(F)
    residual = photometric_residual(left, right, np.zeros((ROWS, COLS), F))
    np.testing.assert_allclose(residual, 5.0, atol=1e-4)
    outside = photometric_residual(left, right, np.full((ROWS, COLS), 3.5, F))
    assert np.isnan(outside[:, :4]).all()
    assert np.isfinite(outside[:, 4:]).all()


def energy(left: np.ndarray, right: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    """Return half the sum of squared residuals of each cell."""
    residual = photometric_residual(left, right, disparity.astype(F)).astype(np.float64)
    return 0.5 * np.square(residual).reshape(ROWS // 2, 2, COLS // 2, 2).sum(axis=(1, 3))


def test_the_information_vector_is_minus_the_gradient_of_the_energy() -> None:
    """Against central differences; the slope's smoothing by half a pixel leaves 2 % of such waves."""
    disparity = 3.0 + 0.02 * U + 0.4 * np.sin(V / 5.0)
    left, right = smooth(U, V).astype(F), smooth(U + 3.3 + 0.02 * U, V).astype(F)
    residual = photometric_residual(left, right, disparity.astype(F))
    zero = np.zeros((ROWS // 2, COLS // 2), F)
    equations = normal_equations(slopes(left + residual), residual, zero, zero + F(1.0), F(0.0))
    h = 1e-2
    gradient = (energy(left, right, disparity + h) - energy(left, right, disparity - h)) / (2.0 * h)
    size = np.abs(gradient[INNER]).max()
    np.testing.assert_allclose(equations.information_vector[INNER], -gradient[INNER], atol=0.03 * size)
    curvature = energy(left, right, disparity + h) + energy(left, right, disparity - h)
    curvature = (curvature - 2.0 * energy(left, right, disparity)) / h**2
    assert np.median(equations.information[INNER] / curvature[INNER]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("error", [-0.3, 0.2])
def test_one_solve_recovers_an_error_of_the_disparity(error: float) -> None:
    left, right = smooth(U, V).astype(F), smooth(U + 4.0, V).astype(F)
    residual = photometric_residual(left, right, np.full((ROWS, COLS), 4.0 + error, F))
    zero = np.zeros((ROWS // 2, COLS // 2), F)
    template = mean_template(left, residual, zero, F(1e3))
    equations = normal_equations(slopes(template), residual, zero, zero + F(1.0), F(0.0))
    step = equations.information_vector[INNER].sum() / equations.information[INNER].sum()
    assert step == pytest.approx(-error, rel=0.03)


def test_residuals_beyond_the_tail_lose_weight() -> None:
    template = np.tile(2.0 * np.arange(COLS, dtype=F), (ROWS, 1))
    residual = np.full((ROWS, COLS), 6.0, F)
    residual[:, 10] = np.nan
    cells = np.zeros((ROWS // 2, COLS // 2), F)
    tail, variance, offset = 1.0 / 25.0, 4.0, 1.0
    found = normal_equations(slopes(template), residual, cells + F(offset), cells + F(1.0 / variance), F(tail))
    level = (6.0 - offset) ** 2 / variance
    weight = 1.0 / (1.0 + tail * level)
    for j, count in ((7, 4), (5, 2), (0, 0)):  # all four pixels, two of them NaN, no slope at the border
        np.testing.assert_allclose(found.weight[:, j], count * weight, rtol=1e-5)
        np.testing.assert_allclose(found.chi2[:, j], count * weight * level, rtol=1e-5)
        np.testing.assert_allclose(found.information[:, j], count * weight * 4.0 / variance, rtol=1e-4)
        np.testing.assert_allclose(found.information_vector[:, j], count * weight * 2.0 * 5.0 / variance, rtol=1e-4)


def test_cell_means_are_clipped_and_skip_nan() -> None:
    residual = np.array([[1.0, np.nan, -9.0, 1.0], [3.0, 2.0, 9.0, 3.0], [np.nan] * 4, [np.nan] * 4], F)
    np.testing.assert_allclose(cell_means(residual, F(5.0)), [[2.0, 1.0], [0.0, 0.0]])


def test_the_template_is_the_mean_of_both_images(textured: Callable[..., np.ndarray]) -> None:
    left = textured(U, V, 3).astype(F)
    residual = np.full_like(left, 4.0)
    residual[0, 0], residual[0, 1] = np.nan, 50.0
    offset = np.full((ROWS // 2, COLS // 2), 1.0, F)
    template = mean_template(left, residual, offset, F(10.0))
    np.testing.assert_allclose((template - left)[1:], 1.5, atol=1e-4)
    np.testing.assert_array_equal(template[0, :2], left[0, :2])

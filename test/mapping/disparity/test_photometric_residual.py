"""The data term: the gradient of the residual's square, the noise."""

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual
from sfr_loc_map.mapping.disparity.refinement.data_term import normal_equations, slopes

F = np.float32
ROWS, COLS = 24, 40
V, U = np.mgrid[:ROWS, :COLS].astype(np.float64)
INNER = np.s_[2:-2, 6:-3]
"""Cells far from the border."""


def smooth(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return grey levels of long waves."""
    return 120.0 + 40.0 * np.sin(u / 6.0 + 0.3 * np.sin(v / 9.0)) + 20.0 * np.cos(u / 9.0 - v / 8.0)


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
    twice = energy(left, right, disparity + h) + energy(left, right, disparity - h)
    curvature = (twice - 2.0 * energy(left, right, disparity)) / h**2
    assert np.median(equations.information[INNER] / curvature[INNER]) == pytest.approx(1.0, abs=0.1)

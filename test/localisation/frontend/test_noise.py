"""Variance of tracked positions: how it depends on the residuals and on the focal length."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.localisation.frontend.noise import EDGE_FOCAL_PX, PIXEL_FLOOR, position_variance

SMALL, LARGE = EDGE_FOCAL_PX
RESIDUAL = np.array([0.5, 1.0, 1.0, 2.0, 8.0])


def added(fx: float) -> np.ndarray:
    """Return the added standard deviations, px, of tracks without image noise."""
    return np.asarray(np.sqrt(position_variance(np.zeros((5, 3)), RESIDUAL, fx)[:, 0]))


def test_edges_add_an_error_by_their_residual_at_long_focal_lengths_alone() -> None:
    np.testing.assert_allclose(added(SMALL), PIXEL_FLOOR)
    np.testing.assert_allclose(added(2.0 * LARGE), PIXEL_FLOOR * np.array([0.25, 1.0, 1.0, 4.0, 16.0]))


@pytest.mark.parametrize("fx", [SMALL, 0.5 * (SMALL + LARGE), LARGE])
def test_a_calibration_that_differs_in_its_last_digits_has_the_same_noise(fx: float) -> None:
    np.testing.assert_allclose(added(fx - 1e-3), added(fx + 1e-3), rtol=1e-4)

"""Filters and robust statistics against plain numpy."""

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.filters import MIN_DISPARITY_PX, depth_ratio, local_variance, mad_sigma


@pytest.mark.parametrize("sigma", [0.1, 3.0])
def test_mad_sigma_is_that_of_a_normal_law_even_with_outliers(sigma: float) -> None:
    values = np.random.default_rng(0).normal(0.0, sigma, 20_000)
    assert mad_sigma(values) == pytest.approx(sigma, rel=0.03)
    values[:200] = 1e6
    assert mad_sigma(values) == pytest.approx(sigma, rel=0.05)


def test_local_variance() -> None:
    grey = np.random.default_rng(0).integers(0, 256, (40, 25)).astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(grey, 3, mode="reflect"), (7, 7))
    np.testing.assert_allclose(local_variance(grey), windows.var(axis=(2, 3)), rtol=1e-4)


def test_depths_are_compared_with_the_nearest_surface_around() -> None:
    disparity = np.full((9, 11), 2.0, np.float32)
    disparity[4, 5], disparity[0, 0] = 8.0, -1.0
    ratio = depth_ratio(disparity, 2)
    assert ratio[4, 5] == 1.0
    assert ratio[2, 3] == ratio[6, 7] == 4.0
    assert ratio[4, 8] == 1.0
    assert ratio[0, 0] == pytest.approx(2.0 / MIN_DISPARITY_PX)

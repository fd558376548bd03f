"""Robust standard deviation."""

import numpy as np
import pytest

from sfr_loc_map.mapping.robust import mad_sigma


@pytest.mark.parametrize("sigma", [0.1, 3.0])
def test_mad_sigma_is_that_of_a_normal_law_even_with_outliers(sigma: float) -> None:
    values = np.random.default_rng(0).normal(0.0, sigma, 20_000)
    assert mad_sigma(values) == pytest.approx(sigma, rel=0.03)
    values[:200] = 1e6
    assert mad_sigma(values) == pytest.approx(sigma, rel=0.05)

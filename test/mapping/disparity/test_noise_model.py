"""The noise model recovers a camera's constant and photon noise."""

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.noise_model import (
    DEFAULT_VARIANCE,
    MIN_NOISE,
    grey_levels,
    noise_variance,
    overall_noise,
)

F = np.float32
SHAPE = (256, 512)


def ramp() -> np.ndarray:
    return np.tile(np.linspace(20.0, 220.0, SHAPE[1], dtype=F), (SHAPE[0], 1))


@pytest.mark.parametrize(("constant", "photon"), [(4.0, 0.0), (1.0, 0.05), (9.0, 0.02)])
def test_variance_is_a_line_over_the_grey_level(constant: float, photon: float) -> None:
    left = ramp()
    variance = constant + photon * left
    residual = (3.0 + np.random.default_rng(0).normal(0.0, np.sqrt(variance))).astype(F)
    offset = np.full((SHAPE[0] // 2, SHAPE[1] // 2), 3.0, F)
    found = noise_variance(grey_levels(left), residual, offset)
    np.testing.assert_allclose(found[:, 20:-20], variance[::2, ::2][:, 20:-20], rtol=0.2)


def test_too_few_residuals_give_the_default() -> None:
    residual = np.full(SHAPE, np.nan, F)
    offset = np.zeros((SHAPE[0] // 2, SHAPE[1] // 2), F)
    assert (noise_variance(grey_levels(ramp()), residual, offset) == DEFAULT_VARIANCE).all()
    assert overall_noise(residual) == MIN_NOISE


def test_overall_noise_ignores_offset_holes_and_outliers() -> None:
    residual = np.random.default_rng(1).normal(7.0, 2.0, SHAPE).astype(F)
    residual[:, ::3] = np.nan
    residual[:8] = 200.0
    assert overall_noise(residual) == pytest.approx(2.0, rel=0.1)
    assert overall_noise(np.zeros(SHAPE, F)) == MIN_NOISE

"""Refinement: from a disturbed start to the true field, unbiased."""

from typing import Any

import numpy as np
import pytest
from disparity_world import hills, make_world

from sfr_loc_map.mapping.disparity.variational_refinement import refine

F = np.float32
INNER = np.s_[16:-16, 48:-16]


@pytest.fixture(scope="module")
def scene() -> Any:
    return make_world(hills, noise=1.0, seed=4)


@pytest.mark.parametrize("bias", [-0.4, 0.0, 0.4])
def test_a_disturbed_start_ends_at_the_truth(scene: Any, bias: float) -> None:
    left, right = scene.pair.left.astype(F), scene.pair.right.astype(F)
    noise = np.random.default_rng(0).normal(bias, 0.2, left.shape)
    start = (scene.disparity + noise).astype(F)
    start[100:110, 150:170] = np.nan
    refined = refine(left, right, start)
    assert np.abs(refined.disparity_px - scene.disparity)[100:110, 150:170].max() < 0.5
    error = (refined.disparity_px - scene.disparity)[INNER]
    assert abs(error.mean()) < 0.01
    assert error.std() < 0.06
    assert refined.noise == pytest.approx(np.sqrt(2.0), rel=0.2)
    assert np.nanstd(refined.normalised_residual[INNER]) == pytest.approx(1.0, abs=0.25)

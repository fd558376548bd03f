"""Refinement: from a disturbed start to the true field, unbiased; the grid of cells keeps planes and edges."""

from typing import Any

import numpy as np
import pytest
from disparity_world import hills, make_world

from sfr_loc_map.mapping.disparity.variational_refinement import (
    cells_from_pixels,
    edge_preserving_mean,
    pixels_from_cells,
    refine,
)

F = np.float32
JUMP = F(1.0)
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


def plane(rows: int, cols: int, slope_u: float, slope_v: float, scale: float = 1.0, offset: float = 0.0) -> np.ndarray:
    """Return `20 + slope_u u + slope_v v` at `u = scale j + offset`, v likewise."""
    v, u = np.mgrid[:rows, :cols] * scale + offset
    return (20.0 + slope_u * u + slope_v * v).astype(F)


@pytest.mark.parametrize(("slope_u", "slope_v"), [(0.3, 0.0), (0.0, -0.3), (0.11, 0.17)])
def test_planes_are_kept(slope_u: float, slope_v: float) -> None:
    pixels, cells = plane(16, 20, slope_u, slope_v), plane(8, 10, slope_u, slope_v, 2.0, 0.5)
    np.testing.assert_allclose(cells_from_pixels(pixels, JUMP), cells, atol=1e-5)
    np.testing.assert_allclose(pixels_from_cells(cells, JUMP)[1:-1, 1:-1], pixels[1:-1, 1:-1], atol=1e-5)
    np.testing.assert_allclose(edge_preserving_mean(pixels, 2, F(5.0))[2:-2, 2:-2], pixels[2:-2, 2:-2], atol=1e-5)

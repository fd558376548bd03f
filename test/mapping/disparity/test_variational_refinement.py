"""Refinement: from a disturbed start to the true field, unbiased; the parts of one iteration."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.noise_model import grey_levels
from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual
from sfr_loc_map.mapping.disparity.variational_refinement import (
    PAD,
    coarse_to_fine_step,
    initial_cells,
    linearise,
    padded,
    refine,
    roughness,
)

F = np.float32
INNER = np.s_[16:-16, 48:-16]


@pytest.fixture(scope="module")
def scene(world: Any, hills_field: Any) -> Any:
    return world(hills_field, noise=1.0, seed=4)


def images(made: Any) -> tuple[np.ndarray, np.ndarray]:
    return made.pair.left.astype(F), made.pair.right.astype(F)


@pytest.mark.parametrize("bias", [-0.4, 0.0, 0.4])
def test_a_disturbed_start_ends_at_the_truth(scene: Any, bias: float) -> None:
    left, right = images(scene)
    noise = np.random.default_rng(0).normal(bias, 0.2, left.shape)
    refined = refine(left, right, (scene.disparity + noise).astype(F))
    error = (refined.disparity_px - scene.disparity)[INNER]
    assert abs(error.mean()) < 0.01
    assert error.std() < 0.06
    assert refined.noise == pytest.approx(np.sqrt(2.0), rel=0.2)
    assert np.nanstd(refined.normalised_residual[INNER]) == pytest.approx(1.0, abs=0.25)


def test_refinement_lowers_the_photometric_error(scene: Any) -> None:
    left, right = images(scene)
    start = (scene.disparity + 0.3 * np.sin(np.arange(left.shape[1]) / 9.0)).astype(F)
    refined = refine(left, right, start)
    before, after = (np.nanstd(photometric_residual(left, right, d)[INNER]) for d in (start, refined.disparity_px))
    assert after < 0.5 * before


def test_holes_are_filled(scene: Any) -> None:
    left, right = images(scene)
    start = scene.disparity.astype(F)
    start[100:110, 150:170] = np.nan
    refined = refine(left, right, start)
    assert np.isfinite(refined.disparity_px).all()
    assert np.abs(refined.disparity_px - scene.disparity)[100:110, 150:170].max() < 0.5


def test_padding_repeats_the_border() -> None:
    image = np.arange(35.0, dtype=F).reshape(5, 7)
    out = padded(image)
    assert out.shape == (PAD, PAD)
    np.testing.assert_array_equal(out[:5, :7], image)
    np.testing.assert_array_equal(out[5:, :7], np.tile(image[-1], (3, 1)))
    np.testing.assert_array_equal(out[:, 7], out[:, 6])


def test_the_start_is_smooth_and_without_holes() -> None:
    steps = np.floor(np.linspace(10.0, 14.0, 64) * 16.0)[None].repeat(64, axis=0) / 16.0
    steps[20:24, 30:34] = np.nan
    cells = initial_cells(steps.astype(F))
    assert np.isfinite(cells).all()
    expected = np.linspace(10.0, 14.0, 64).reshape(32, 2).mean(axis=1) - 1.0 / 32.0
    np.testing.assert_allclose(cells[:8, 6:-6], np.tile(expected[6:-6], (8, 1)), atol=0.03)


def test_the_variance_is_raised_where_residuals_exceed_it(scene: Any) -> None:
    """A region whose images differ by more than noise has less information."""
    left, right = images(scene)
    cells = initial_cells(scene.disparity.astype(F))
    plain = linearise(left, right, grey_levels(left), cells)
    worse = right.copy()
    worse[100:160] += np.random.default_rng(1).normal(0.0, 8.0, worse[100:160].shape).astype(F)
    disturbed = linearise(left, worse, grey_levels(left), cells)
    after, before = (item.equations.information[:, 40:120] for item in (disturbed, plain))
    assert np.median(after[60:70] / before[60:70]) < 0.3
    assert np.median(after[10:40] / before[10:40]) > 0.6


def test_the_step_points_to_the_truth(scene: Any) -> None:
    left, right = images(scene)
    truth = initial_cells(scene.disparity.astype(F))
    for error in (-0.3, 0.3):
        equations = linearise(left, right, grey_levels(left), truth + F(error)).equations
        cells, weights = coarse_to_fine_step(truth + F(error), equations.information, equations.information_vector)
        assert abs(np.median((cells - truth)[16:-16, 30:-16])) < 0.1
        assert weights.along_x.shape == truth.shape


def test_roughness_is_that_of_the_second_differences() -> None:
    v, u = np.mgrid[:64, :64]
    rng = np.random.default_rng(3)
    plane = (10.0 + 0.1 * u + 0.05 * v).astype(F)
    rough = plane + np.cumsum(np.cumsum(rng.normal(0.0, 0.02, (64, 64)), axis=1), axis=1).astype(F)
    (plane_x, plane_y), (rough_x, _) = roughness(plane), roughness(rough)
    assert plane_x.shape == plane.shape
    assert plane_x[20:-20, 20:-20].max() < 0.01
    assert plane_y[20:-20, 20:-20].max() < 0.01
    assert np.median(rough_x) > 20.0 * np.median(plane_x)

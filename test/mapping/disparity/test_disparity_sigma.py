"""Sigma against theory and against Monte Carlo; saturated pixels are holes, and sigma is wider beside them."""

import numpy as np
import pytest

from helpers.disparity_world import make_world, slope
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.refinement.conjugate_gradients import conjugate_gradient_step
from sfr_loc_map.mapping.disparity.refinement.disparity_sigma import NOISE_INFORMATION, disparity_sigma
from sfr_loc_map.mapping.disparity.refinement.smoothness import SmoothnessWeights
from sfr_loc_map.mapping.mapper import Mapper

F = np.float32
INNER = np.s_[24:-24, 48:-24]


def uniform(shape: tuple[int, int], weight: float) -> SmoothnessWeights:
    """Return equal weights, 0 at the border, so that the regulariser is `weight (d_xx + d_yy)^2`."""
    along_x, along_y, mixed = (np.full(shape, w, F) for w in (weight, weight, 2.0 * weight))
    along_x[:, [0, -1]], along_y[[0, -1]] = 0.0, 0.0
    mixed[-1], mixed[:, -1] = 0.0, 0.0
    return SmoothnessWeights(along_x, along_y, mixed)


@pytest.mark.parametrize(("information", "weight"), [(4.0, 400.0), (9.0, 9000.0)])
def test_the_posterior_variance_of_a_smoothed_field_is_the_closed_form(information: float, weight: float) -> None:
    """The diagonal of the inverse of the system, information h and weight s everywhere, is 1 / (8 sqrt(h s))."""
    shape = (121, 121)
    zero, impulse = np.zeros(shape, F), np.zeros(shape, F)
    impulse[60, 60] = 1.0
    solved = conjugate_gradient_step(zero, zero + F(information), impulse, uniform(shape, weight), 400)
    assert solved[60, 60] == pytest.approx(0.125 / np.sqrt(information * weight), rel=0.05)


def sigma_of(cells: np.ndarray, information: float, weight_x: float, weight_y: float) -> np.ndarray:
    """Return the sigma of a field `(h, w)` with the same information and the same weights in all cells."""
    rows, cols = cells.shape
    along_x, along_y = (np.full(cells.shape, weight, F) for weight in (weight_x, weight_y))
    weights = SmoothnessWeights(along_x, along_y, along_x)
    information_of_cells = np.full(cells.shape, information, F)
    return disparity_sigma(cells.astype(F), information_of_cells, weights, (2 * rows, 2 * cols))


ROW, COLUMN = np.mgrid[:40, :40].astype(float)


@pytest.mark.parametrize(("information", "weight_x", "weight_y"), [(4.0, 400.0, 400.0), (0.5, 100.0, 1600.0)])
def test_sigma_of_a_plane_is_that_of_noise(information: float, weight_x: float, weight_y: float) -> None:
    """1 / (8 sqrt(h s)) with the geometric mean s of both weights and h without the information of noise."""
    sigma = sigma_of(10.0 + 0.2 * COLUMN - 0.1 * ROW, information, weight_x, weight_y)
    variance = 1.0 / (8.0 * np.sqrt((information - NOISE_INFORMATION) * np.sqrt(weight_x * weight_y)))
    np.testing.assert_allclose(sigma[20:-20, 20:-20], np.sqrt(variance), rtol=1e-3)


@pytest.mark.parametrize("second_difference_px", [0.01, 0.03])
def test_smoothing_adds_a_bias_proportional_to_the_curvature(second_difference_px: float) -> None:
    """0.34 times the second difference times the squared smoothing radius, sqrt(s / h)."""
    sigma = sigma_of(0.5 * second_difference_px * COLUMN**2, 4.0, 400.0, 400.0)
    plane = sigma_of(COLUMN, 4.0, 400.0, 400.0)
    bias = 0.34 * second_difference_px * np.sqrt(400.0 / (4.0 - NOISE_INFORMATION))
    inner = np.s_[24:-24, 24:-24]
    np.testing.assert_allclose(np.square(sigma)[inner] - np.square(plane)[inner], bias**2, rtol=0.02)


@pytest.mark.parametrize(("slope", "crease_px"), [(0.15, 0.1), (0.3, 0.2), (3.0, 1.0)])
def test_a_crease_adds_its_second_difference_up_to_a_limit(slope: float, crease_px: float) -> None:
    """The second difference 2 slope of one column is averaged over three columns, and is limited to 1 px."""
    sigma = sigma_of(slope * np.abs(COLUMN - 20.0), 4.0, 400.0, 400.0)
    beside = np.square(sigma[30, 60])
    assert np.square(sigma[30, 40]) - beside == pytest.approx((1.2 * crease_px) ** 2, rel=1e-3)
    assert sigma[30, 50] == pytest.approx(sigma[30, 60])


def test_sigma_without_information_has_its_upper_bound() -> None:
    assert (sigma_of(COLUMN, 0.0, 1e-3, 1e-3) == 2.0).all()


def test_a_clipped_patch_is_a_hole_and_uncertain_around_it() -> None:
    made = make_world(slope, width=384, height=320)
    left, right = made.pair.left.copy(), made.pair.right.copy()
    v, u = np.mgrid[:320, :384]
    partner = np.rint(u - made.disparity).astype(int)
    patch = (abs(v - 160) < 8) & (abs(u - 200) < 8)  # small enough to be bridged by smoothness
    left[patch] = 255
    right[v[patch], partner[patch]] = 255
    plain = Mapper(made.rig, MappingConfig()).process(made.pair, Transform.identity(), 0)
    result = Mapper(made.rig, MappingConfig()).process(StereoPair(0, left, right), Transform.identity(), 0)
    inner = (abs(v - 160) < 5) & (abs(u - 200) < 5)
    assert np.isfinite(plain.disparity_px[inner]).all()
    assert np.isnan(result.disparity_px[inner]).all()
    around = (abs(v - 160) < 11) & (abs(u - 200) < 11) & ~patch

    medians = [np.median(each.random_sigma[around[each.cloud.v, each.cloud.u]]) for each in (plain, result)]
    assert medians[1] > 1.2 * medians[0]

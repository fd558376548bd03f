"""Sigma against theory and against Monte Carlo; saturated pixels are holes, and sigma is wider beside them."""

import numpy as np
import pytest

from helpers.disparity_world import make_world, slope
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.conjugate_gradients import conjugate_gradient_step
from sfr_loc_map.mapping.disparity.smoothness import SmoothnessWeights
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

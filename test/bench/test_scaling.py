"""Half-size images fit their half-size rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from made_scene import NAV_RIG, nav_pair

from sfr_loc_map.bench.scaling import half_disparity, half_pair, half_rig


def test_half_pixels_see_the_middle_of_four_rays() -> None:
    rig, half = NAV_RIG, half_rig(NAV_RIG)
    assert (half.width, half.height) == (80, 60)
    for u in (0, 7, 79):
        full = np.mean([(2 * u - rig.cx) / rig.fx, (2 * u + 1 - rig.cx) / rig.fx])
        assert np.isclose((u - half.cx) / half.fx, full, atol=1e-12)


def test_images_are_means_and_odd_edges_go() -> None:
    pair = nav_pair(0).pair
    half = half_pair(pair)
    assert half.left[3, 4] == np.rint(pair.left[6:8, 8:10].mean())
    odd = replace(pair, left=pair.left[:-1, :-1].copy(), right=pair.right[:-1, :-1].copy())
    assert half_pair(odd).left.shape == (59, 79)
    np.testing.assert_array_equal(half_pair(odd).left, half.left[:59, :79])


def test_disparity_is_halved_and_has_no_truth_on_edges() -> None:
    disparity = np.array(
        [[10.0, 10.2, 4.0, 9.0], [10.4, 10.6, 4.0, 4.0], [8.0, np.nan, 6.0, 6.0], [8.0, 8.0, 6.0, 6.0]]
    )
    np.testing.assert_allclose(half_disparity(disparity), [[5.15, np.nan], [np.nan, 3.0]])

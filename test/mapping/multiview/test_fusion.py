"""Fusion: the inverse-variance mean of planes, independent of order; agreement, conflict, duplicates."""

from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.multiview.fusion import COMMON_SHARE, FusionAccumulator, fuse_views
from sfr_loc_map.mapping.multiview.view import View
from sfr_loc_map.mapping.multiview.view_reprojection import ReprojectedPoints
from sfr_loc_map.mapping.reprojection import cloud_from_disparity

RIG = StereoRig(160, 140, 100.0, 100.0, 79.5, 69.5, 0.2)
INNER = np.s_[50:90, 50:110]
"""Pixels of full weight."""


def plane_view(depth_m: float, sigma_px: float, index: int, position: tuple[float, float] = (0.0, 0.0)) -> View:
    """Return the view of a plane in front of a camera that looks along z of LM; depth is that of the plane in LM."""
    disparity = np.full((RIG.height, RIG.width), RIG.fx * RIG.baseline_m / depth_m, np.float32)
    T_lm_left = Transform(np.eye(3), np.array([*position, 0.0]))
    grey = np.random.default_rng(1).integers(0, 255, disparity.shape, dtype=np.uint8)
    cloud = cloud_from_disparity(disparity, np.full_like(disparity, sigma_px), grey, RIG, T_lm_left, index)
    return View(cloud, disparity, T_lm_left, 1.0)


def inner(cloud: Any, pair: int) -> Any:
    rows, cols = INNER
    inside = (cloud.v >= rows.start) & (cloud.v < rows.stop) & (cloud.u >= cols.start) & (cloud.u < cols.stop)
    return cloud.select(inside & (cloud.pair == pair))


ASIDE = ((0.0, 0.0), (0.021, 0.013), (-0.011, 0.023))
"""Positions of cameras that see a plane at 4 m between each other's samples."""


def test_points_lie_at_the_mean_weighted_by_inverse_variance() -> None:
    depths, sigmas = (4.0, 4.06, 3.97), (0.1, 0.2, 0.15)
    views = [plane_view(d, s, i, ASIDE[i]) for i, (d, s) in enumerate(zip(depths, sigmas, strict=True))]
    fused = fuse_views(views, RIG)
    own = [inner(view.cloud, i) for i, view in enumerate(views)]
    variances = np.array([np.square(cloud.sigma).mean() for cloud in own], float)
    weights = 1.0 / variances
    expected = (weights * depths).sum() / weights.sum()
    for pair, before in enumerate(own):
        cloud = inner(fused.cloud, pair)
        assert len(cloud) == len(before)
        np.testing.assert_allclose(cloud.xyz[:, 2].mean(), expected, atol=2e-3)
        assert cloud.xyz[:, 2].std() < 2e-3
        variance = COMMON_SHARE * variances[pair] + (1.0 - COMMON_SHARE) / weights.sum()
        np.testing.assert_allclose(np.square(cloud.sigma).mean(), variance, rtol=0.02)


def test_the_order_of_the_views_does_not_matter() -> None:
    views = [plane_view(4.0 + 0.03 * i, 0.1 + 0.05 * i, i, ASIDE[i]) for i in range(3)]
    reference = fuse_views(views, RIG).cloud
    for order in permutations(range(3)):
        cloud = fuse_views([views[i] for i in order], RIG).cloud
        assert len(cloud) == len(reference)
        for pair in range(3):
            a, b = inner(reference, pair), inner(cloud, pair)
            np.testing.assert_allclose(a.xyz, b.xyz, atol=1e-5)
            np.testing.assert_allclose(a.sigma, b.sigma, rtol=1e-5)


def test_points_move_along_their_rays() -> None:
    views = [plane_view(4.0, 0.2, 0), plane_view(4.1, 0.1, 1, ASIDE[1])]
    fused = inner(fuse_views(views, RIG).cloud, 0)
    assert fused.xyz[:, 2].mean() > 4.03
    np.testing.assert_allclose(RIG.fx * fused.xyz[:, 0] / fused.xyz[:, 2] + RIG.cx, fused.u, atol=1e-3)
    np.testing.assert_allclose(RIG.fy * fused.xyz[:, 1] / fused.xyz[:, 2] + RIG.cy, fused.v, atol=1e-3)


def test_of_the_same_sample_the_one_with_the_larger_weight_stays() -> None:
    views = [plane_view(4.0, 0.2, 0), plane_view(4.0, 0.1, 1)]
    cloud = fuse_views(views, RIG).cloud
    assert len(inner(cloud, 0)) == 0
    assert len(inner(cloud, 1)) == len(inner(views[1].cloud, 1))
    equal = fuse_views([plane_view(4.0, 0.1, 0), plane_view(4.0, 0.1, 1)], RIG).cloud
    assert len(inner(equal, 0)) == len(inner(views[0].cloud, 0))
    assert len(inner(equal, 1)) == 0


@pytest.mark.parametrize(("difference", "dropped"), [(1.0, True), (-1.0, False)])
def test_a_point_is_dropped_if_a_better_view_sees_through_it(difference: float, dropped: bool) -> None:
    """A better view that sees something nearer is occluded itself: the point stays."""
    view = plane_view(4.0, 0.1, 0)
    few = replace(view, cloud=view.cloud.select(np.arange(5)))
    weight = np.full(view.disparity_px.shape, 25.0, np.float32)
    accumulator = FusionAccumulator(few, weight)
    value = np.array([difference], np.float32)
    one = np.ones(1, np.float32)
    accumulator.add(ReprojectedPoints(np.array([2]), value, 0.1 * one, 100 * one, one, one, one), before=False)
    assert accumulator.conflicts == int(dropped)
    assert accumulator.merged == 0
    np.testing.assert_array_equal(accumulator.cloud().xyz, np.delete(few.cloud.xyz, [2] if dropped else [], axis=0))


def test_fused_points_are_nearer_to_the_truth_than_either_pair(two_views: Any) -> None:
    views = two_views.views
    fused = fuse_views(views, two_views.rig)
    assert len(fused.cloud) < 1.05 * max(len(view.cloud) for view in views)
    assert fused.statistics["merged"] > 1.8 * len(views[0].cloud) * 0.9
    singles = [np.abs(two_views.depth_errors(view.cloud)).mean() for view in views]
    assert np.abs(two_views.depth_errors(fused.cloud)).mean() < min(singles)
    assert not fused.warnings


def test_no_sample_of_the_ground_is_lost_where_pairs_overlap(two_views: Any) -> None:
    """Seen from slightly aside, both pairs' points stay, on one surface."""
    first, second = two_views.views
    pose = second.T_lm_left
    moved = second.with_pose(Transform(pose.rotation, pose.translation + pose.rotation @ np.array([-0.004, 0.0, 0.0])))
    fused = fuse_views([first, moved], two_views.rig)
    assert len(fused.cloud) > 0.999 * (len(first.cloud) + len(moved.cloud))
    assert fused.statistics["merged"] > 0.9 * len(fused.cloud)


def test_pairs_are_numbered_in_the_order_given(two_views: Any) -> None:
    """A pair that was left out leaves no gap: truth, poses and points go by the same number."""
    second = two_views.views[1]
    assert second.numbered(1) is second
    again = second.numbered(0)
    assert set(again.cloud.pair.tolist()) == {0}
    np.testing.assert_array_equal(again.cloud.xyz, second.cloud.xyz)


def test_one_pair_stays_as_it_is(two_views: Any) -> None:
    view = two_views.views[0]
    fused = fuse_views([view], two_views.rig)
    np.testing.assert_array_equal(fused.cloud.xyz, view.cloud.xyz)
    np.testing.assert_array_equal(fused.cloud.sigma, view.cloud.sigma)
    assert fused.cloud.fused is False
    assert fused.statistics == {
            "points_in": len(view.cloud), "merged": 0.0, "dropped_conflict": 0.0, "points": len(view.cloud),
            "pairs": 1.0, "fused": 0.0
        }  # fmt: skip


def test_pairs_that_do_not_overlap_are_kept_whole(two_views: Any) -> None:
    first, second = two_views.views
    away = Transform(second.T_lm_left.rotation, second.T_lm_left.translation + np.array([0.0, 500.0, 0.0]))
    fused = fuse_views([first, second.with_pose(away)], two_views.rig)
    assert len(fused.cloud) == len(first.cloud) + len(second.cloud)
    assert fused.statistics["overlap_0_1"] == 0.0


@pytest.mark.parametrize("degrees", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_pose_one_degree_off_is_named(two_views: Any, axis: int, degrees: float) -> None:
    first, second = two_views.views
    error = matrix_from_rotvec(np.deg2rad(degrees) * np.eye(3)[axis])
    wrong = second.with_pose(second.T_lm_left @ Transform(error, np.zeros(3)))
    fused = fuse_views([first, wrong], two_views.rig)
    assert any("their poses" in line for line in fused.warnings)


def test_a_surface_that_a_better_pair_sees_through_is_dropped(two_views: Any) -> None:
    rig, (first, second) = two_views.rig, two_views.views
    ghost = np.full(second.disparity_px.shape, np.nan, np.float32)
    ghost[100:140, 150:190] = second.disparity_px[100:140, 150:190] + 6.0
    sigma = np.full_like(ghost, 3.0 * np.median(second.cloud.sigma))
    grey = np.zeros(ghost.shape, np.uint8)
    poor = cloud_from_disparity(ghost, sigma, grey, rig, second.T_lm_left, 1)
    poor = replace(poor, sigma=np.full(len(poor), 3.0 * np.median(second.cloud.sigma), np.float32))
    fused = fuse_views([first, View(poor, ghost, second.T_lm_left, second.noise_grey)], rig)
    assert fused.statistics["dropped_conflict"] > 0.8 * len(poor)
    assert len(fused.cloud) < len(first.cloud) + 0.2 * len(poor)

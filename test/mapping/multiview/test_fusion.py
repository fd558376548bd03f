"""Fusion: the inverse-variance mean of planes, independent of order; agreement, conflict, duplicates."""

from itertools import permutations
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.multiview.fusion import COMMON_VARIANCE, fuse_views
from sfr_loc_map.mapping.multiview.pair_view import FEATHER_PX, PairView, project_into_view
from sfr_loc_map.mapping.reprojection import cloud_from_disparity

RIG = StereoRig(160, 140, 100.0, 100.0, 79.5, 69.5, 0.2)
INNER = np.s_[50:90, 50:110]
"""Pixels of full weight."""


def plane_view(depth_m: float, sigma_px: float, index: int, position: tuple[float, float] = (0.0, 0.0)) -> PairView:
    """Return the view of a plane in front of a camera that looks along z of LM; depth is that of the plane in LM."""
    disparity = np.full((RIG.height, RIG.width), RIG.fx * RIG.baseline_m / depth_m, np.float32)
    T_lm_left = Transform(np.eye(3), np.array([*position, 0.0]))
    grey = np.random.default_rng(1).integers(0, 255, disparity.shape, dtype=np.uint8)
    cloud = cloud_from_disparity(disparity, np.full_like(disparity, sigma_px), grey, RIG, T_lm_left, index)
    return PairView(cloud, disparity, T_lm_left, 1.0)


def inner(cloud: Any, pair: int) -> Any:
    rows, cols = INNER
    inside = (cloud.v >= rows.start) & (cloud.v < rows.stop) & (cloud.u >= cols.start) & (cloud.u < cols.stop)
    return cloud.select(inside & (cloud.pair == pair))


ASIDE = ((0.0, 0.0), (0.021, 0.013), (-0.011, 0.023))
"""Positions of cameras that see a plane at 4 m between each other's samples."""


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_points_lie_at_the_mean_weighted_by_inverse_variance_in_any_order(order: tuple[int, ...]) -> None:
    depths, sigmas = (4.0, 4.06, 3.97), (0.1, 0.2, 0.15)
    views = [plane_view(d, s, i, ASIDE[i]) for i, (d, s) in enumerate(zip(depths, sigmas, strict=True))]
    fused = fuse_views([views[i] for i in order], RIG).cloud
    own = [inner(view.cloud, i) for i, view in enumerate(views)]
    variances = np.array([np.square(cloud.sigma).mean() for cloud in own], float)
    weights = 1.0 / variances
    for pair, before in enumerate(own):
        cloud = inner(fused, pair)
        assert len(cloud) == len(before)
        np.testing.assert_allclose(cloud.xyz[:, 2].mean(), (weights * depths).sum() / weights.sum(), atol=2e-3)
        assert cloud.xyz[:, 2].std() < 2e-3
        variance = COMMON_VARIANCE * variances[pair] + (1.0 - COMMON_VARIANCE) / weights.sum()
        np.testing.assert_allclose(np.square(cloud.sigma).mean(), variance, rtol=0.02)


def test_the_feather_reduces_weights_towards_the_border_and_leaves_sigma() -> None:
    """Of a plane in front of the camera sigma is that of the ray's length; a corner has a feather of 1 / 48."""
    view = plane_view(4.0, 0.1, 0)
    seen = project_into_view(view.cloud, view.T_lm_left, view.images, RIG)
    own_sigma = view.cloud.sigma[seen.point_indices]
    np.testing.assert_array_equal(seen.sigma, own_sigma)
    feather = view.point_weights() * np.square(view.cloud.sigma)
    assert feather.max() == pytest.approx(1.0)
    assert feather.min() == pytest.approx(1.0 / FEATHER_PX)
    np.testing.assert_allclose(seen.weight, view.point_weights()[seen.point_indices])


def test_sigma_near_the_border_is_that_of_the_mean_with_reduced_weights() -> None:
    """Two equally uncertain views agree: the mean of both is better than either one at any distance from the border."""
    views = [plane_view(4.0, 0.1, i, ASIDE[i]) for i in range(2)]
    cloud = fuse_views(views, RIG).cloud
    own = views[0].cloud
    fused = cloud.select(cloud.pair == 0)
    single = views[0].images.sigma[fused.v, fused.u]
    merged = fused.sigma != single
    assert merged.sum() > 0.9 * len(own)
    assert (fused.sigma[merged] < single[merged]).all()
    both = np.sqrt(COMMON_VARIANCE + 0.5 * (1.0 - COMMON_VARIANCE))
    assert np.median(fused.sigma[merged] / single[merged]) == pytest.approx(both, abs=0.01)


@pytest.mark.parametrize(("depth_m", "conflicts"), [(5.0, True), (3.0, False)])
def test_a_point_is_dropped_if_a_better_view_sees_through_it(depth_m: float, conflicts: bool) -> None:
    """A better view that sees something nearer is occluded itself: the point stays."""
    cloud, findings = fuse_views([plane_view(4.0, 0.1, 0), plane_view(depth_m, 0.01, 1, ASIDE[1])], RIG)
    assert (len(inner(cloud, 0)) == 0) == conflicts
    assert (findings.statistics["dropped_conflict"] > 0) == conflicts
    assert len(inner(cloud, 1)) == 40 * 60


def test_fused_points_are_nearer_to_the_truth_than_either_pair(two_views: Any) -> None:
    views = two_views.views
    cloud, findings = fuse_views(views, two_views.rig)
    assert len(cloud) < 1.05 * max(len(view.cloud) for view in views)
    assert findings.statistics["merged"] > 1.8 * len(views[0].cloud) * 0.9
    singles = [np.abs(two_views.depth_errors(view.cloud)).mean() for view in views]
    assert np.abs(two_views.depth_errors(cloud)).mean() < min(singles)
    assert not findings.warnings


def test_one_pair_and_pairs_that_do_not_overlap_stay_as_they_are(two_views: Any) -> None:
    first, second = two_views.views
    cloud, findings = fuse_views([first], two_views.rig)
    np.testing.assert_array_equal(cloud.xyz, first.cloud.xyz)
    np.testing.assert_array_equal(cloud.sigma, first.cloud.sigma)
    assert (cloud.fused, findings.statistics["pairs"], findings.statistics["merged"]) == (False, 1.0, 0.0)
    away = Transform(second.T_lm_left.rotation, second.T_lm_left.translation + np.array([0.0, 500.0, 0.0]))
    cloud, findings = fuse_views([first, second.with_pose(away)], two_views.rig)
    assert len(cloud) == len(first.cloud) + len(second.cloud)
    assert findings.statistics["overlap_0_1"] == 0.0


@pytest.mark.parametrize("degrees", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_pose_one_degree_off_is_named(two_views: Any, axis: int, degrees: float) -> None:
    first, second = two_views.views
    error = matrix_from_rotvec(np.deg2rad(degrees) * np.eye(3)[axis])
    wrong = second.with_pose(second.T_lm_left @ Transform(error, np.zeros(3)))
    assert any("their poses" in line for line in fuse_views([first, wrong], two_views.rig).findings.warnings)

"""Fusion: the inverse-variance mean of planes, independent of order; agreement, conflict, duplicates."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.disparity.validity.saturation import measure_saturation
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.fusion import COMMON_VARIANCE, fuse_views
from sfr_loc_map.mapping.multiview.projection import FEATHER_PX, point_weights, project_into_view
from sfr_loc_map.mapping.pair_view import PairView, ViewPoints, reproject_pixels

RIG = StereoRig(160, 140, 100.0, 100.0, 79.5, 69.5, 0.2)
INNER = np.s_[50:90, 50:110]
"""Pixels of full weight."""


def plane_view(
    depth_m: float, sigma_px: float, position: tuple[float, float] = (0.0, 0.0), behind_m: float = 0.0
) -> PairView:
    """Return the view of a plane at `depth_m` in LM by a camera that looks along z, `behind_m` metres behind z = 0."""
    disparity = np.full((RIG.height, RIG.width), RIG.fx * RIG.baseline_m / (depth_m + behind_m), np.float32)
    T_lm_left = Transform(np.eye(3), np.array([*position, -behind_m]))
    grey = np.random.default_rng(1).integers(0, 255, disparity.shape, dtype=np.uint8)
    points, images = reproject_pixels(disparity, np.full_like(disparity, sigma_px), grey, RIG, T_lm_left)
    return PairView(points, images, T_lm_left, 1.0, measure_saturation(grey, grey, disparity))


def inner(points: ViewPoints) -> ViewPoints:
    rows, cols = INNER
    inside = (points.v >= rows.start) & (points.v < rows.stop) & (points.u >= cols.start) & (points.u < cols.stop)
    return points.select(inside)


def agreement(views: Sequence[PairView], rig: StereoRig) -> Findings:
    return fuse_views(views, rig)[1]


ASIDE = ((0.0, 0.0), (0.021, 0.013), (-0.011, 0.023))
"""Positions of cameras that see a plane at 4 m between each other's samples."""


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_points_lie_at_the_mean_weighted_by_inverse_variance_in_any_order(order: tuple[int, ...]) -> None:
    depths, sigmas = (4.0, 4.06, 3.97), (0.1, 0.2, 0.15)
    views = [plane_view(d, s, ASIDE[i]) for i, (d, s) in enumerate(zip(depths, sigmas, strict=True))]
    fused, _ = fuse_views([views[i] for i in order], RIG)
    own = [inner(view.points) for view in views]
    variances = np.array([np.square(points.fusion_sigma).mean() for points in own], float)
    weights = 1.0 / variances
    for position, index in enumerate(order):
        points = inner(fused[position])
        assert points.size == own[index].size
        np.testing.assert_allclose(points.xyz[:, 2].mean(), (weights * depths).sum() / weights.sum(), atol=2e-3)
        assert points.xyz[:, 2].std() < 2e-3
        variance = COMMON_VARIANCE * variances[index] + (1.0 - COMMON_VARIANCE) / weights.sum()
        np.testing.assert_allclose(np.square(points.fusion_sigma).mean(), variance, rtol=0.02)


def test_the_feather_reduces_weights_towards_the_border_and_leaves_sigma() -> None:
    """Of a plane in front of the camera sigma is that of the ray's length; a corner has a feather of 1 / 48."""
    view = plane_view(4.0, 0.1)
    seen = project_into_view(view.points.xyz, view.T_lm_left, view.images, RIG)
    np.testing.assert_array_equal(seen.fusion_sigma[seen.indices], view.points.fusion_sigma[seen.indices])
    weights = point_weights(view)
    feather = weights * np.square(view.points.fusion_sigma)
    assert feather.max() == pytest.approx(1.0)
    assert feather.min() == pytest.approx(1.0 / FEATHER_PX)
    np.testing.assert_allclose(seen.weight[seen.indices], weights[seen.indices])


def test_sigma_near_the_border_is_that_of_the_mean_with_reduced_weights() -> None:
    """Two equally uncertain views agree: the mean of both is better than either one at any distance from the border."""
    views = [plane_view(4.0, 0.1, ASIDE[i]) for i in range(2)]
    points = fuse_views(views, RIG)[0][0]
    single = views[0].images.fusion_sigma[points.v, points.u]
    merged = points.fusion_sigma != single
    assert merged.sum() > 0.9 * views[0].points.size
    assert (points.fusion_sigma[merged] < single[merged]).all()
    both = np.sqrt(COMMON_VARIANCE + 0.5 * (1.0 - COMMON_VARIANCE))
    assert np.median(points.fusion_sigma[merged] / single[merged]) == pytest.approx(both, abs=0.01)


@pytest.mark.parametrize(("depth_m", "conflicts"), [(5.0, True), (3.0, False)])
def test_a_point_is_dropped_if_a_better_view_sees_through_it(depth_m: float, conflicts: bool) -> None:
    """A better view that sees something nearer is occluded itself: the point stays."""
    fused, findings = fuse_views([plane_view(4.0, 0.1), plane_view(depth_m, 0.01, ASIDE[1])], RIG)
    assert (inner(fused[0]).size == 0) == conflicts
    assert (findings.statistics["dropped_conflict"] > 0) == conflicts
    assert inner(fused[1]).size == 40 * 60


@pytest.mark.parametrize(("behind_m", "is_used"), [(0.8, True), (1.3, False)])
def test_a_view_from_farther_away_changes_no_point_and_is_changed_itself(behind_m: float, is_used: bool) -> None:
    """The range from the other camera is 1.20 and 1.32 times the range of 4 m in the middle of the image."""
    near = plane_view(4.0, 0.1)
    far = plane_view(4.02, 0.05, ASIDE[1], behind_m)
    fused, _ = fuse_views([near, far], RIG)
    assert ((inner(fused[0]).xyz[:, 2] > 4.001) == is_used).all()
    assert (inner(fused[1]).xyz[:, 2] < 4.019).all()
    behind = plane_view(5.0, 0.01, ASIDE[1], behind_m)  # a farther surface drops the point unless the view is ignored
    assert (inner(fuse_views([near, behind], RIG)[0][0]).size == 0) == is_used


def test_fused_points_are_nearer_to_the_truth_than_either_pair(two_views: Any) -> None:
    views = two_views.views
    fused, findings = fuse_views(views, two_views.rig)
    points = ViewPoints.concatenated(fused)
    assert points.size < 1.05 * max(view.points.size for view in views)
    assert findings.statistics["merged"] > 1.8 * views[0].points.size * 0.9
    singles = [np.abs(two_views.depth_errors(view.points)).mean() for view in views]
    assert np.abs(two_views.depth_errors(points)).mean() < min(singles)
    assert not findings.warnings


def test_one_pair_and_pairs_that_do_not_overlap_stay_as_they_are(two_views: Any) -> None:
    first, second = two_views.views
    (points,), findings = fuse_views([first], two_views.rig)
    np.testing.assert_array_equal(points.xyz, first.points.xyz)
    np.testing.assert_array_equal(points.fusion_sigma, first.points.fusion_sigma)
    assert [findings.statistics[name] for name in ("fused", "pairs", "merged")] == [0.0, 1.0, 0.0]
    assert not any(name.startswith("overlap") for name in findings.statistics)
    away = Transform(second.T_lm_left.rotation, second.T_lm_left.translation + np.array([0.0, 500.0, 0.0]))
    fused, findings = fuse_views([first, second.with_pose(away)], two_views.rig)
    assert [part.size for part in fused] == [first.points.size, second.points.size]
    compared = {name: value for name, value in findings.statistics.items() if name.endswith(("_0_1", "_1_0"))}
    assert compared == {"overlap_0_1": 0.0, "overlap_1_0": 0.0}


@pytest.mark.parametrize("degrees", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_pose_one_degree_off_is_named(two_views: Any, axis: int, degrees: float) -> None:
    first, second = two_views.views
    error = matrix_from_rotvec(np.deg2rad(degrees) * np.eye(3)[axis])
    wrong = second.with_pose(second.T_lm_left @ Transform(error, np.zeros(3)))
    assert any("their poses" in line for line in agreement([first, wrong], two_views.rig).warnings)


@pytest.mark.parametrize(
    ("depth_m", "aside_m", "noise_grey", "ranges", "greys"),
    [
        (4.0, 0.0, 1.0, False, False),
        (4.5, 0.0, 1e6, True, False),  # no texture above the noise: the grey levels are not compared
        (4.0, 1.0, 1.0, False, True),
        (4.5, 1.0, 1.0, True, True),
    ],
)
def test_the_warning_names_only_the_differences_that_exceed_their_limit(
    depth_m: float, aside_m: float, noise_grey: float, ranges: bool, greys: bool
) -> None:
    first, second = plane_view(4.0, 0.01), plane_view(depth_m, 0.01, (aside_m, 0.0))
    found = agreement([first, replace(second, noise_grey=noise_grey)], RIG)
    warning = " ".join(found.warnings)
    assert ("range differences" in warning) == ranges
    assert ("grey level differences" in warning) == greys
    assert "nan" not in warning
    assert np.isnan(found.statistics["grey_difference_over_beside_0_1"]) == (noise_grey > 1.0)

"""A view: its weights, its smoothed image; points reprojected into it, against the pinhole equations in numpy."""

import numpy as np
import pytest

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.multiview.pair_view import (
    FEATHER_PX,
    SHIFT_PX,
    PairView,
    ReprojectedPoints,
    ViewImages,
    reproject_into_view,
)

F = np.float32
ROWS, COLS = 120, 160
RIG = StereoRig(100, 80, 90.0, 95.0, 49.0, 40.0, 0.2)
POSE = Transform(matrix_from_rotvec([-1.9, 0.3, 0.2]), np.array([0.5, -1.0, 2.0]))
V, U = np.mgrid[: RIG.height, : RIG.width].astype(float)


def view_of(known: np.ndarray, sigma: float = 0.1, grey: np.ndarray | None = None) -> PairView:
    """Return a view with a point at each known pixel."""
    v, u = np.nonzero(known)
    grey = np.full(known.shape, 100.0) if grey is None else grey
    xyz = np.random.default_rng(0).normal(0.0, 1.0, (len(u), 3)).astype(np.float32)
    columns = np.full(len(u), sigma, np.float32), grey[v, u].astype(np.float32), u.astype(np.uint16)
    cloud = PointCloud(xyz, *columns, v.astype(np.uint16), np.zeros(len(u), np.uint8))
    return PairView(cloud, np.where(known, 5.0, np.nan).astype(np.float32), POSE, 1.0)


def test_weights_are_inverse_variances_that_fade_at_the_border() -> None:
    known = np.ones((ROWS, COLS), bool)
    known[50:60, 60:70] = False
    weight = view_of(known, 0.1).images.weight
    assert weight[55, 65] == 0.0
    assert weight[58, 80] == pytest.approx(100.0)
    for v, u, edge in ((0, 80, 1), (60, 0, 1), (119, 80, 1), (60, 159, 1), (60, 11, 12), (107, 90, 13), (3, 5, 4)):
        assert weight[v, u] == pytest.approx(100.0 * edge / FEATHER_PX, rel=1e-5)


def cloud_at(u: np.ndarray, v: np.ndarray, depth: np.ndarray) -> PointCloud:
    """Return the points that POSE's camera sees at points of its image, grey level 10."""
    ray = np.column_stack(((u - RIG.cx) / RIG.fx, (v - RIG.cy) / RIG.fy, np.ones(len(u))))
    xyz = POSE.apply(ray * depth[:, None]).astype(F)
    one = np.ones(len(u))
    columns = (0.1 * one).astype(F), (10.0 * one).astype(F), one.astype(np.uint16), one.astype(np.uint16)
    return PointCloud(xyz, *columns, one.astype(np.uint8))


def images(disparity: np.ndarray | None = None) -> ViewImages:
    """Return a plane of 4.5 px, weights that encode the pixel, and grey levels that rise along both axes."""
    disparity = np.full(U.shape, 4.5) if disparity is None else disparity
    return ViewImages(disparity.astype(F), (1.0 + U + 100.0 * V).astype(F), (0.5 * U + 0.25 * V).astype(F))


def seen(cloud: PointCloud, view: ViewImages) -> ReprojectedPoints:
    return reproject_into_view(cloud, POSE, view, RIG)


RNG = np.random.default_rng(0)


PIXELS = RNG.uniform(5.0, 60.0, 50), RNG.uniform(5.0, 50.0, 50)


@pytest.mark.parametrize("depth", [3.0, 4.0, 5.0])
def test_the_difference_is_that_along_the_ray(depth: float) -> None:
    """Positive where the view sees something farther; the plane lies at 18 / 4.5 = 4 m."""
    u, v = PIXELS
    found = seen(cloud_at(u, v, np.full(50, depth)), images())
    np.testing.assert_array_equal(found.index, np.arange(50))
    length = np.sqrt(((u - RIG.cx) / RIG.fx) ** 2 + ((v - RIG.cy) / RIG.fy) ** 2 + 1.0)
    np.testing.assert_allclose(found.difference, (4.0 - depth) * length, atol=1e-4)


def test_disparities_and_grey_levels_are_interpolated() -> None:
    u, v = PIXELS
    slanted = 4.0 + 0.02 * U - 0.01 * V
    depth = RIG.fx * RIG.baseline_m / (4.0 + 0.02 * u - 0.01 * v)
    found = seen(cloud_at(u, v, depth), images(slanted))
    np.testing.assert_allclose(found.difference, 0.0, atol=1e-4)
    np.testing.assert_allclose(found.grey_difference, 0.5 * u + 0.25 * v - 10.0, atol=1e-3)


def test_weight_and_shifted_grey_are_those_of_the_nearest_pixel() -> None:
    u, v = PIXELS
    found = seen(cloud_at(u, v, np.full(50, 4.0)), images())
    near_u, near_v = np.rint(u), np.rint(v)
    np.testing.assert_allclose(found.weight, 1.0 + near_u + 100.0 * near_v)
    np.testing.assert_allclose(found.deviation, 1.0 / np.sqrt(found.weight), rtol=1e-6)
    np.testing.assert_allclose(found.offset_px, np.hypot(u - near_u, v - near_v), atol=1e-4)
    shifted = 0.5 * (near_u + SHIFT_PX) + 0.25 * (near_v + SHIFT_PX)
    np.testing.assert_allclose(found.grey_difference_shifted, shifted - 10.0, atol=1e-3)


def test_points_outside_or_behind_are_not_seen() -> None:
    u = np.array([50.0, -3.0, 120.0, 50.0, 50.0, 50.0])
    v = np.array([40.0, 40.0, 40.0, -2.0, 90.0, 40.0])
    depth = np.array([4.0, 4.0, 4.0, 4.0, 4.0, -4.0])
    np.testing.assert_array_equal(seen(cloud_at(u, v, depth), images()).index, [0])


def test_nothing_is_seen_across_a_jump_or_where_there_is_no_point() -> None:
    disparity = np.full(U.shape, 4.5)
    disparity[:, 30:] = 6.0
    disparity[20, 10] = np.nan
    view = images(disparity)
    view.weight[40, 20] = 0.0
    u, v = np.array([29.5, 28.5, 30.5, 10.2, 20.2]), np.array([30.0, 30.0, 30.0, 20.3, 40.3])
    np.testing.assert_array_equal(seen(cloud_at(u, v, np.full(5, 4.0)), view).index, [1, 2])

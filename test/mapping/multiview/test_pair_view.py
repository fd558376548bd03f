"""A view: its weights, its smoothed image; points reprojected into it, against the pinhole equations in numpy."""

from dataclasses import replace

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


def cloud_at(u: np.ndarray, v: np.ndarray, depth: np.ndarray, sigma: float = 0.1) -> PointCloud:
    """Return the points that POSE's camera sees at points of its image, grey level 10."""
    ray = np.column_stack(((u - RIG.cx) / RIG.fx, (v - RIG.cy) / RIG.fy, np.ones(len(u))))
    records = np.zeros(len(u), PointCloud.dtype())
    records["sigma"], records["intensity"], records["u"], records["v"] = sigma, 10.0, u, v
    return replace(PointCloud.from_structured(records), xyz=POSE.apply(ray * depth[:, None]).astype(F))


def seen(u: np.ndarray, v: np.ndarray, depth: np.ndarray, disparity: np.ndarray, hole: float = 1) -> ReprojectedPoints:
    """Reproject into a view whose weights encode the pixel and whose grey levels rise along both axes."""
    view = ViewImages(disparity.astype(F), (1.0 + U + 100.0 * V).astype(F), (0.5 * U + 0.25 * V).astype(F))
    view.weight[40, 20] *= hole
    return reproject_into_view(cloud_at(u, v, depth), POSE, view, RIG)


def test_weights_are_inverse_variances_that_fade_at_the_border() -> None:
    known = np.ones((ROWS, COLS), bool)
    known[50:60, 60:70] = False
    v, u = (axis.astype(float) for axis in np.nonzero(known))
    view = PairView(cloud_at(u, v, np.ones(len(u))), np.where(known, 5.0, np.nan).astype(F), POSE, 1.0)
    weight = view.images.weight
    assert weight[55, 65] == 0.0
    assert weight[58, 80] == pytest.approx(100.0)
    for v, u, edge in ((0, 80, 1), (60, 0, 1), (119, 80, 1), (60, 159, 1), (60, 11, 12), (107, 90, 13), (3, 5, 4)):
        assert weight[v, u] == pytest.approx(100.0 * edge / FEATHER_PX, rel=1e-5)


@pytest.mark.parametrize("farther", [-1.0, 0.0, 1.0])
def test_differences_are_along_the_ray_grey_levels_interpolated_and_weights_those_of_the_nearest_pixel(
    farther: float,
) -> None:
    """The difference is positive where the view sees something farther."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(5.0, 60.0, 50), rng.uniform(5.0, 50.0, 50)
    depth = RIG.fx * RIG.baseline_m / (4.0 + 0.02 * u - 0.01 * v)
    found = seen(u, v, depth - farther, 4.0 + 0.02 * U - 0.01 * V)
    np.testing.assert_array_equal(found.index, np.arange(50))
    length = np.sqrt(((u - RIG.cx) / RIG.fx) ** 2 + ((v - RIG.cy) / RIG.fy) ** 2 + 1.0)
    np.testing.assert_allclose(found.difference, farther * length, atol=1e-4)
    np.testing.assert_allclose(found.grey_difference, 0.5 * u + 0.25 * v - 10.0, atol=1e-3)
    near_u, near_v = np.rint(u), np.rint(v)
    np.testing.assert_allclose(found.weight, 1.0 + near_u + 100.0 * near_v)
    np.testing.assert_allclose(found.deviation, 1.0 / np.sqrt(found.weight), rtol=1e-6)
    np.testing.assert_allclose(found.offset_px, np.hypot(u - near_u, v - near_v), atol=1e-4)
    shifted = 0.5 * (near_u + SHIFT_PX) + 0.25 * (near_v + SHIFT_PX)
    np.testing.assert_allclose(found.grey_difference_shifted, shifted - 10.0, atol=1e-3)


def test_nothing_is_seen_outside_behind_across_a_jump_or_where_there_is_no_point() -> None:
    u = np.array([50.0, -3.0, 120.0, 50.0, 50.0, 50.0])
    v = np.array([40.0, 40.0, 40.0, -2.0, 90.0, 40.0])
    depth = np.array([4.0, 4.0, 4.0, 4.0, 4.0, -4.0])
    disparity = np.full(U.shape, 4.5)
    np.testing.assert_array_equal(seen(u, v, depth, disparity).index, [0])
    disparity[:, 30:] = 6.0
    disparity[20, 10] = np.nan
    u, v = np.array([29.5, 28.5, 30.5, 10.2, 20.2]), np.array([30.0, 30.0, 30.0, 20.3, 40.3])
    np.testing.assert_array_equal(seen(u, v, np.full(5, 4.0), disparity, hole=0).index, [1, 2])

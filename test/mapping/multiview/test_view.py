"""A view: its weights, its smoothed image, its motion."""

import numpy as np
import pytest

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.multiview.view import FEATHER_PX, View

ROWS, COLS = 120, 160
POSE = Transform(matrix_from_rotvec([0.2, -0.4, 1.0]), np.array([1.0, 2.0, -1.0]))


def view_of(known: np.ndarray, sigma: float = 0.1, grey: np.ndarray | None = None) -> View:
    """Return a view with a point at each known pixel."""
    v, u = np.nonzero(known)
    grey = np.full(known.shape, 100.0) if grey is None else grey
    xyz = np.random.default_rng(0).normal(0.0, 1.0, (len(u), 3)).astype(np.float32)
    columns = np.full(len(u), sigma, np.float32), grey[v, u].astype(np.float32), u.astype(np.uint16)
    cloud = PointCloud(xyz, *columns, v.astype(np.uint16), np.zeros(len(u), np.uint8))
    return View(cloud, np.where(known, 5.0, np.nan).astype(np.float32), POSE, 1.0)


def test_weights_are_inverse_variances_that_fade_at_the_border() -> None:
    known = np.ones((ROWS, COLS), bool)
    known[50:60, 60:70] = False
    weight = view_of(known, 0.1).weight_image()
    assert weight[55, 65] == 0.0
    assert weight[58, 80] == pytest.approx(100.0)
    for v, u, edge in ((0, 80, 1), (60, 0, 1), (119, 80, 1), (60, 159, 1), (60, 11, 12), (107, 90, 13), (3, 5, 4)):
        assert weight[v, u] == pytest.approx(100.0 * edge / FEATHER_PX, rel=1e-5)


def test_the_grey_image_is_smoothed_over_known_pixels_alone() -> None:
    rng = np.random.default_rng(0)
    known = rng.uniform(size=(ROWS, COLS)) < 0.7
    grey = rng.integers(0, 256, known.shape).astype(float)
    view = view_of(known, grey=grey)
    np.testing.assert_array_equal(view.grey_image(), np.where(known, grey, np.nan).astype(np.float32))
    smoothed = view.grey_image(5.0)
    np.testing.assert_array_equal(np.isnan(smoothed), ~known)
    assert np.nanstd(smoothed) < 0.15 * grey.std()
    np.testing.assert_allclose(view_of(known).grey_image(5.0)[known], 100.0, rtol=1e-4)


def test_points_move_with_the_pose() -> None:
    view = view_of(np.ones((4, 5), bool))
    pose = Transform(matrix_from_rotvec([0.0, 0.3, 0.1]), np.array([0.0, -3.0, 0.5]))
    moved = view.with_pose(pose)
    expected = view.T_lm_left.inverse().apply(view.cloud.xyz)
    np.testing.assert_allclose(pose.inverse().apply(moved.cloud.xyz), expected, atol=1e-5)
    np.testing.assert_array_equal(moved.cloud.u, view.cloud.u)
    np.testing.assert_allclose(moved.with_pose(POSE).cloud.xyz, view.cloud.xyz, atol=1e-5)
    assert view.T_lm_left is POSE

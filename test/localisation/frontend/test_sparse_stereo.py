"""Sparse stereo on a texture whose disparities are known; nearest neighbours as a search tree finds them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from sfr_loc_map.localisation.frontend.patch import HALF, build_pyramid, cut_patches
from sfr_loc_map.localisation.frontend.sparse_stereo import StereoMatches, match_corners, nearest, refine_slopes

HEIGHT, WIDTH = 160, 240
LEFT = np.clip(gaussian_filter(np.random.default_rng(0).normal(128, 400, (HEIGHT, WIDTH)), 2.0), 0, 255)
RANDOM = np.random.default_rng(3)
TEXTURE = gaussian_filter(RANDOM.normal(128, 400, (HEIGHT, WIDTH)), 2.0).astype(np.float32)
UV = np.stack(np.meshgrid(np.arange(70, 210, 14.0), np.arange(30, 135, 14.0)), axis=-1).reshape(-1, 2)


def moved(left: np.ndarray, a: float, b: float, c: float, rows: float = 0.0) -> np.ndarray:
    """Return the right image of the plane `disparity = a + b u + c v` in left pixels, lower by some rows."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    v -= rows
    return map_coordinates(left, [v, (u + a + c * v) / (1.0 - b)], order=3, mode="nearest").astype(np.float32)


def right_image(a: float, b: float, c: float, rows: float = 0.0) -> np.ndarray:
    return moved(LEFT, a, b, c, rows)


def match(right: np.ndarray, rows: float = 0.0) -> StereoMatches:
    pyramids = [build_pyramid(np.rint(np.clip(image, 0, 255)).astype(np.uint8)) for image in (LEFT, right)]
    return match_corners(*pyramids, UV, np.zeros((0, 3)), 40.0, rows)


@pytest.mark.parametrize(("a", "b", "c"), [(12.3, 0.0, 0.0), (9.0, 0.03, 0.05), (20.0, -0.04, -0.03)])
def test_disparities_and_slopes_of_a_plane_are_found(a: float, b: float, c: float) -> None:
    found = match(right_image(a, b, c))
    assert len(found.uv) > 0.8 * len(UV)
    expected = a + b * found.uv[:, 0] + c * found.uv[:, 1]
    error = np.abs(found.uv[:, 0] - found.right[:, 0] - expected)
    assert np.percentile(error, 90) < 0.06
    assert error.max() < 0.3
    np.testing.assert_allclose(np.median(found.slope, axis=0), [b, c], atol=0.006)


def test_vertical_disparity_is_measured_around_what_is_known() -> None:
    found = match(right_image(12.0, 0.0, 0.0, rows=2.4), rows=2.0)
    assert len(found.uv) > 0.8 * len(UV)
    assert np.median(found.right[:, 1] - found.uv[:, 1]) == pytest.approx(2.4, abs=0.03)


def slopes(left: np.ndarray, right: np.ndarray, plane: tuple[float, float, float], start: np.ndarray) -> np.ndarray:
    """Return the slopes from positions that are 0.2 px off."""
    a, b, c = plane
    places = np.column_stack((UV[:, 0] - a - b * UV[:, 0] - c * UV[:, 1] + 0.2, UV[:, 1] - 0.1))
    return refine_slopes(right, cut_patches(left, UV, HALF), places, start)


@pytest.mark.parametrize("plane", [(12.3, 0.0, 0.0), (9.0, 0.06, 0.08), (20.0, -0.08, -0.03)])
def test_slopes_of_a_plane_are_found_from_none(plane: tuple[float, float, float]) -> None:
    right = moved(TEXTURE, *plane)
    found = slopes(TEXTURE, right, plane, np.zeros((len(UV), 2)))
    np.testing.assert_allclose(np.median(found, axis=0), plane[1:], atol=0.003)
    assert np.percentile(np.abs(found - plane[1:]).max(axis=1), 90) < 0.02
    other = slopes(TEXTURE, 0.7 * right + np.float32(20.0), plane, np.zeros((len(UV), 2)))
    np.testing.assert_allclose(other, found, atol=2e-4)


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 80),
    st.integers(0, 80),
    st.integers(1, 9),
    st.sampled_from([1.0, 0.01, 1e4]),
)
def test_the_same_as_a_search_tree(seed: int, points: int, others: int, count: int, flat: float) -> None:
    """Compared with scipy's k-d tree; a flat cloud (along u or along v) is the hard case of a walk along u."""
    random = np.random.default_rng(seed)
    uv = random.uniform(0.0, 1.0, (points, 2)) * [flat, 1.0]
    support = np.concatenate((uv, random.uniform(0.0, 1.0, (others, 2)) * [flat, 1.0]))
    count, order = min(count, len(support)), np.argsort(support[:, 0])
    ordered = support[order]
    distance, index = nearest(uv, ordered, np.searchsorted(ordered[:, 0], uv[:, 0]), count)
    expected, which = (np.reshape(part, (points, count)) for part in cKDTree(support).query(uv, k=count))
    assert np.array_equal(distance, expected)
    assert np.array_equal(order[index], which)

"""Sparse stereo on a texture whose disparities are known; nearest neighbours as a search tree finds them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from sfr_loc_map.localisation.frontend.neighbour_slopes import nearest
from sfr_loc_map.localisation.frontend.pyramid import build_pyramid
from sfr_loc_map.localisation.frontend.stereo_matching import StereoMatches, match_corners

HEIGHT, WIDTH = 160, 240
LEFT = np.clip(gaussian_filter(np.random.default_rng(0).normal(128, 400, (HEIGHT, WIDTH)), 2.0), 0, 255)
UV = np.stack(np.meshgrid(np.arange(70, 210, 14.0), np.arange(30, 135, 14.0)), axis=-1).reshape(-1, 2)


def match(a: float, b: float, c: float, rows: float = 0.0, known_rows: float = 0.0) -> StereoMatches:
    """Match with the right image of the plane `disparity = a + b u + c v` in left pixels, lower by some rows."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    v -= rows
    right = map_coordinates(LEFT, [v, (u + a + c * v) / (1.0 - b)], order=3, mode="nearest")
    pyramids = [build_pyramid(np.rint(np.clip(image, 0, 255)).astype(np.uint8)) for image in (LEFT, right)]
    return match_corners(*pyramids, UV, np.zeros((0, 3)), 40.0, known_rows)


@pytest.mark.parametrize(("a", "b", "c"), [(12.3, 0.0, 0.0), (9.0, 0.03, 0.05), (20.0, -0.04, -0.03)])
def test_disparities_and_slopes_of_a_plane_are_found(a: float, b: float, c: float) -> None:
    found = match(a, b, c)
    assert len(found.uv) > 0.8 * len(UV)
    expected = a + b * found.uv[:, 0] + c * found.uv[:, 1]
    error = np.abs(found.uv[:, 0] - found.right[:, 0] - expected)
    assert np.percentile(error, 90) < 0.06
    assert error.max() < 0.3
    np.testing.assert_allclose(np.median(found.slope, axis=0), [b, c], atol=0.006)


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
    distance, index = nearest(uv, np.searchsorted(ordered[:, 0], uv[:, 0]), ordered, count)
    expected, which = (np.reshape(part, (points, count)) for part in cKDTree(support).query(uv, k=count))
    assert np.array_equal(distance, expected)
    assert np.array_equal(order[index], which)

"""Slopes of single patches on a texture whose plane is known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from sfr_loc_map.localisation.frontend.patch import HALF, cut_patches
from sfr_loc_map.localisation.frontend.patch_slopes import PRIOR_SIGMA, refine_slopes

HEIGHT, WIDTH = 160, 240
RANDOM = np.random.default_rng(3)
TEXTURE = gaussian_filter(RANDOM.normal(128, 400, (HEIGHT, WIDTH)), 2.0).astype(np.float32)
UV = np.stack(np.meshgrid(np.arange(70, 210, 14.0), np.arange(30, 135, 14.0)), axis=-1).reshape(-1, 2)


def right_image(left: np.ndarray, a: float, b: float, c: float) -> np.ndarray:
    """Return the right image of the plane `disparity = a + b u + c v` in left pixels."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    return map_coordinates(left, [v, (u + a + c * v) / (1.0 - b)], order=3, mode="nearest").astype(np.float32)


def slopes(left: np.ndarray, right: np.ndarray, plane: tuple[float, float, float], start: np.ndarray) -> np.ndarray:
    """Return the slopes from positions that are 0.2 px off."""
    a, b, c = plane
    places = np.column_stack((UV[:, 0] - a - b * UV[:, 0] - c * UV[:, 1] + 0.2, UV[:, 1] - 0.1))
    return refine_slopes(right, cut_patches(left, UV, HALF), places, start)


@pytest.mark.parametrize("plane", [(12.3, 0.0, 0.0), (9.0, 0.06, 0.08), (20.0, -0.08, -0.03)])
def test_slopes_of_a_plane_are_found_from_none(plane: tuple[float, float, float]) -> None:
    right = right_image(TEXTURE, *plane)
    found = slopes(TEXTURE, right, plane, np.zeros((len(UV), 2)))
    np.testing.assert_allclose(np.median(found, axis=0), plane[1:], atol=0.003)
    assert np.percentile(np.abs(found - plane[1:]).max(axis=1), 90) < 0.02
    other = slopes(TEXTURE, 0.7 * right + np.float32(20.0), plane, np.zeros((len(UV), 2)))
    np.testing.assert_allclose(other, found, atol=2e-4)


def test_noise_leaves_what_the_neighbours_say() -> None:
    """The stronger the noise against the texture, the more the prior counts; between the two no slope overshoots."""
    plane, start = (12.0, 0.1, 0.0), np.zeros((len(UV), 2))
    right = right_image(TEXTURE, *plane)
    shares = []
    for sigma in (0.0, 30.0, 120.0):
        noise = RANDOM.normal(0, 1, (2, HEIGHT, WIDTH)).astype(np.float32) * np.float32(sigma)
        shares.append(np.median(slopes(TEXTURE + noise[0], right + noise[1], plane, start)[:, 0]) / plane[1])
    assert 0.95 < shares[0] < 1.05
    assert shares[0] > shares[1] > shares[2]
    assert shares[2] < 0.5


@pytest.mark.parametrize("axis", [0, 1])
def test_stripes_keep_the_slopes_of_the_neighbours(axis: int) -> None:
    line = gaussian_filter(RANDOM.normal(128, 200, (1, WIDTH) if axis else (HEIGHT, 1)), (0, 2) if axis else (2, 0))
    stripes = np.broadcast_to(line, (HEIGHT, WIDTH)).astype(np.float32).copy()
    start = np.tile([0.05, -0.02], (len(UV), 1))
    plane = (10.0, 0.05, -0.02)
    found = slopes(stripes, right_image(stripes, *plane), plane, start)
    assert np.isfinite(found).all()
    assert np.abs(found - start).max() < PRIOR_SIGMA


def test_a_patch_that_gives_none_keeps_its_slopes() -> None:
    start = np.tile([0.3, -0.2], (4, 1))
    flat = np.full((HEIGHT, WIDTH), 90.0, np.float32)
    patches = cut_patches(TEXTURE, UV[:4], HALF)
    outside, inside = np.tile([2.0, 40.0], (4, 1)), UV[:4]
    for image, patch, right in (
        (TEXTURE, patches, outside),
        (TEXTURE, patches, np.full((4, 2), np.nan)),
        (flat, patches, inside),
        (TEXTURE, cut_patches(flat, UV[:4], HALF), inside),
    ):
        np.testing.assert_array_equal(refine_slopes(image, patch, right, start), start)

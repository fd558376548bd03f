"""Sparse stereo on a texture whose disparities are known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from sfr_loc_map.localisation.frontend.image_pyramid import build_pyramid
from sfr_loc_map.localisation.frontend.sparse_stereo import StereoMatches, match_corners

HEIGHT, WIDTH = 160, 240
LEFT = np.clip(gaussian_filter(np.random.default_rng(0).normal(128, 400, (HEIGHT, WIDTH)), 2.0), 0, 255)
UV = np.stack(np.meshgrid(np.arange(70, 210, 14.0), np.arange(30, 135, 14.0)), axis=-1).reshape(-1, 2)


def right_image(a: float, b: float, c: float, rows: float = 0.0) -> np.ndarray:
    """Return the right image of the plane `disparity = a + b u + c v` in left pixels, lower by some rows."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    v -= rows
    return map_coordinates(LEFT, [v, (u + a + c * v) / (1.0 - b)], order=3, mode="nearest")


def match(right: np.ndarray, rows: float = 0.0) -> StereoMatches:
    pyramids = [build_pyramid(np.rint(np.clip(image, 0, 255)).astype(np.uint8)) for image in (LEFT, right)]
    return match_corners(*pyramids, UV, np.zeros((0, 3)), 40.0, rows)


@pytest.mark.parametrize(("a", "b", "c"), [(12.3, 0.0, 0.0), (9.0, 0.03, 0.05), (20.0, -0.04, -0.03)])
def test_disparities_and_slopes_of_a_plane_are_found(a: float, b: float, c: float) -> None:
    found = match(right_image(a, b, c))
    assert len(found.uv) > 0.8 * len(UV)
    expected = a + b * found.uv[:, 0] + c * found.uv[:, 1]
    assert np.percentile(np.abs(found.disparity - expected), 90) < 0.06
    assert np.abs(found.disparity - expected).max() < 0.3
    np.testing.assert_allclose(np.median(found.slope, axis=0), [b, c], atol=0.006)


def test_vertical_disparity_is_measured_around_what_is_known() -> None:
    found = match(right_image(12.0, 0.0, 0.0, rows=2.4), rows=2.0)
    assert len(found.uv) > 0.8 * len(UV)
    assert np.median(found.right[:, 1] - found.uv[:, 1]) == pytest.approx(2.4, abs=0.03)


def test_covariance_is_that_of_many_noisy_pairs() -> None:
    random, sigma, right = np.random.default_rng(1), 2.0, right_image(12.0, 0.0, 0.0)
    errors: dict[tuple[float, float], list[float]] = {}
    predicted: dict[tuple[float, float], float] = {}
    for _ in range(40):
        found = match(right + random.normal(0, sigma, right.shape))
        for uv, disparity, covariance in zip(found.uv, found.disparity, found.covariance, strict=True):
            errors.setdefault(tuple(uv), []).append(disparity)
            predicted[tuple(uv)] = covariance[0]
    ratios = [np.var(values) / sigma**2 / predicted[uv] for uv, values in errors.items() if len(values) > 30]
    # the smoothing of the pyramid leaves a part of the noise of single pixels
    assert 0.3 < np.median(ratios) < 1.5


def test_images_that_differ_give_no_matches() -> None:
    other = np.clip(gaussian_filter(np.random.default_rng(9).normal(128, 400, (HEIGHT, WIDTH)), 2.0), 0, 255)
    assert len(match(other).uv) <= 2
    assert not len(match(np.full((HEIGHT, WIDTH), 90.0)).uv)


def test_matches_on_the_mask_are_left_out() -> None:
    found, mask = match(right_image(12.3, 0.0, 0.0)), np.ones((HEIGHT, WIDTH), np.uint8)
    mask[:, :120] = 0
    kept = found.outside(mask)
    assert 0 < len(kept.uv) < len(found.uv)
    assert kept.right[:, 0].min() >= 119.5
    assert found.outside(None) is found

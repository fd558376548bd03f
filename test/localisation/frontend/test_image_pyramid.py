"""Pyramid levels by their definition."""

from itertools import pairwise

import numpy as np
from scipy.ndimage import correlate1d

from sfr_loc_map.localisation.frontend.image_pyramid import LEVELS, build_pyramid

IMAGE = np.random.default_rng(0).integers(0, 256, (83, 130), np.uint8)


def test_level_0_is_the_image_smoothed_by_a_gaussian() -> None:
    kernel = np.exp(-0.5 * (np.arange(-1, 2) / 0.5) ** 2)
    kernel /= kernel.sum()
    smooth = correlate1d(correlate1d(IMAGE.astype(float), kernel, 0, mode="mirror"), kernel, 1, mode="mirror")
    np.testing.assert_allclose(build_pyramid(IMAGE).levels[0], smooth, atol=1e-3)


def test_each_next_level_is_the_mean_of_2_by_2_pixels() -> None:
    levels = build_pyramid(IMAGE).levels
    assert len(levels) == LEVELS
    for fine, coarse in pairwise(levels):
        height, width = (size // 2 for size in fine.shape)
        blocks = fine[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
        np.testing.assert_allclose(coarse, blocks.mean(axis=(1, 3)), atol=1e-3)


def test_a_level_knows_its_scale() -> None:
    pyramid = build_pyramid(IMAGE)
    assert [pyramid.level(number).scale for number in range(LEVELS)] == [1.0, 2.0, 4.0, 8.0]
    assert pyramid.level(2).image is pyramid.levels[2]

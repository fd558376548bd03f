"""Regions of the image that do not move with the ground."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from sfr_loc_map.localisation.frontend.foreign_regions import FIXED_LIFE, ForeignRegions, fixed_correlation, stays
from sfr_loc_map.localisation.frontend.patch import HALF, SIDE, cut_patches

UV = np.array([[40.0, 30.0], [90.0, 60.0]])


def image(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(100, 140)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return 100 + 30 * smooth / smooth.std()


def cut(source: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(cut_patches(source, UV, HALF)[:, 0])


def added(source: np.ndarray, *, fixed: bool) -> ForeignRegions:
    regions = ForeignRegions((100, 140), 200)
    regions.update(source.astype(np.uint8), source)
    regions.add(UV, np.full(2, fixed), cut(source), np.array([True, True]))
    return regions


def test_correlation_is_that_of_numpy() -> None:
    first, second = image(), image() + 0.5 * image(1)
    found = fixed_correlation(second, cut(first), UV)
    for patch, uv, correlation in zip(cut(first), UV.astype(int), found, strict=True):
        here, best = (
            [
                np.corrcoef(patch, second[v - HALF : v + HALF + 1, u - HALF : u + HALF + 1].ravel())[0, 1]
                for u, v in uv + shifts
            ]
            for shifts in (np.array([[0, 0]]), np.array([[3, 0], [-3, 0], [0, 3], [0, -3]]))
        )
        np.testing.assert_allclose(correlation, [here[0], max(best)], atol=1e-5)


def test_what_moved_or_lies_at_the_edge_does_not_stay() -> None:
    source = image()
    assert stays(source, cut(source), UV).all()
    assert stays(0.5 * source + 40, cut(source), UV).all()  # brightness and contrast do not count
    assert not stays(np.roll(source, 2, axis=1), cut(source), UV).any()
    np.testing.assert_array_equal(fixed_correlation(source, cut(source), UV - [UV[0, 0], 0])[0], [-1.0, -1.0])


def test_a_straight_edge_says_nothing() -> None:
    edge = np.repeat(image()[:, :1], 140, axis=1)
    assert not stays(edge, cut(edge), UV).any()


def test_a_fixed_region_lasts_as_long_as_its_texture() -> None:
    source = image()
    regions = added(source, fixed=True)
    assert regions.mask is not None
    assert regions.mask[30, 40] == 0
    assert regions.mask[5, 5] == 255
    for _ in range(2 * FIXED_LIFE):
        regions.update(source.astype(np.uint8), source)
    assert 0.05 < regions.share < 0.3
    for _ in range(FIXED_LIFE):
        regions.update(image(1).astype(np.uint8), image(1))
    assert regions.mask is None
    assert regions.share == 0.0


@pytest.mark.parametrize("step", [3, -4])
def test_a_moving_region_is_carried_on(step: int) -> None:
    source = image()
    regions = added(source, fixed=False)
    moved = np.roll(source, step, axis=1)
    regions.update(moved.astype(np.uint8), moved)
    assert regions.mask is not None
    column = np.flatnonzero(regions.mask[30, :65] == 0).mean()
    assert column == pytest.approx(40 + step, abs=0.6)
    for _ in range(10):
        regions.update(moved.astype(np.uint8), moved)
    assert regions.mask is None


def test_patches_have_the_size_of_landmarks() -> None:
    assert cut(image()).shape == (2, SIDE * SIDE)

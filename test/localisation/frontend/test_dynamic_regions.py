"""Regions of the image that do not move with the ground, and landmarks that a pose does not explain."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from sfr_loc_map.localisation.frontend.dynamic_regions import FIXED_LIFE, DynamicRegions, fixed_correlation, stays
from sfr_loc_map.localisation.frontend.patch import HALF, cut_patches

UV = np.array([[40.0, 30.0], [90.0, 60.0]])


def image(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(100, 140)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return 100 + 30 * smooth / smooth.std()


def cut(source: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(cut_patches(source, UV, HALF)[:, 0])


def added(source: np.ndarray, *, fixed: bool) -> DynamicRegions:
    regions = DynamicRegions((100, 140), 200)
    regions.add(source.astype(np.uint8), UV, np.full(2, fixed), cut(source))
    return regions


def test_what_moved_or_lies_at_the_edge_or_on_a_straight_edge_does_not_stay() -> None:
    source = image()
    assert stays(source, cut(source), UV).all()
    assert stays(0.5 * source + 40, cut(source), UV).all()  # brightness and contrast do not count
    assert not stays(np.roll(source, 2, axis=1), cut(source), UV).any()
    np.testing.assert_array_equal(fixed_correlation(source, cut(source), UV - [UV[0, 0], 0])[0], [-1.0, -1.0])
    edge = np.repeat(source[:, :1], 140, axis=1)
    assert not stays(edge, cut(edge), UV).any()


def test_a_fixed_region_lasts_as_long_as_its_texture() -> None:
    source = image()
    regions = added(source, fixed=True)
    assert regions.mask is not None
    assert (regions.mask[30, 40], regions.mask[5, 5]) == (0, 255)
    for _ in range(2 * FIXED_LIFE):
        regions.update(source.astype(np.uint8), source)
    assert 0.05 < regions.share < 0.3
    for _ in range(FIXED_LIFE):
        regions.update(image(1).astype(np.uint8), image(1))
    assert (regions.mask, regions.share) == (None, 0.0)


@pytest.mark.parametrize("step", [3, -4])
def test_a_moving_region_is_carried_on(step: int) -> None:
    source = image()
    regions, moved = added(source, fixed=False), np.roll(source, step, axis=1)
    regions.update(moved.astype(np.uint8), moved)
    assert regions.mask is not None
    assert np.flatnonzero(regions.mask[30, :65] == 0).mean() == pytest.approx(40 + step, abs=0.6)
    for _ in range(10):
        regions.update(moved.astype(np.uint8), moved)
    assert regions.mask is None

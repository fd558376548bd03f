"""Occlusion on a two-plane scene where it is known; matching costs against plain numpy."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.occlusion import (
    LARGE,
    MAX_DIFFERENCE,
    SupportWeights,
    matching_cost_margin,
    occlusion_mask,
)

F = np.float32
ROWS, COLS = 40, 120
NEAR, FAR = 14.0, 6.0
BLOCK = np.s_[10:30, 60:90]
JUMP = F(1.0)


def two_planes() -> np.ndarray:
    """Return the disparity of a block before a background."""
    disparity = np.full((ROWS, COLS), FAR, F)
    disparity[BLOCK] = NEAR
    return disparity


def test_the_background_left_of_the_block_is_occluded() -> None:
    """The block covers columns 46-75 of the right image; there the background of columns 52-81 would be."""
    expected = np.zeros((ROWS, COLS), bool)
    expected[:, : int(FAR)] = True
    expected[10:30, 52:60] = True
    disparity = two_planes()
    np.testing.assert_array_equal(occlusion_mask(disparity, np.ones_like(expected), JUMP), expected)


def test_invalid_surfaces_occlude_nothing() -> None:
    valid = np.ones((ROWS, COLS), bool)
    valid[BLOCK] = False
    hidden = occlusion_mask(two_planes(), valid, JUMP)
    assert not hidden[:, int(FAR) :].any()


def test_a_surface_nearer_by_less_than_the_jump_does_not_occlude() -> None:
    valid = np.ones((ROWS, COLS), bool)
    hidden = occlusion_mask(two_planes(), valid, F(NEAR - FAR + 0.5))
    assert not hidden[:, int(NEAR) :].any()


@pytest.fixture(scope="module")
def images() -> tuple[np.ndarray, np.ndarray]:
    """Random dots of the two planes."""
    rng = np.random.default_rng(0)
    background = rng.integers(0, 256, (ROWS, COLS + 40)).astype(F)
    block = rng.integers(0, 256, (20, 30)).astype(F)
    left, right = background[:, :COLS].copy(), background[:, int(FAR) : COLS + int(FAR)].copy()
    left[BLOCK] = block
    right[10:30, 60 - int(NEAR) : 90 - int(NEAR)] = block
    return left, right


SUPPORT = SupportWeights(
    np.exp(-np.arange(256.0) / 20.0).astype(F), np.exp(-np.hypot(*np.mgrid[-2:3, -2:3]) / 3.0).astype(F)
)


def margins(images: Any, disparity: np.ndarray, **masks: np.ndarray) -> np.ndarray:
    everywhere = np.ones(disparity.shape, bool)
    matched, queried = (masks.get(name, everywhere) for name in ("matched", "queried"))
    return matching_cost_margin(*images, disparity, matched, queried, SUPPORT)


def test_pixels_prefer_their_own_surface(images: Any) -> None:
    margin = margins(images, two_planes())
    inside_edge, outside_edge = margin[12:28, 60:62], margin[12:28, 90:92]
    assert inside_edge.min() > 0.0
    assert outside_edge.min() > 0.0
    assert (margin[:5] == LARGE).mean() > 0.9


def test_pixels_of_the_wrong_surface_prefer_the_other(images: Any) -> None:
    disparity = two_planes()
    disparity[10:30, 90:93] = NEAR
    assert np.median(margins(images, disparity)[12:28, 90:93]) < -5.0


def test_pixels_that_are_not_queried_are_left_out(images: Any) -> None:
    queried = np.zeros((ROWS, COLS), bool)
    queried[15, 60] = True
    margin = margins(images, two_planes(), queried=queried)
    assert (margin[~queried] == LARGE).all()
    assert margin[15, 60] < LARGE


def cost(left: np.ndarray, right: np.ndarray, y: int, x: int, disparity: float) -> float:
    """Return the weighted mean truncated absolute difference, in plain numpy."""
    grid = np.arange(COLS)
    total = weights = 0.0
    for dy in range(-2, 3):
        row = np.interp(grid - disparity, grid, right[y + dy])
        for dx in range(-2, 3):
            weight = SUPPORT.by_grey[int(abs(left[y + dy, x + dx] - left[y, x]))] * SUPPORT.by_distance[dy + 2, dx + 2]
            total += weight * min(abs(row[x + dx] - left[y + dy, x + dx]), MAX_DIFFERENCE)
            weights += weight
    return total / weights


@pytest.mark.parametrize(("y", "x"), [(15, 60), (20, 91), (12, 58)])
def test_the_margin_is_the_difference_of_two_costs(images: Any, y: int, x: int) -> None:
    disparity = two_planes() + F(0.25)
    own = float(disparity[y, x])
    other = NEAR + FAR + 0.5 - own
    expected = cost(*images, y, x, other) - cost(*images, y, x, own)
    assert margins(images, disparity)[y, x] == pytest.approx(expected, rel=1e-4, abs=1e-3)

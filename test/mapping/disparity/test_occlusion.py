"""Occlusion on a two-plane scene where it is known."""

import numpy as np

from sfr_loc_map.mapping.disparity.occlusion import occlusion_mask

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

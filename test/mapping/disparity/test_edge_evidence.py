"""Figures of pixels beside a jump, on two planes of random dots: the network doubts what is wrong."""

import numpy as np
from disparity_world import two_planes

from sfr_loc_map.mapping.disparity.edge_evidence import EdgeScene, wrong_surface_log_odds
from sfr_loc_map.mapping.disparity.validity import MAX_LOG_ODDS, beside_jump

F = np.float32
ROWS, COLS = 40, 120
NEAR, FAR = 14.0, 6.0
BLOCK = np.s_[10:30, 60:90]
LEFT, RIGHT, TRUTH = two_planes((ROWS, COLS), BLOCK, int(NEAR), int(FAR), 3.0)
LEFT, RIGHT = LEFT.astype(F), RIGHT.astype(F)


def scene(disparity: np.ndarray, matched: np.ndarray | None = None) -> EdgeScene:
    everywhere = np.ones(disparity.shape, bool)
    sigma = np.full(disparity.shape, F(0.8))  # common beside jumps
    return EdgeScene(LEFT, RIGHT, disparity, everywhere if matched is None else matched, sigma)


def test_pixels_with_the_disparity_of_the_other_surface_are_doubted() -> None:
    """Right of the block both cameras see the background; there three columns are given the block's disparity."""
    wrong = TRUTH.copy()
    wrong[10:30, 90:93] = NEAR
    odds = {}
    for name, disparity in (("right", TRUTH), ("wrong", wrong)):
        found = np.full(ROWS * COLS, F(np.nan))
        chosen = np.flatnonzero(beside_jump(disparity))
        found[chosen] = wrong_surface_log_odds(scene(disparity), chosen)
        odds[name] = found.reshape(ROWS, COLS)[14:26, 90:93]
    assert np.median(odds["right"]) < 0.0
    assert np.median(odds["wrong"]) > MAX_LOG_ODDS

"""Figures of pixels beside a jump, on two planes of random dots, against plain numpy; the network and its training."""

import numpy as np
import pytest
from disparity_world import two_planes

from sfr_loc_map.mapping.disparity.edge_evidence import (
    LARGE,
    MAX_DIFFERENCE,
    NEIGHBOURHOOD,
    WEIGHT_BY_DISTANCE,
    WEIGHT_BY_GREY,
    EdgeScene,
    edge_figures,
    wrong_surface_log_odds,
)
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


def cost(y: int, x: int, disparity: float) -> list[float]:
    """Return the costs of a pixel, by the weights of the left image, of both, and of its neighbours, and its worth."""
    grid, radius = np.arange(COLS), 4
    window = np.s_[y - radius : y + radius + 1, x - radius : x + radius + 1]
    value = np.stack([np.interp(grid - disparity, grid, row) for row in RIGHT[window[0]]])[:, window[1]]
    difference = np.minimum(np.abs(value - LEFT[window]), MAX_DIFFERENCE)
    weight = WEIGHT_BY_GREY[np.abs(LEFT[window] - LEFT[y, x]).astype(int)] * WEIGHT_BY_DISTANCE
    both = weight * WEIGHT_BY_GREY[np.abs(value - value[radius, radius]).astype(int)]
    ratios = [(w * difference).sum() / w.sum() for w in (weight, both)]
    return [*ratios, difference[3:6, 3:6].mean(), weight.sum() ** 2 / np.square(weight).sum()]


@pytest.mark.parametrize(("y", "x"), [(15, 60), (20, 91), (12, 58)])
def test_costs_and_margins_are_those_of_plain_numpy(y: int, x: int) -> None:
    disparity = TRUTH + F(0.25)
    own = float(disparity[y, x])
    mine, other = cost(y, x, own), cost(y, x, NEAR + FAR + 0.5 - own)
    found = edge_figures(scene(disparity), places((y, x)))[0]
    np.testing.assert_allclose(found[:3], np.subtract(other, mine)[:3], rtol=1e-3, atol=2e-3)
    np.testing.assert_allclose(found[3:7], [mine[3], *mine[:3]], rtol=1e-3, atol=2e-3)
    assert found[7] == NEAR + FAR + 0.5 - 2.0 * own


def places(*pixels: tuple[int, int]) -> np.ndarray:
    return np.array([y * COLS + x for y, x in pixels])


def test_surroundings_of_a_pixel_beside_the_block() -> None:
    """Two columns left of the block; its row's background is hidden from column 52 on."""
    found = edge_figures(scene(TRUTH), places((20, 58), (5, 30)))
    none = NEIGHBOURHOOD + 2
    assert found[0, 8] == pytest.approx(LEFT[17:24, 55:62].std(), rel=1e-4)
    # the columns of the block that claim it are farther than is looked
    np.testing.assert_allclose(found[0, 9:14], [2, 5 / 7, none, 2, 0.0], rtol=1e-6)
    assert found[1, 0] == LARGE
    assert found[1, 9:14].tolist() == [none, 1.0, none, none, 0.0]
    nearer = TRUTH.copy()
    nearer[BLOCK] = FAR + 4.0  # column 58 and the block's column 66 meet in column 52 of the right image
    assert edge_figures(scene(nearer), places((20, 58)))[0, 13] == 4.0
    matched = np.ones((ROWS, COLS), bool)
    matched[BLOCK] = False
    assert edge_figures(scene(TRUTH, matched), places((20, 58)))[0, 0] == LARGE


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

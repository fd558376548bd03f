"""Figures of pixels beside a jump, on two planes of random dots, against plain numpy; the network and its training."""

from typing import Any

import numpy as np
import pytest

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


def two_planes() -> np.ndarray:
    """Return the disparity of a block before a background."""
    disparity = np.full((ROWS, COLS), FAR, F)
    disparity[BLOCK] = NEAR
    return disparity


@pytest.fixture(scope="module")
def images() -> tuple[np.ndarray, np.ndarray]:
    """Random dots of the two planes, with noise."""
    rng = np.random.default_rng(0)
    background = rng.integers(0, 256, (ROWS, COLS + 40)).astype(F)
    block = rng.integers(0, 256, (20, 30)).astype(F)
    left, right = background[:, :COLS].copy(), background[:, int(FAR) : COLS + int(FAR)].copy()
    left[BLOCK] = block
    right[10:30, 60 - int(NEAR) : 90 - int(NEAR)] = block
    noisy = [np.clip(np.rint(image + rng.normal(0.0, 3.0, image.shape)), 0, 255).astype(F) for image in (left, right)]
    return noisy[0], noisy[1]


def scene(images: Any, disparity: np.ndarray, matched: np.ndarray | None = None) -> EdgeScene:
    everywhere = np.ones(disparity.shape, bool)
    sigma = np.full(disparity.shape, F(0.8))  # common beside jumps
    return EdgeScene(*images, disparity, everywhere if matched is None else matched, sigma)


def places(*pixels: tuple[int, int]) -> np.ndarray:
    return np.array([y * COLS + x for y, x in pixels])


def cost(left: np.ndarray, right: np.ndarray, y: int, x: int, disparity: float) -> dict[str, float]:
    """Return the costs of a pixel, in plain numpy."""
    grid, radius = np.arange(COLS), 4
    rows = [np.interp(grid - disparity, grid, right[y + dy]) for dy in range(-radius, radius + 1)]
    one, both, close, worth = [], [], [], []
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            value = rows[dy + radius][x + dx]
            difference = min(abs(value - left[y + dy, x + dx]), MAX_DIFFERENCE)
            weight = WEIGHT_BY_GREY[int(abs(left[y + dy, x + dx] - left[y, x]))]
            weight *= WEIGHT_BY_DISTANCE[dy + radius, dx + radius]
            other = weight * WEIGHT_BY_GREY[int(abs(value - rows[radius][x]))]
            one.append((weight, weight * difference))
            both.append((other, other * difference))
            worth.append(weight)
            if max(abs(dy), abs(dx)) <= 1:
                close.append(difference)
    ratio = [sum(item[1] for item in items) / sum(item[0] for item in items) for items in (one, both)]
    return {
        "left": ratio[0],
        "both": ratio[1],
        "close": float(np.mean(close)),
        "worth": sum(worth) ** 2 / sum(w * w for w in worth),
    }


@pytest.mark.parametrize(("y", "x"), [(15, 60), (20, 91), (12, 58)])
def test_costs_and_margins_are_those_of_plain_numpy(images: Any, y: int, x: int) -> None:
    disparity = two_planes() + F(0.25)
    own = float(disparity[y, x])
    mine, other = cost(*images, y, x, own), cost(*images, y, x, NEAR + FAR + 0.5 - own)
    found = edge_figures(scene(images, disparity), places((y, x)))[0]
    names = ("left", "both", "close")
    np.testing.assert_allclose(found[:3], [other[n] - mine[n] for n in names], rtol=1e-3, atol=2e-3)
    np.testing.assert_allclose(found[3:7], [mine[n] for n in ("worth", *names)], rtol=1e-3, atol=2e-3)
    assert found[7] == NEAR + FAR + 0.5 - 2.0 * own


def test_surroundings_of_a_pixel_beside_the_block(images: Any) -> None:
    """Two columns left of the block; its row's background is hidden from column 52 on."""
    found = edge_figures(scene(images, two_planes()), places((20, 58), (5, 30)))
    none = NEIGHBOURHOOD + 2
    assert found[0, 8] == pytest.approx(images[0][17:24, 55:62].std(), rel=1e-4)
    # the columns of the block that claim it are farther than is looked
    np.testing.assert_allclose(found[0, 9:14], [2, 5 / 7, none, 2, 0.0], rtol=1e-6)
    assert found[1, 0] == LARGE
    assert found[1, 9:14].tolist() == [none, 1.0, none, none, 0.0]
    nearer = two_planes()
    nearer[BLOCK] = FAR + 4.0  # column 58 and the block's column 66 meet in column 52 of the right image
    assert edge_figures(scene(images, nearer), places((20, 58)))[0, 13] == 4.0
    matched = np.ones((ROWS, COLS), bool)
    matched[BLOCK] = False
    assert edge_figures(scene(images, two_planes(), matched), places((20, 58)))[0, 0] == LARGE


def test_pixels_with_the_disparity_of_the_other_surface_are_doubted(images: Any) -> None:
    """Right of the block both cameras see the background; there three columns are given the block's disparity."""
    right, wrong = two_planes(), two_planes()
    wrong[10:30, 90:93] = NEAR
    odds = {}
    for name, disparity in (("right", right), ("wrong", wrong)):
        found = np.full(ROWS * COLS, F(np.nan))
        chosen = np.flatnonzero(beside_jump(disparity))
        found[chosen] = wrong_surface_log_odds(scene(images, disparity), chosen)
        odds[name] = found.reshape(ROWS, COLS)[14:26, 90:93]
    assert np.median(odds["right"]) < 0.0
    assert np.median(odds["wrong"]) > MAX_LOG_ODDS

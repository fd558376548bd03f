"""Corners against a brute-force reference."""

import numpy as np
import pytest
from scipy.ndimage import convolve, gaussian_filter, uniform_filter

from sfr_loc_map.localisation.frontend.feature_detection import BLOCK, find_corners

BORDER = 10


def texture(seed: int = 0) -> np.ndarray:
    return gaussian_filter(np.random.default_rng(seed).normal(128, 300, (120, 160)), 1.5).astype(np.float32)


def strength_of(image: np.ndarray) -> np.ndarray:
    """Return the smaller eigenvalue of the gradient matrix at each pixel, by numpy."""
    sobel = np.array([[1.0, 0.0, -1.0], [2.0, 0.0, -2.0], [1.0, 0.0, -1.0]])
    dx, dy = convolve(image.astype(float), sobel), convolve(image.astype(float), sobel.T)
    sums = [uniform_filter(p, BLOCK) * BLOCK**2 for p in (dx * dx, dx * dy, dy * dy)]
    return np.linalg.eigvalsh(np.stack((sums[0], sums[1], sums[1], sums[2]), -1).reshape(*image.shape, 2, 2))[..., 0]


@pytest.mark.parametrize("seed", [0, 1])
def test_corners_are_the_strongest_of_each_cell_strongest_first(seed: int) -> None:
    image, wanted = texture(seed), 60
    strength, side = strength_of(image), max(8, int(np.sqrt(120 * 160 / wanted)))
    expected = []
    for top in range(0, 120, side):
        for left in range(0, 160, side):
            rows = slice(max(top, BORDER), min(top + side, 120 - BORDER))
            columns = slice(max(left, BORDER), min(left + side, 160 - BORDER))
            cell = strength[rows, columns]
            if cell.size:
                v, u = np.unravel_index(cell.argmax(), cell.shape)
                expected.append((cell.max(), columns.start + u, rows.start + v))
    floor = 0.04 * np.median([value for value, *_ in expected])
    expected = sorted((item for item in expected if item[0] > floor), reverse=True)
    found = find_corners(image, np.zeros((0, 2)), wanted, BORDER)
    assert found.tolist() == [[u, v] for _, u, v in expected]

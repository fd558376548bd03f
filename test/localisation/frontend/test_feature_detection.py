"""Corners of an image against the smaller eigenvalues of gradient matrices by OpenCV and numpy."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.localisation.frontend.feature_detection import (
    BLOCK,
    MIN_DISTANCE_RATIO,
    MIN_STRENGTH_RATIO,
    find_corners,
)

BORDER = 9
IMAGE = cv2.GaussianBlur(np.random.default_rng(0).normal(100.0, 60.0, (90, 130)).astype(np.float32), (0, 0), 1.5)
NOTHING = np.zeros((0, 2))


def strength_of(image: FloatImage) -> FloatArray:
    """Return the smaller eigenvalue of the gradient matrix of the block around each pixel."""
    dx, dy = (cv2.Sobel(image.astype(float), cv2.CV_64F, *order) for order in ((1, 0), (0, 1)))
    xx, xy, yy = (
        cv2.boxFilter(product, -1, (BLOCK, BLOCK), normalize=False) for product in (dx * dx, dx * dy, dy * dy)
    )
    return np.asarray(0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy))


def corners_of(image: FloatImage, side: int, mask: Mask, occupied: FloatArray) -> set[tuple[int, int]]:
    """Return the strongest pixel of each cell that is strong enough and far from occupied pixels."""
    strength = np.where(mask, strength_of(image), 0.0)
    height, width = image.shape
    strength[:BORDER] = strength[height - BORDER :] = strength[:, :BORDER] = strength[:, width - BORDER :] = 0.0
    found = []
    for y in range(0, height, side):
        for x in range(0, width, side):
            cell = strength[y : y + side, x : x + side]
            row, column = np.unravel_index(cell.argmax(), cell.shape)
            corner = np.array([x + column, y + row], float)
            is_near = np.linalg.norm(occupied - corner, axis=1) < MIN_DISTANCE_RATIO * side
            if cell.max() > 0.0 and not is_near.any():
                found.append((cell.max(), tuple(corner.astype(int).tolist())))
    least = MIN_STRENGTH_RATIO * np.median([strength for strength, _ in found])
    return {corner for strength, corner in found if strength > least}


@pytest.mark.parametrize("wanted", [40, 100])
@pytest.mark.parametrize("is_masked", [False, True])
def test_corners_are_the_strongest_pixels_of_the_cells(wanted: int, is_masked: bool) -> None:
    mask = np.ones(IMAGE.shape, np.bool_)
    if is_masked:
        mask[20:60, 30:80] = False
    side = int(np.sqrt(IMAGE.size / wanted))
    expected = corners_of(IMAGE, side, mask, NOTHING)
    occupied = np.array(sorted(expected)[::5], float) + 1.0  # beside every fifth corner
    for known in (NOTHING, occupied):
        found = find_corners(IMAGE, known, wanted, BORDER, mask.astype(np.uint8) if is_masked else None)
        assert {tuple(corner) for corner in found.astype(int).tolist()} == corners_of(IMAGE, side, mask, known)
    strength = strength_of(IMAGE)
    ordered = find_corners(IMAGE, NOTHING, wanted, BORDER, None).astype(int)
    assert (np.diff(strength[ordered[:, 1], ordered[:, 0]]) < 1e-3 * strength.max()).all()  # strongest first


def test_an_image_without_texture_has_no_corners() -> None:
    assert len(find_corners(np.full((60, 60), 80.0, np.float32), NOTHING, 20, BORDER, None)) == 0

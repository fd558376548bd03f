"""Corners, well spread: the strongest of each cell of a grid."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.rotation import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.localisation.images import FloatImage
from sfr_loc_map.localisation.parallel import both

BLOCK = 7
"""Side of the neighbourhood over which the gradients of a corner are summed, pixels."""
STRIP = 64
"""Rows worked on at a time."""


def find_corners(
    image: FloatImage,
    occupied: FloatArray,
    wanted: int,
    border: int,
    mask: NDArray[np.uint8] | None = None,
) -> FloatArray:
    """Return new corners, one for each cell that has no landmark yet.

    The strength is the smaller eigenvalue of the gradient matrix (Shi and Tomasi 1994).

    Args:
        image: `(H, W)` float32.
        occupied: `(M, 2)` pixels that have landmarks.
        wanted: Number of cells.
        border: Pixels along the edges that are left out.
        mask: `(H, W)` uint8, 0 where nothing may be found; None for everywhere.

    Returns:
        `(N, 2)` float64, whole pixels, the strongest first.
    """
    strength = _strength(image)
    if mask is not None:
        strength[mask == 0] = 0.0
    height, width = image.shape
    side = max(8, int(np.sqrt(height * width / wanted)))
    best = _strongest(strength, side, border)
    best = best[_free(best, occupied, 0.6 * side)]
    if not len(best):
        return np.zeros((0, 2))
    # a cell without texture answers with noise: a small share of what the ordinary cell has is asked for
    floor = 0.04 * np.median(best[:, 2])
    best = best[best[:, 2] > floor]
    order = np.argsort(-best[:, 2], kind="stable")
    return np.ascontiguousarray(best[order, :2])


def load_mask(path: str, rig: StereoRig) -> NDArray[np.uint8] | None:
    """Read a mask picture; corners keep a patch's width away from where it is 0.

    Args:
        path: Picture file, empty for no mask.
        rig: Rig whose size it must have.

    Returns:
        `(H, W)` uint8, or None.

    Raises:
        ConfigError: If it cannot be read or has another size.
    """
    if not path:
        return None
    mask = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    if mask is None or mask.shape != (rig.height, rig.width):
        found = "nothing that can be read" if mask is None else f"{mask.shape[1]} x {mask.shape[0]} pixels"
        raise ConfigError(f"mask '{path}': {found}; give a grey picture of {rig.width} x {rig.height} pixels")
    return np.asarray(cv2.erode(mask, np.ones((2 * BLOCK + 1, 2 * BLOCK + 1), np.uint8)), dtype=np.uint8)


def _strength(image: FloatImage) -> FloatImage:
    """Return the smaller eigenvalue at each pixel: strip by strip, so that what is worked on stays in the cache."""
    strength = np.empty_like(image)
    height, reach = len(image), BLOCK // 2 + 1

    def fill(first: int, end: int) -> None:
        for top in range(first, end, STRIP):
            bottom, above = min(top + STRIP, end), max(top - reach, 0)
            strip = cv2.cornerMinEigenVal(image[above : min(bottom + reach, height)], BLOCK, ksize=3)
            strength[top:bottom] = strip[top - above :][: bottom - top]

    both(fill, (0, height // 2), (height // 2, height))
    return strength


@njit(cache=True)
def _strongest(strength: FloatImage, side: int, border: int) -> FloatArray:
    height, width = strength.shape
    rows, columns = -(-height // side), -(-width // side)
    best = np.zeros((rows * columns, 3))
    for row in range(rows):
        for column in range(columns):
            cell = row * columns + column
            for y in range(max(border, row * side), min(height - border, row * side + side)):
                for x in range(max(border, column * side), min(width - border, column * side + side)):
                    if strength[y, x] > best[cell, 2]:
                        best[cell, 0], best[cell, 1], best[cell, 2] = x, y, strength[y, x]
    return best[best[:, 2] > 0.0]


@njit(cache=True)
def _free(found: FloatArray, occupied: FloatArray, distance: float) -> NDArray[np.bool_]:
    free = np.ones(len(found), np.bool_)
    for n in range(len(found)):
        for m in range(len(occupied)):
            du, dv = found[n, 0] - occupied[m, 0], found[n, 1] - occupied[m, 1]
            if du * du + dv * dv < distance * distance:
                free[n] = False
                break
    return free

"""Feature detection: the strongest corner of each cell of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask, median
from sfr_loc_map.jit import jit, jit_fast
from sfr_loc_map.localisation.small_linalg import copy_row
from sfr_loc_map.parallel import both

BLOCK = 7
"""Side of the neighbourhood over which the gradient matrix of a corner is summed, px. The neighbourhood is smaller than
a patch (11 px), so that the corner is near the centre of the patch."""
MIN_CELL_PX = 8  #: Minimum side of a cell of the grid, px. In smaller cells, neighbouring patches (11 px) overlap more.
MIN_DISTANCE_RATIO = 0.6
"""Minimum ratio of the distance between a new corner and a landmark to the side of a cell. With a larger ratio, the gap
that a lost landmark leaves is not filled. With a smaller value, neighbouring patches share more pixels and thus more
errors."""
MIN_STRENGTH_RATIO = 0.04
"""Minimum ratio of the strength of a corner to the median strength. The strength is a squared gradient, so 0.04 is a
fifth of the median gradient. With a larger ratio, smooth ground beside stones has no landmarks. With a smaller value,
image noise in a textureless cell becomes a landmark."""


def find_corners(
    image: FloatImage, occupied: FloatArray, wanted: int, border: int, mask: NDArray[np.uint8] | None = None
) -> FloatArray:
    """Return new corners `(N, 2)` at whole pixels, strongest first, and at most one for each cell of a grid.

    The strength of a corner is the smaller eigenvalue of the gradient matrix (Shi and Tomasi 1994).

    Args:
        image: Image, `(H, W)`.
        occupied: `(M, 2)` pixels of existing landmarks, near which no corner is returned.
        wanted: Approximate number of cells.
        border: Width of the border without corners, pixels.
        mask: `(H, W)`; corners are not returned where the mask is 0.
    """
    strength = np.zeros_like(image)
    middle = len(image) // 2
    both(_fill_strength, (image, strength, 0, middle), (image, strength, middle, len(image)))
    if mask is not None:
        strength[mask == 0] = 0.0
    height, width = image.shape
    side = max(MIN_CELL_PX, int(np.sqrt(height * width / wanted)))
    rows = -(-height // side)
    corners = np.concatenate(
        both(_strongest, (strength, side, border, 0, rows // 2), (strength, side, border, rows // 2, rows))
    )
    distance = MIN_DISTANCE_RATIO * side
    by_row = np.ascontiguousarray(occupied[np.argsort(occupied[:, 1])])
    first = np.searchsorted(by_row[:, 1], corners[:, 1] - distance)
    corners = corners[_is_far(corners, by_row, first, distance)]
    if not len(corners):
        return np.zeros((0, 2))
    corners = corners[corners[:, 2] > MIN_STRENGTH_RATIO * median(corners[:, 2])]
    return np.ascontiguousarray(corners[np.argsort(-corners[:, 2], kind="stable"), :2])


@jit_fast
def _fill_strength(image: FloatImage, strength: FloatImage, first: int, end: int) -> None:
    """Fill rows of the corner strength from products of Sobel gradients, summed over the block around each pixel.

    The products of the last `BLOCK` rows are kept in a ring buffer, so that the products of a row are computed once.
    """
    height, width = image.shape
    reach = BLOCK // 2
    products = np.zeros((3, BLOCK, width), np.float32)  # xx, xy, yy of the last rows
    column_sums = np.empty((3, width), np.float32)
    block_sums = np.empty((3, width), np.float32)
    two = np.float32(2.0)
    half = np.float32(0.5)
    for row in range(max(first - reach, 1), min(end + reach, height - 1)):
        place = row % BLOCK
        xx = products[0, place]
        xy = products[1, place]
        yy = products[2, place]
        above = image[row - 1]
        here = image[row]
        below = image[row + 1]
        for x in range(1, width - 1):
            dx = above[x + 1] - above[x - 1] + two * (here[x + 1] - here[x - 1]) + below[x + 1] - below[x - 1]
            dy = below[x - 1] - above[x - 1] + two * (below[x] - above[x]) + below[x + 1] - above[x + 1]
            xx[x] = dx * dx
            xy[x] = dx * dy
            yy[x] = dy * dy
        centre = row - reach
        if centre < max(first, 1 + reach):
            continue
        for c in range(3):
            copy_row(products[c, 0], column_sums[c])
            for k in range(1, BLOCK):
                for x in range(width):
                    column_sums[c, x] += products[c, k, x]
            block_sums[c] = 0.0
            for k in range(-reach, reach + 1):
                for x in range(reach, width - reach):
                    block_sums[c, x] += column_sums[c, x + k]
        out = strength[centre]
        for x in range(reach + 1, width - reach - 1):
            mean = half * (block_sums[0, x] + block_sums[2, x])
            split = half * (block_sums[0, x] - block_sums[2, x])
            out[x] = mean - np.sqrt(split * split + block_sums[1, x] * block_sums[1, x])


@jit
def _strongest(strength: FloatImage, side: int, border: int, first: int, end: int) -> FloatArray:
    """Return the strongest pixel of each cell, `(N, 3)` u, v, strength, in the rows of cells from `first` to `end`.

    Cells without a positive strength are skipped.
    """
    height, width = strength.shape
    columns = -(-width // side)
    best = np.zeros(((end - first) * columns, 3))
    for row in range(first, end):
        for column in range(columns):
            cell = best[(row - first) * columns + column]
            for y in range(max(border, row * side), min(height - border, row * side + side)):
                for x in range(max(border, column * side), min(width - border, column * side + side)):
                    if strength[y, x] > cell[2]:
                        cell[0] = x
                        cell[1] = y
                        cell[2] = strength[y, x]
    return best[best[:, 2] > 0.0]


@jit
def _is_far(corners: FloatArray, by_row: FloatArray, first: NDArray[np.intp], distance: float) -> Mask:
    """Return which corners `(N, 3)` are at least a distance, px, away from points `(M, 2)` that are sorted by v.

    For each corner, the points before index `first` `(N,)` are above it by more than the distance.
    """
    is_far = np.ones(len(corners), np.bool_)
    for n in range(len(corners)):
        for m in range(first[n], len(by_row)):
            du = corners[n, 0] - by_row[m, 0]
            dv = corners[n, 1] - by_row[m, 1]
            if dv <= -distance:
                break
            if du * du + dv * dv < distance * distance:
                is_far[n] = False
                break
    return is_far

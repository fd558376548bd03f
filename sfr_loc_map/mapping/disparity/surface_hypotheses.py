"""Which surfaces a pixel without a disparity may belong to, and how well each matches the images."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.occlusion import LARGE, MAX_DIFFERENCE, OTHER_SURFACE_PX

F = np.float32

REACH = 12
"""Rows or columns within which a surface is a hypothesis."""
SLOPE_PX = 2
"""Distance over which a surface's slope is taken, pixels."""
VALID_WEIGHT = F(0.3)
"""Weight in a window of pixels that have a disparity: they would only repeat what they were found to be."""
_DIRECTIONS = np.array([[0, 1], [0, -1], [1, 0], [-1, 0], [1, 1], [-1, -1], [1, -1], [-1, 1]])
"""Rows and columns of a step; opposite directions follow each other."""


class Images(NamedTuple):
    """What is matched.

    Attributes:
        left: `(H, W)`, whole grey levels.
        right: `(H, W)`, grey levels, corrected.
        by_grey: Weights of a window, as in `SupportWeights`.
        by_distance: Likewise.
    """

    left: FloatImage
    right: FloatImage
    by_grey: FloatImage
    by_distance: FloatImage


class Field(NamedTuple):
    """Disparities between two passes.

    Attributes:
        disparity: `(H, W)`, pixels.
        valid: `(H, W)`, whose disparities count as surfaces.
        open: `(H, W)`, which pixels may be filled.
        matched: `(H, W)`, pixels, what the matcher found, NaN for nothing.
        distance: `(H, W)`, rows or columns to a valid pixel.
    """

    disparity: FloatImage
    valid: Mask
    open: Mask
    matched: FloatImage
    distance: FloatImage


class Plane(NamedTuple):
    """A hypothesis: disparity at the pixel, and its slope along rows and columns, pixels for each pixel."""

    disparity: np.float32
    slope_x: np.float32
    slope_y: np.float32


@jit_rows_inline
def _slope(field: Field, y: int, x: int, dy: int, dx: int) -> np.float32:
    """Return the slope of a valid pixel's surface along an axis, from what is valid on either side."""
    rows, cols = field.disparity.shape
    centre = field.disparity[y, x]
    rise, run = F(0.0), F(0.0)
    for side in (-SLOPE_PX, SLOPE_PX):
        v, u = y + side * dy, x + side * dx
        if 0 <= v < rows and 0 <= u < cols and field.valid[v, u]:
            step = field.disparity[v, u] - centre
            if abs(step) < OTHER_SURFACE_PX:
                rise += step if side > 0 else -step
                run += F(SLOPE_PX)
    slope: np.float32 = rise / max(run, F(1.0))
    return slope


@jit_rows_inline
def _hypothesis(field: Field, y: int, x: int, dy: int, dx: int) -> Plane:
    """Return the first surface along a direction, continued to the pixel; NaN if there is none."""
    rows, cols = field.disparity.shape
    s = int(field.distance[y, x])
    while s <= REACH:
        v, u = y + s * dy, x + s * dx
        if not (0 <= v < rows and 0 <= u < cols):
            break
        if not field.valid[v, u]:
            s += int(field.distance[v, u])
        else:
            slope_x, slope_y = _slope(field, v, u, 0, 1), _slope(field, v, u, 1, 0)
            disparity = field.disparity[v, u] - F(s) * (slope_x * F(dx) + slope_y * F(dy))
            return Plane(disparity, slope_x, slope_y)
    return Plane(F(np.nan), F(0.0), F(0.0))


@jit_rows_inline
def plane_cost(images: Images, valid: Mask, y: int, x: int, plane: Plane) -> tuple[np.float32, np.float32]:
    """Return the weighted mean absolute difference around a pixel, grey levels, and how many pixels that is worth."""
    left, right = images.left, images.right
    rows, cols = left.shape
    radius = images.by_distance.shape[0] // 2
    total, weights, squares = F(0.0), F(0.0), F(0.0)
    for v in range(max(0, y - radius), min(rows, y + radius + 1)):
        start = F(x) - plane.disparity - plane.slope_y * F(v - y)
        for u in range(max(0, x - radius), min(cols, x + radius + 1)):
            column = start + (F(1.0) - plane.slope_x) * F(u - x)
            if not (column >= F(0.0) and column < F(cols - 1)):
                continue
            k = int(column)
            value = right[v, k] + (column - F(k)) * (right[v, k + 1] - right[v, k])
            weight = images.by_grey[int(abs(left[v, u] - left[y, x]))]
            weight *= images.by_distance[v - y + radius, u - x + radius]
            weight *= VALID_WEIGHT if valid[v, u] else F(1.0)
            total += weight * min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weights += weight
            squares += weight * weight
    if not weights > F(0.0):
        return LARGE, F(0.0)
    return total / weights, weights * weights / squares


@jit_rows
def own_costs(images: Images, field: Field, chosen: NDArray[np.int64]) -> FloatImage:
    """Return the matching costs `(N,)` of valid pixels, given by their places in the flat image."""
    cols = field.disparity.shape[1]
    out = np.empty(len(chosen), F)
    for n in prange(len(chosen)):
        y, x = chosen[n] // cols, chosen[n] % cols
        plane = Plane(field.disparity[y, x], _slope(field, y, x, 0, 1), _slope(field, y, x, 1, 0))
        out[n] = plane_cost(images, field.valid, y, x, plane)[0]
    return out


@jit_rows_inline
def hypotheses(field: Field, y: int, x: int) -> FloatImage:
    """Return the planes that a pixel meets along each direction `(8, 3)`, as `Plane`."""
    found = np.empty((8, 3), F)
    for k in range(8):
        plane = _hypothesis(field, y, x, _DIRECTIONS[k, 0], _DIRECTIONS[k, 1])
        found[k, 0], found[k, 1], found[k, 2] = plane.disparity, plane.slope_x, plane.slope_y
    return found

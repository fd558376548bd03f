"""Which pixels the right camera does not see, and which surface pixels beside an edge belong to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32

NEIGHBOURHOOD = 3
"""Half side of the neighbourhood in which other surfaces are searched, pixels."""
OTHER_SURFACE_PX = F(1.0)
"""Disparities that differ by less belong to one surface."""
MAX_DIFFERENCE = F(30.0)
"""Absolute differences of grey level are truncated to this."""
LARGE = F(1e9)


class SupportWeights(NamedTuple):
    """Adaptive support weights (Yoon and Kweon 2006).

    Attributes:
        by_grey: `(256,)` float32, by the difference of grey level from the centre.
        by_distance: `(2 r + 1, 2 r + 1)` float32, by the position in the window.
    """

    by_grey: FloatImage
    by_distance: FloatImage


@jit_rows
def occlusion_mask(disparity: FloatImage, valid: Mask, jump: np.float32) -> Mask:
    """Tell which pixels `(H, W)` the right camera does not see.

    Their corresponding pixel lies outside the right image or behind a valid surface nearer by more than `jump`.
    """
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        nearest = np.full(cols, F(-1.0))
        for x in range(cols):
            u = int(np.rint(F(x) - disparity[y, x]))
            if valid[y, x] and 0 <= u < cols:
                nearest[u] = max(nearest[u], disparity[y, x])
        for x in range(cols):
            u = int(np.rint(F(x) - disparity[y, x]))
            out[y, x] = not (0 <= u < cols) or nearest[u] > disparity[y, x] + jump
    return out


@jit_rows_inline
def _disparity_range(disparity: FloatImage, matched: Mask, y: int, x: int) -> tuple[np.float32, np.float32]:
    """Return the smallest and largest disparity of a pixel and its matched neighbours."""
    rows, cols = disparity.shape
    low = high = disparity[y, x]
    for v in range(max(0, y - NEIGHBOURHOOD), min(rows, y + NEIGHBOURHOOD + 1)):
        for u in range(max(0, x - NEIGHBOURHOOD), min(cols, x + NEIGHBOURHOOD + 1)):
            if matched[v, u]:
                low, high = min(low, disparity[v, u]), max(high, disparity[v, u])
    return low, high


@jit_rows_inline
def _matching_cost(
    left: FloatImage, right: FloatImage, y: int, x: int, disparity: np.float32, support: SupportWeights
) -> np.float32:
    """Return the weighted mean absolute difference over the window of a pixel, grey levels."""
    rows, cols = left.shape
    radius = support.by_distance.shape[0] // 2
    total, weights = F(0.0), F(0.0)
    whole = int(np.floor(disparity))
    part = disparity - F(whole)
    first, last = max(x - radius, whole + 1, 0), min(x + radius, cols - 1 + whole, cols - 1)
    for v in range(max(0, y - radius), min(rows, y + radius + 1)):
        for u in range(first, last + 1):
            value = right[v, u - whole] + part * (right[v, u - whole - 1] - right[v, u - whole])
            weight = support.by_grey[int(abs(left[v, u] - left[y, x]))]
            weight *= support.by_distance[v - y + radius, u - x + radius]
            total += weight * min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weights += weight
    return total / weights if weights > F(0.0) else LARGE


@jit_rows
def matching_cost_margin(
    left: FloatImage, right: FloatImage, disparity: FloatImage, matched: Mask, queried: Mask, support: SupportWeights
) -> FloatImage:
    """Return how much lower the matching cost of a pixel is at its own disparity than at that of a surface beside it.

    The surfaces beside it are the nearest and the farthest among the neighbours. Costs are truncated mean absolute
    differences with adaptive support weights (Yoon and Kweon 2006).

    Args:
        left: `(H, W)` whole grey levels.
        right: `(H, W)` grey, corrected.
        disparity: `(H, W)`, pixels.
        matched: `(H, W)`, whose disparities count as surfaces.
        queried: `(H, W)`, the pixels to compute.
        support: Weights of the window.

    Returns:
        `(H, W)`, grey levels; large where there is no other surface or the pixel is not queried.
    """
    rows, cols = disparity.shape
    out = np.full((rows, cols), LARGE)
    for y in prange(rows):
        for x in range(cols):
            if not queried[y, x]:
                continue
            own = disparity[y, x]
            other_cost = LARGE
            for other in _disparity_range(disparity, matched, y, x):
                if abs(other - own) >= OTHER_SURFACE_PX:
                    other_cost = min(other_cost, _matching_cost(left, right, y, x, other, support))
            out[y, x] = other_cost - _matching_cost(left, right, y, x, own, support)
    return out

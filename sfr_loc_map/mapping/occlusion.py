"""Which pixels the right camera does not see, and which lie beside an edge."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.jit import jit_rows

F = np.float32

BESIDE = 3
"""Half side of the neighbourhood in which other surfaces are looked for, pixels."""
OTHER_PX = F(1.0)
CUT_GREY = F(30.0)
LARGE = F(1e9)


@jit_rows
def hidden_of(disparity: FloatImage, usable: NDArray[np.bool_], jump: np.float32) -> NDArray[np.bool_]:
    """Tell which pixels have their partner outside the right picture or behind a surface nearer by more than `jump`."""
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        nearest = np.full(cols, F(-1.0))
        for x in range(cols):
            place = int(np.rint(F(x) - disparity[y, x]))
            if usable[y, x] and 0 <= place < cols:
                nearest[place] = max(nearest[place], disparity[y, x])
        for x in range(cols):
            place = int(np.rint(F(x) - disparity[y, x]))
            out[y, x] = not (0 <= place < cols) or nearest[place] > disparity[y, x] + jump
    return out


@jit_rows
def evidence(  # noqa: C901 - one pass over the same neighbourhood for three disparities
    left: FloatImage,
    right: FloatImage,
    disparity: FloatImage,
    usable: NDArray[np.bool_],
    asked: NDArray[np.bool_],
    alike: FloatImage,
    near: FloatImage,
) -> FloatImage:
    """Return how much better the pictures agree at a pixel's disparity than at that of a surface beside it.

    The surfaces beside are the nearest and the farthest among the neighbours. Compared are mean absolute differences,
    cut off at `CUT_GREY`, over neighbours weighted by likeness and nearness (Yoon and Kweon 2006).

    Args:
        left: `(H, W)` whole grey levels.
        right: `(H, W)` grey, aligned with the left.
        disparity: `(H, W)`, pixels.
        usable: `(H, W)`, whose disparities count as surfaces beside.
        asked: `(H, W)`, which pixels are asked.
        alike: `(256,)`, weight by difference of grey level.
        near: `(2 r + 1, 2 r + 1)`, weight by place.

    Returns:
        `(H, W)`, grey levels; large where there is no other surface or the pixel is not asked.
    """
    rows, cols = disparity.shape
    reach = near.shape[0] // 2
    out = np.full((rows, cols), LARGE)
    for y in prange(rows):
        for x in range(cols):
            if not asked[y, x]:
                continue
            own = low = high = disparity[y, x]
            for v in range(max(0, y - BESIDE), min(rows, y + BESIDE + 1)):
                for u in range(max(0, x - BESIDE), min(cols, x + BESIDE + 1)):
                    if usable[v, u]:
                        low, high = min(low, disparity[v, u]), max(high, disparity[v, u])
            grey = left[y, x]
            own_cost, other_cost = LARGE, LARGE
            for k in range(3):
                tried = own if k == 0 else (low if k == 1 else high)
                if k > 0 and abs(tried - own) < OTHER_PX:
                    continue
                total, weights = F(0.0), F(0.0)
                whole = int(np.floor(tried))
                part = tried - F(whole)
                first, last = max(x - reach, whole + 1, 0), min(x + reach, cols - 1 + whole, cols - 1)
                for v in range(max(0, y - reach), min(rows, y + reach + 1)):
                    for u in range(first, last + 1):
                        there = right[v, u - whole] + part * (right[v, u - whole - 1] - right[v, u - whole])
                        weight = alike[int(abs(left[v, u] - grey))] * near[v - y + reach, u - x + reach]
                        total += weight * min(abs(there - left[v, u]), CUT_GREY)
                        weights += weight
                cost = total / weights if weights > F(0.0) else LARGE
                if k == 0:
                    own_cost = cost
                else:
                    other_cost = min(other_cost, cost)
            out[y, x] = other_cost - own_cost
    return out

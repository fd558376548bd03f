"""Which pixels of the right image are taken: two surfaces cannot be seen at one of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.occlusion import LARGE, OTHER_SURFACE_PX

F = np.float32

MIN_ALIKE = 5
"""Of the eight pixels around a filled one so many must belong to its surface."""


class Claims(NamedTuple):
    """Smallest and largest disparity `(H, W)` of the pixels that correspond to each pixel of the right image."""

    low: FloatImage
    high: FloatImage


@jit_rows
def right_claims(disparity: FloatImage, valid: Mask) -> Claims:
    """Return which disparities claim each pixel of the right image."""
    rows, cols = disparity.shape
    low, high = np.empty((rows, cols), F), np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            low[y, x], high[y, x] = LARGE, -LARGE
        for x in range(cols):
            if valid[y, x]:
                u = int(np.rint(F(x) - disparity[y, x]))
                if 0 <= u < cols:
                    low[y, u] = min(low[y, u], disparity[y, x])
                    high[y, u] = max(high[y, u], disparity[y, x])
    return Claims(low, high)


@jit_rows_inline
def is_contradicted(disparity: np.float32, claims: Claims, y: int, x: int) -> bool:
    """Tell whether the partner of a pixel lies outside the right image or belongs to another surface."""
    column = F(x) - disparity
    if not (column >= F(0.0) and column < F(claims.low.shape[1] - 1)):
        return True
    u = int(np.rint(column))
    nearer: bool = claims.high[y, u] > disparity + OTHER_SURFACE_PX
    farther: bool = claims.low[y, u] < disparity - OTHER_SURFACE_PX
    return nearer or farther


@jit_rows_inline
def _neighbours_alike(disparity: FloatImage, known: Mask, y: int, x: int) -> int:
    """Return how many of the pixels around belong to the surface of a pixel."""
    rows, cols = disparity.shape
    count = -1
    for v in range(max(0, y - 1), min(rows, y + 2)):
        for u in range(max(0, x - 1), min(cols, x + 2)):
            if known[v, u] and abs(disparity[v, u] - disparity[y, x]) < OTHER_SURFACE_PX:
                count += 1
    return count


@jit_rows
def confirmed(disparity: FloatImage, known: Mask, added: Mask, claims: Claims) -> Mask:
    """Tell which added pixels `(H, W)` are no single ones and have a partner that is no other surface's.

    Args:
        disparity: `(H, W)`, pixels.
        known: `(H, W)`, which are valid or filled.
        added: `(H, W)`, those to test, all of them known.
        claims: Of the known ones.
    """
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        for x in range(cols):
            if added[y, x] and not is_contradicted(disparity[y, x], claims, y, x):
                out[y, x] = _neighbours_alike(disparity, known, y, x) >= MIN_ALIKE
    return out

"""Which pixels the right camera does not see."""

from __future__ import annotations

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_rows

F = np.float32

OTHER_SURFACE_PX = F(1.0)
"""Disparities that differ by less belong to one surface."""
MAX_DIFFERENCE = F(30.0)
"""Absolute differences of grey level are truncated to this."""
LARGE = F(1e9)


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

"""Which pixels the right camera does not see, and which lie beside an edge."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.mapping.machine_code import by_rows

FloatImage = NDArray[np.float32]
F = np.float32


@by_rows
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


@by_rows
def belongs(  # noqa: C901 - two passes over the same neighbourhood
    left: FloatImage,
    disparity: FloatImage,
    usable: NDArray[np.bool_],
    near_jump: NDArray[np.bool_],
    radius: int,
    grey: np.float32,
    reach: np.float32,
    odds: np.float32,
) -> NDArray[np.bool_]:
    """Tell which pixels clearly belong to the surface that their disparity says.

    Near a jump the neighbours are of two surfaces; those of like grey and near by have more say (Yoon and Kweon 2006).

    Args:
        left: `(H, W)` grey.
        disparity: `(H, W)`, pixels.
        usable: `(H, W)`, which neighbours may vote.
        near_jump: `(H, W)`, which pixels are asked; all others belong.
        radius: Half side of the neighbourhood.
        grey: Difference of grey that takes 1/e of the weight.
        reach: Distance that takes 1/e of the weight, pixels.
        odds: How many times the other side's votes are needed.
    """
    rows, cols = disparity.shape
    out = np.ones((rows, cols), np.bool_)
    for y in prange(rows):
        for x in range(cols):
            if not near_jump[y, x] or not usable[y, x]:
                continue
            low = high = disparity[y, x]
            for v in range(max(0, y - radius), min(rows, y + radius + 1)):
                for u in range(max(0, x - radius), min(cols, x + radius + 1)):
                    if usable[v, u]:
                        low, high = min(low, disparity[v, u]), max(high, disparity[v, u])
            middle = F(0.5) * (low + high)
            side = disparity[y, x] > middle
            own, other = F(0.0), F(0.0)
            for v in range(max(0, y - radius), min(rows, y + radius + 1)):
                for u in range(max(0, x - radius), min(cols, x + radius + 1)):
                    if not usable[v, u]:
                        continue
                    distance = np.sqrt(F((v - y) * (v - y) + (u - x) * (u - x)))
                    weight = np.exp(-abs(left[v, u] - left[y, x]) / grey - distance / reach)
                    if (disparity[v, u] > middle) == side:
                        own += weight
                    else:
                        other += weight
            out[y, x] = own > odds * other
    return out

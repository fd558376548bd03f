"""The matching cost of a window: truncated absolute differences with adaptive support weights.

The weight of a pixel increases with its similarity to the centre in grey level and with its proximity to the centre
(Yoon and Kweon 2006), so that mostly pixels on the surface of the centre contribute. Beside jumps, the disparity is
assumed to be constant over the window (`constant_cost`), as in the training of the network (`validity/jump_network`).
In holes, the disparity is assumed to be a plane (`plane_cost`).

The mapper uses three matching costs: the cost of OpenCV's matcher for the initial disparity (`semi_global_matching`),
squared residuals for the refinement (`photometric_residual`), and the cost of this window for later tests of single
pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.jit import jit_rows_inline
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene

# `WINDOW_RADIUS`, `MAX_DIFFERENCE`, `GREY_SCALE` and `DISTANCE_SCALE_PX` are chosen by hand. Other values require a new
# training of the network that classifies pixels beside jumps (`jump_network`).
WINDOW_RADIUS = 4  #: Half the side of the window, pixels.
MAX_DIFFERENCE = F(30.0)
"""Absolute differences are truncated to this, grey levels, because occluded pixels are outliers."""
NO_COST = F(1e9)  #: Cost of a window outside the right image, grey levels: larger than any other cost.
VALID_WEIGHT = F(0.3)
"""Relative weight of valid pixels in the window of a hole, because their disparity is already known."""
GREY_SCALE = 8.0  #: Difference at which the weight has decreased to 1/e, grey levels.
DISTANCE_SCALE_PX = 3.0  #: Distance at which the weight has decreased to 1/e, pixels.

WEIGHT_BY_GREY = np.exp(-np.arange(256.0) / GREY_SCALE).astype(F)
"""Weight of a pixel by the absolute difference of grey levels from the centre."""
_OFFSETS = np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1, dtype=np.float64)
WEIGHT_BY_DISTANCE = np.exp(-np.hypot(_OFFSETS[:, None], _OFFSETS[None]) / DISTANCE_SCALE_PX).astype(F)
"""Weight of a pixel by its row and column in the window."""


@jit_rows_inline
def _linear(p0: np.float32, p1: np.float32, t: np.float32) -> np.float32:
    """Interpolate linearly between p0 (t = 0) and p1 (t = 1)."""
    value: np.float32 = p0 + t * (p1 - p0)
    return value


@jit_rows_inline
def _support_weight(left: FloatImage, y: int, x: int, v: int, u: int) -> np.float32:
    """Return the weight of a pixel (v, u) in the window around (y, x)."""
    by_grey = WEIGHT_BY_GREY[int(abs(left[v, u] - left[y, x]))]
    weight: np.float32 = by_grey * WEIGHT_BY_DISTANCE[v - y + WINDOW_RADIUS, u - x + WINDOW_RADIUS]
    return weight


class ConstantCost(NamedTuple):
    """Matching cost of a pixel at a disparity that is constant over the window."""

    cost: np.float32  #: Weighted mean absolute difference, grey levels; `NO_COST` outside the right image.
    #: Mean absolute difference of 3 x 3 pixels, grey levels; `NO_COST` if the window is outside the right image. It is
    #: 0 if a part of the window is inside but none of the 3 x 3 pixels is (`jump_network`).
    close_cost: np.float32
    effective_pixels: np.float32  #: Number of equally weighted pixels whose mean has the same variance.


@jit_rows_inline
def constant_cost(scene: DisparityScene, y: int, x: int, disparity: np.float32) -> ConstantCost:
    """Return the matching cost of a pixel at a disparity that is constant over the window."""
    left = scene.left
    right = scene.right
    rows, cols = left.shape
    whole = int(np.floor(disparity))
    fraction = disparity - F(whole)
    total = F(0.0)
    weights = F(0.0)
    squares = F(0.0)
    total_close = F(0.0)
    count_close = F(0.0)
    first = max(x - WINDOW_RADIUS, whole + 1, 0)
    last = min(x + WINDOW_RADIUS, cols - 1 + whole, cols - 1)
    for v in range(max(0, y - WINDOW_RADIUS), min(rows, y + WINDOW_RADIUS + 1)):
        for u in range(first, last + 1):
            value = _linear(right[v, u - whole], right[v, u - whole - 1], fraction)  # sampled `fraction` to the left
            difference = min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weight = _support_weight(left, y, x, v, u)
            total += weight * difference
            weights += weight
            squares += weight * weight
            if abs(v - y) <= 1 and abs(u - x) <= 1:
                total_close += difference
                count_close += F(1.0)
    if not weights > F(0.0):
        return ConstantCost(NO_COST, NO_COST, F(1.0))
    return ConstantCost(total / weights, total_close / max(count_close, F(1.0)), weights * weights / squares)


@jit_rows_inline
def plane_cost(
    scene: DisparityScene, y: int, x: int, disparity: np.float32, slope_x: np.float32, slope_y: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the matching cost of a plane over the window around a pixel, and the number of its effective pixels.

    Both are as in `ConstantCost`. Valid pixels have less weight. Pixels whose corresponding point is outside the right
    image are ignored.
    """
    left = scene.left
    right = scene.right
    valid = scene.valid
    rows, cols = left.shape
    total = F(0.0)
    weights = F(0.0)
    squares = F(0.0)
    for v in range(max(0, y - WINDOW_RADIUS), min(rows, y + WINDOW_RADIUS + 1)):
        start = F(x) - disparity - slope_y * F(v - y)
        for u in range(max(0, x - WINDOW_RADIUS), min(cols, x + WINDOW_RADIUS + 1)):
            column = start + (F(1.0) - slope_x) * F(u - x)
            is_inside = column >= F(0.0) and column < F(cols - 1)
            if not is_inside:
                continue
            k = int(column)
            value = _linear(right[v, k], right[v, k + 1], column - F(k))
            weight = _support_weight(left, y, x, v, u)
            weight *= VALID_WEIGHT if valid[v, u] else F(1.0)
            total += weight * min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weights += weight
            squares += weight * weight
    if not weights > F(0.0):
        return NO_COST, F(1.0)
    return total / weights, weights * weights / squares

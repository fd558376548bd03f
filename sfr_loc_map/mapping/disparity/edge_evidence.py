"""What the images say about pixels beside a jump of disparity: do they belong to their own surface or to the other?

Matching costs are truncated mean absolute differences with adaptive support weights (Yoon and Kweon 2006).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.occlusion import LARGE, MAX_DIFFERENCE, OTHER_SURFACE_PX

F = np.float32

NEIGHBOURHOOD = 3
"""Half side of the neighbourhood in which other surfaces are searched, pixels."""
CLAIM_PX = 6
"""Columns to either side in which surfaces are sought that claim the same pixel of the right image."""
FIGURES = 15
"""Number of the figures of a pixel."""
GREY_SCALE, DISTANCE_SCALE_PX = 8.0, 3.0
SUPPORT_RADIUS = 4
"""Neighbours of similar grey level support a pixel: where their weight is 1/e, and the radius of the window."""
MAX_LOG = 3.0
"""Logarithms of margins and jumps are clipped to this; it also stands for a margin where there is no other surface."""
MIN_TYPICAL_GREY = 0.5
"""Smallest typical cost: whole grey levels differ by that much without noise."""
MIN_COST = 0.05
"""Smallest cost, in typical ones, whose logarithm is taken."""


class SupportWeights(NamedTuple):
    """Adaptive support weights (Yoon and Kweon 2006).

    Attributes:
        by_grey: `(256,)` float32, by the difference of grey level from the centre.
        by_distance: `(2 r + 1, 2 r + 1)` float32, by the position in the window.
    """

    by_grey: FloatImage
    by_distance: FloatImage


def support_weights() -> SupportWeights:
    """Return the weights of a window by which matching costs are judged."""
    axis = np.arange(-SUPPORT_RADIUS, SUPPORT_RADIUS + 1, dtype=np.float64)
    distance = np.hypot(axis[:, None], axis[None])
    by_grey = np.exp(-np.arange(256.0) / GREY_SCALE).astype(F)
    return SupportWeights(by_grey, np.exp(-distance / DISTANCE_SCALE_PX).astype(F))


class Scene(NamedTuple):
    """Images and disparities that are judged.

    Attributes:
        left: `(H, W)` whole grey levels.
        right: `(H, W)` grey levels, corrected.
        disparity: `(H, W)`, pixels.
        matched: `(H, W)`, whose disparities count as surfaces.
        sigma: `(H, W)`, standard deviation of the disparity, pixels.
        by_grey: As in `SupportWeights`.
        by_distance: Likewise.
    """

    left: FloatImage
    right: FloatImage
    disparity: FloatImage
    matched: Mask
    sigma: FloatImage
    by_grey: FloatImage
    by_distance: FloatImage


class Costs(NamedTuple):
    """Matching costs of a pixel at one disparity, grey levels.

    Attributes:
        left: Over the window, weights by the left image.
        both: The same, weights by both images.
        close: Mean of 3 x 3 pixels.
        worth: Number of pixels that the window is worth.
    """

    left: np.float32
    both: np.float32
    close: np.float32
    worth: np.float32


@jit_rows_inline
def matching_costs(scene: Scene, y: int, x: int, disparity: np.float32) -> Costs:
    """Return the costs of a pixel at a disparity; `LARGE` where its window lies outside the right image."""
    left, right = scene.left, scene.right
    rows, cols = left.shape
    radius = scene.by_distance.shape[0] // 2
    whole = int(np.floor(disparity))
    part = disparity - F(whole)
    k = min(max(x - whole, 1), cols - 1)
    centre = right[y, k] + part * (right[y, k - 1] - right[y, k])
    total, weights, squares = F(0.0), F(0.0), F(0.0)
    total_both, weights_both, total_close, count = F(0.0), F(0.0), F(0.0), F(0.0)
    first, last = max(x - radius, whole + 1, 0), min(x + radius, cols - 1 + whole, cols - 1)
    for v in range(max(0, y - radius), min(rows, y + radius + 1)):
        for u in range(first, last + 1):
            value = right[v, u - whole] + part * (right[v, u - whole - 1] - right[v, u - whole])
            difference = min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weight = scene.by_grey[int(abs(left[v, u] - left[y, x]))]
            weight *= scene.by_distance[v - y + radius, u - x + radius]
            weight_both = weight * scene.by_grey[min(int(abs(value - centre)), 255)]
            total += weight * difference
            weights += weight
            squares += weight * weight
            total_both += weight_both * difference
            weights_both += weight_both
            if abs(v - y) <= 1 and abs(u - x) <= 1:
                total_close += difference
                count += F(1.0)
    if not weights_both > F(0.0):
        return Costs(LARGE, LARGE, LARGE, F(1.0))
    close = total_close / max(count, F(1.0))
    return Costs(total / weights, total_both / weights_both, close, weights * weights / squares)


@jit_rows_inline
def _fill_costs(scene: Scene, y: int, x: int, out: FloatImage) -> None:
    """Fill the figures that follow from costs: at the pixel's own disparity and at its neighbours' extremes."""
    rows, cols = scene.disparity.shape
    own = scene.disparity[y, x]
    low = high = own
    for v in range(max(0, y - NEIGHBOURHOOD), min(rows, y + NEIGHBOURHOOD + 1)):
        for u in range(max(0, x - NEIGHBOURHOOD), min(cols, x + NEIGHBOURHOOD + 1)):
            if scene.matched[v, u]:
                low, high = min(low, scene.disparity[v, u]), max(high, scene.disparity[v, u])
    mine = matching_costs(scene, y, x, own)
    best, both, close, jump = LARGE, LARGE, LARGE, F(0.0)
    for other in (low, high):
        if abs(other - own) >= OTHER_SURFACE_PX:
            costs = matching_costs(scene, y, x, other)
            both = min(both, costs.both)
            if costs.left < best:
                best, close, jump = costs.left, costs.close, other - own
    out[0], out[1], out[2] = best - mine.left, both - mine.both, close - mine.close
    out[3], out[4], out[5], out[6], out[7] = mine.worth, mine.left, mine.both, mine.close, jump


@jit_rows_inline
def _fill_surroundings(scene: Scene, y: int, x: int, out: FloatImage) -> None:
    """Fill the figures that follow from the disparities and grey levels around."""
    disparity, left = scene.disparity, scene.left
    rows, cols = disparity.shape
    own = disparity[y, x]
    none = NEIGHBOURHOOD + 2
    nearest = to_left = to_right = none
    same, count, total, squares = F(0.0), F(0.0), F(0.0), F(0.0)
    for v in range(max(0, y - NEIGHBOURHOOD), min(rows, y + NEIGHBOURHOOD + 1)):
        for u in range(max(0, x - NEIGHBOURHOOD), min(cols, x + NEIGHBOURHOOD + 1)):
            grey = left[v, u] - left[y, x]
            total += grey
            squares += grey * grey
            count += F(1.0)
            if abs(disparity[v, u] - own) <= OTHER_SURFACE_PX:
                same += F(1.0)
                continue
            nearest = min(nearest, max(abs(v - y), abs(u - x)))
            if abs(v - y) <= abs(u - x):
                if u < x:
                    to_left = min(to_left, x - u)
                else:
                    to_right = min(to_right, u - x)
    mean = total / count
    out[8] = np.sqrt(max(squares / count - mean * mean, F(0.0)))
    out[9], out[10], out[11], out[12] = F(nearest), same / count, F(to_left), F(to_right)
    target, claim = np.rint(F(x) - own), F(0.0)
    for u in range(max(0, x - CLAIM_PX), min(cols, x + CLAIM_PX + 1)):
        if abs(np.rint(F(u) - disparity[y, u]) - target) <= F(1.0):
            claim = max(claim, disparity[y, u] - own)
    out[13] = claim


@jit_rows
def edge_figures(scene: Scene, chosen: NDArray[np.int64]) -> FloatImage:
    """Return the figures of pixels `(N, 15)`, given by their places in the flat image.

    Columns: margin in cost of the best other surface over the pixel's own (weights by the left image, by both, 3 x 3
    pixels), grey levels, `LARGE` if there is no other; number of pixels that the window is worth; the three costs at
    the own disparity; jump to the other surface, pixels; standard deviation of the grey levels around; distance to the
    nearest pixel of another surface, 5 for none; share of the neighbours on the own surface; distance to one
    on the left and on the right; by how many pixels of disparity a nearer surface claims the same pixel of the right
    image; standard deviation of the disparity, pixels.
    """
    cols = scene.disparity.shape[1]
    out = np.empty((len(chosen), FIGURES), F)
    for n in prange(len(chosen)):
        y, x = chosen[n] // cols, chosen[n] % cols
        _fill_costs(scene, y, x, out[n])
        _fill_surroundings(scene, y, x, out[n])
        out[n, 14] = scene.sigma[y, x]
    return out


def edge_evidence(scene: Scene, chosen: NDArray[np.int64]) -> FloatImage:
    """Return what a network judges pixels by `(N, 15)`: the figures without unit, of the size of one.

    Costs are taken relative to the typical one of the pair: real images match less well than their noise explains.
    """
    figures = edge_figures(scene, chosen)
    if not len(figures):
        return figures
    typical = max(float(np.median(figures[:, 4])), MIN_TYPICAL_GREY)
    alone = figures[:, 7] == 0.0
    margins = _signed_log(figures[:, :3] * (np.array([2.0, 2.0, 1.0]) / typical))
    out = figures.astype(np.float64)
    out[:, :3] = np.where(alone[:, None], MAX_LOG, np.clip(margins, -MAX_LOG, MAX_LOG))
    out[:, 3], out[:, 14] = np.log(figures[:, 3]), np.log(figures[:, 14])
    out[:, [4, 5, 6, 8]] = np.log(np.maximum(figures[:, [4, 5, 6, 8]] / typical, MIN_COST))
    out[:, 7] = np.clip(_signed_log(figures[:, 7]), -MAX_LOG, MAX_LOG)
    out[:, 13] = np.log1p(figures[:, 13])
    return np.ascontiguousarray(out, F)


def _signed_log(values: NDArray[np.floating]) -> NDArray[np.floating]:
    return np.asarray(np.sign(values) * np.log1p(np.abs(values)))

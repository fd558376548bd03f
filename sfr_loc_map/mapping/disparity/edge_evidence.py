"""Evidence of the images whether a pixel beside a jump of disparity has the disparity of the wrong surface.

A network with one hidden layer judges a pixel by matching costs and its neighbourhood. Its weights were trained on
rendered ground, whose true disparity is known (`tools/train_edge_network.py`).
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, IntArray, Mask, median
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.filters import SURFACE_JUMP_PX
from sfr_loc_map.mapping.disparity.matching_cost import (
    MAX_COST,
    MAX_DIFFERENCE,
    WEIGHT_BY_DISTANCE,
    WEIGHT_BY_GREY,
    WINDOW_RADIUS,
)

F = np.float32

SMALL_JUMP_PX = F(
    0.7
)  #: Disparities that differ by more may belong to two surfaces that refinement has joined by a ramp.
SURFACE_RADIUS = 3  #: Half side of the neighbourhood in which other surfaces are searched, pixels.
CLAIM_COLUMNS = 6  #: Columns to either side in which surfaces are sought that correspond to the same right pixel.
MAX_LOG = 3.0  #: Logarithms of cost margins and jumps are clipped to this; also the margin without another surface.
MIN_TYPICAL_COST = 0.5  #: Smallest typical cost, grey levels: rounding alone causes differences of this size.
MIN_RELATIVE_COST = 0.05  #: Smallest cost over the typical cost whose logarithm is taken.
CONFLICT_PX = F(1.0)  #: Pixels whose corresponding columns differ by no more correspond to the same right pixel.

# Columns of the figures and of the evidence.
MARGIN = 0  #: Cost margin of the best other surface over the own one, window, grey levels.
CLOSE_MARGIN = 1  #: The same over 3 x 3 pixels.
EFFECTIVE_PIXELS = 2  #: Number of pixels with equal weights that the window is equivalent to.
COST = 3  #: Cost at the own disparity, window, grey levels.
CLOSE_COST = 4  #: The same over 3 x 3 pixels.
JUMP = 5  #: Disparity of the other surface minus the own one, pixels; 0 if there is no other surface.
CONTRAST = 6  #: Standard deviation of the grey levels of the window.
SAME_SURFACE = 7  #: Weighted fraction of the window on the own surface.
NEARER_SURFACE = 8  #: Weighted fraction of the window on nearer surfaces.
CLAIM = 9  #: Disparity by which a nearer surface that corresponds to the same right pixel is nearer, pixels.
SLOPE_X = 10  #: Slope of the disparity along the row, pixels per pixel.
SLOPE_Y = 11  #: Slope of the disparity along the column, pixels per pixel.
SIGMA = 12  #: Standard deviation of the disparity, pixels.
FIGURES = 13  #: Number of the columns.


class EdgeScene(NamedTuple):
    """Images and disparities that are judged, `(H, W)` each."""

    left: FloatImage  #: Whole grey levels.
    right: FloatImage  #: Corrected grey levels.
    disparity: FloatImage  #: Pixels.
    matched: Mask  #: Pixels whose disparities are surfaces.
    valid: Mask  #: Pixels whose disparities are valid by all other tests.
    sigma: FloatImage  #: Standard deviation of the disparity, pixels.


class MatchingCost(NamedTuple):
    """Matching cost of a pixel at a disparity."""

    window: np.float32  #: Cost of the window, grey levels; `MAX_COST` outside the right image.
    close: np.float32  #: Mean absolute difference of 3 x 3 pixels, grey levels; `MAX_COST` likewise.
    effective_pixels: np.float32  #: Number of pixels with equal weights that the window is equivalent to.


@jit_rows_inline
def _matching_cost(scene: EdgeScene, y: int, x: int, disparity: np.float32) -> MatchingCost:
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
            value = right[v, u - whole] + fraction * (right[v, u - whole - 1] - right[v, u - whole])
            difference = min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weight = WEIGHT_BY_GREY[int(abs(left[v, u] - left[y, x]))]
            weight *= WEIGHT_BY_DISTANCE[v - y + WINDOW_RADIUS, u - x + WINDOW_RADIUS]
            total += weight * difference
            weights += weight
            squares += weight * weight
            if abs(v - y) <= 1 and abs(u - x) <= 1:
                total_close += difference
                count_close += F(1.0)
    if not weights > F(0.0):
        return MatchingCost(MAX_COST, MAX_COST, F(1.0))
    return MatchingCost(total / weights, total_close / max(count_close, F(1.0)), weights * weights / squares)


@jit_rows_inline
def _fill_costs(scene: EdgeScene, y: int, x: int, out: FloatImage) -> None:
    """Fill the figures from costs at the own disparity and at the smallest and largest one of the neighbourhood."""
    rows, cols = scene.disparity.shape
    own = scene.disparity[y, x]
    low = own
    high = own
    for v in range(max(0, y - SURFACE_RADIUS), min(rows, y + SURFACE_RADIUS + 1)):
        for u in range(max(0, x - SURFACE_RADIUS), min(cols, x + SURFACE_RADIUS + 1)):
            if scene.matched[v, u]:
                low = min(low, scene.disparity[v, u])
                high = max(high, scene.disparity[v, u])
    at_own = _matching_cost(scene, y, x, own)
    best = MAX_COST
    best_close = MAX_COST
    jump = F(0.0)
    for other in (low, high):
        if abs(other - own) >= SURFACE_JUMP_PX:
            at_other = _matching_cost(scene, y, x, other)
            if at_other.window < best:
                best = at_other.window
                best_close = at_other.close
                jump = other - own
    out[MARGIN] = best - at_own.window
    out[CLOSE_MARGIN] = best_close - at_own.close
    out[EFFECTIVE_PIXELS] = at_own.effective_pixels
    out[COST] = at_own.window
    out[CLOSE_COST] = at_own.close
    out[JUMP] = jump


@jit_rows_inline
def _fill_neighbourhood(scene: EdgeScene, y: int, x: int, out: FloatImage) -> None:
    """Fill the figures from the disparities and grey levels of the neighbourhood."""
    disparity = scene.disparity
    left = scene.left
    rows, cols = disparity.shape
    own = disparity[y, x]
    count = F(0.0)
    total = F(0.0)
    squares = F(0.0)
    weights = F(0.0)
    same = F(0.0)
    nearer = F(0.0)
    for v in range(max(0, y - WINDOW_RADIUS), min(rows, y + WINDOW_RADIUS + 1)):
        for u in range(max(0, x - WINDOW_RADIUS), min(cols, x + WINDOW_RADIUS + 1)):
            difference = left[v, u] - left[y, x]
            total += difference
            squares += difference * difference
            count += F(1.0)
            weight = WEIGHT_BY_GREY[int(abs(difference))]
            weights += weight
            if scene.valid[v, u] and abs(disparity[v, u] - own) <= SMALL_JUMP_PX:
                same += weight
            elif disparity[v, u] - own > SMALL_JUMP_PX:
                nearer += weight
    mean = total / count
    out[CONTRAST] = np.sqrt(max(squares / count - mean * mean, F(0.0)))
    out[SAME_SURFACE] = same / weights
    out[NEARER_SURFACE] = nearer / weights
    out[CLAIM] = _nearer_claim(disparity, y, x)
    out[SLOPE_X] = F(0.5) * (disparity[y, min(x + 1, cols - 1)] - disparity[y, max(x - 1, 0)])
    out[SLOPE_Y] = F(0.5) * (disparity[min(y + 1, rows - 1), x] - disparity[max(y - 1, 0), x])


@jit_rows_inline
def _nearer_claim(disparity: FloatImage, y: int, x: int) -> np.float32:
    """Return by how much the nearest surface that corresponds to the same right pixel is nearer, pixels."""
    cols = disparity.shape[1]
    own = disparity[y, x]
    target = np.rint(F(x) - own)
    claim = F(0.0)
    for u in range(max(0, x - CLAIM_COLUMNS), min(cols, x + CLAIM_COLUMNS + 1)):
        if abs(np.rint(F(u) - disparity[y, u]) - target) <= CONFLICT_PX:
            claim = max(claim, disparity[y, u] - own)
    return claim


@jit_rows
def edge_figures(scene: EdgeScene, flat_indices: IntArray) -> FloatImage:
    """Return the figures of pixels `(N, 13)`, given by their indices in the flat image; columns as named above.

    The margins are about `MAX_COST` if there is no other surface.
    """
    cols = scene.disparity.shape[1]
    out = np.empty((len(flat_indices), FIGURES), F)
    for n in prange(len(flat_indices)):
        y = flat_indices[n] // cols
        x = flat_indices[n] % cols
        _fill_costs(scene, y, x, out[n])
        _fill_neighbourhood(scene, y, x, out[n])
        out[n, SIGMA] = scene.sigma[y, x]
    return out


def edge_evidence(scene: EdgeScene, flat_indices: IntArray) -> FloatImage:
    """Return the evidence of pixels `(N, 13)`: their figures as dimensionless numbers of order 1.

    Costs are relative to the typical cost of the pair, because real images match less well than their noise explains.
    """
    figures = edge_figures(scene, flat_indices)
    if not len(figures):
        return figures
    typical = max(median(figures[:, COST]), MIN_TYPICAL_COST)
    is_single_surface = figures[:, JUMP] == 0.0
    margins = _signed_log(figures[:, [MARGIN, CLOSE_MARGIN]] * (np.array([2.0, 1.0]) / typical))
    margins = np.clip(margins, -MAX_LOG, MAX_LOG)
    costs = [COST, CLOSE_COST, CONTRAST]
    scales = [EFFECTIVE_PIXELS, SIGMA]
    out = figures.astype(np.float64)
    out[:, [MARGIN, CLOSE_MARGIN]] = np.where(is_single_surface[:, None], MAX_LOG, margins)
    out[:, scales] = np.log(figures[:, scales])
    out[:, costs] = np.log(np.maximum(figures[:, costs] / typical, MIN_RELATIVE_COST))
    out[:, JUMP] = np.clip(_signed_log(figures[:, JUMP]), -MAX_LOG, MAX_LOG)
    out[:, CLAIM] = np.log1p(figures[:, CLAIM])
    return np.ascontiguousarray(out, F)


def _signed_log(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return `sign(x) log(1 + |x|)`."""
    return np.asarray(np.sign(values) * np.log1p(np.abs(values)))


class EdgeNetwork(NamedTuple):
    """A network with one hidden layer of K rectified linear units, float32."""

    low: FloatImage  #: `(13,)`, smallest evidence in the training; evidence is clipped to the range of the training.
    high: FloatImage  #: `(13,)`, largest evidence in the training.
    hidden: FloatImage  #: `(K, 13)`, weights of the evidence.
    hidden_offset: FloatImage  #: `(K,)`.
    output: FloatImage  #: `(K,)`, weights of the hidden layer.
    output_offset: FloatImage  #: `(1,)`.


@cache
def edge_network() -> EdgeNetwork:
    """Return the trained network."""
    text = files("sfr_loc_map.mapping.disparity").joinpath("edge_network.json").read_text(encoding="utf-8")
    weights = json.loads(text)
    return EdgeNetwork(*(np.asarray(weights[name], F) for name in EdgeNetwork._fields))


@jit_rows
def _log_odds(network: EdgeNetwork, evidence: FloatImage) -> FloatImage:
    """Return the output of the network `(N,)` for evidence `(N, 13)`."""
    low = network.low
    high = network.high
    hidden = network.hidden
    hidden_offset = network.hidden_offset
    output = network.output
    out = np.empty(len(evidence), F)
    for n in prange(len(evidence)):
        total = network.output_offset[0]
        for k in range(len(output)):
            unit = hidden_offset[k]
            for i in range(hidden.shape[1]):
                unit += hidden[k, i] * min(max(evidence[n, i], low[i]), high[i])
            total += output[k] * max(unit, F(0.0))
        out[n] = total
    return out


def wrong_surface_log_odds(scene: EdgeScene, flat_indices: IntArray) -> FloatImage:
    """Return the log odds `(N,)` that pixels, given by flat indices, have the wrong surface's disparity."""
    return _log_odds(edge_network(), edge_evidence(scene, flat_indices))

"""What the images say about pixels beside a jump of disparity: do they belong to their own surface or to the other?

Matching costs are truncated mean absolute differences with adaptive support weights (Yoon and Kweon 2006). A network
with one hidden layer judges a pixel by them and its surroundings. Its weights are learnt on rendered ground, where the
truth is known (`tools/train_edge_network.py`).
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, IntArray, Mask
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32

OTHER_SURFACE_PX = F(1.0)  #: Disparities that differ by less belong to one surface.
ALIKE_PX = F(0.7)  #: Disparities that differ by more may belong to two, which refinement has joined by a ramp.
MAX_DIFFERENCE = F(30.0)  #: Absolute differences of grey level are truncated to this.
LARGE = F(1e9)  #: Cost where there is nothing to compare.
NEIGHBOURHOOD = 3  #: Half side of the neighbourhood in which other surfaces are searched, pixels.
CLAIM_PX = 6  #: Columns to either side in which surfaces are sought that claim the same pixel of the right image.
FIGURES = 13  #: Number of the figures of a pixel.
RADIUS = 4  #: Half side of the window over which costs are averaged.
WEIGHT_BY_GREY = np.exp(-np.arange(256.0) / 8.0).astype(F)
"""Support of a neighbour by the difference of its grey level from the centre."""
_AXIS = np.arange(-RADIUS, RADIUS + 1, dtype=np.float64)
WEIGHT_BY_DISTANCE = np.exp(-np.hypot(_AXIS[:, None], _AXIS[None]) / 3.0).astype(F)
"""Support of a neighbour by its position in the window."""
MAX_LOG = 3.0
"""Logarithms of margins and jumps are clipped to this; it also stands for a margin where there is no other surface."""
MIN_TYPICAL_GREY = 0.5  #: Smallest typical cost: whole grey levels differ by that much without noise.
MIN_COST = 0.05  #: Smallest cost, in typical ones, whose logarithm is taken.


class EdgeScene(NamedTuple):
    """Images and disparities that are judged, `(H, W)` each."""

    left: FloatImage  # whole grey levels
    right: FloatImage  # grey levels, corrected
    disparity: FloatImage  # pixels
    matched: Mask  # whose disparities count as surfaces
    valid: Mask  # whose disparities are valid by all other tests
    sigma: FloatImage  # standard deviation of the disparity, pixels


@jit_rows_inline
def _matching_costs(
    scene: EdgeScene, y: int, x: int, disparity: np.float32
) -> tuple[np.float32, np.float32, np.float32]:
    """Return the costs of a pixel at a disparity, grey levels, and the number of pixels that its window is worth.

    The costs are that of the window and the mean of 3 x 3 pixels; `LARGE` where it lies outside the right image.
    """
    left, right = scene.left, scene.right
    rows, cols = left.shape
    whole = int(np.floor(disparity))
    part = disparity - F(whole)
    total, weights, squares, total_close, count = F(0.0), F(0.0), F(0.0), F(0.0), F(0.0)
    first, last = max(x - RADIUS, whole + 1, 0), min(x + RADIUS, cols - 1 + whole, cols - 1)
    for v in range(max(0, y - RADIUS), min(rows, y + RADIUS + 1)):
        for u in range(first, last + 1):
            value = right[v, u - whole] + part * (right[v, u - whole - 1] - right[v, u - whole])
            difference = min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weight = WEIGHT_BY_GREY[int(abs(left[v, u] - left[y, x]))]
            weight *= WEIGHT_BY_DISTANCE[v - y + RADIUS, u - x + RADIUS]
            total += weight * difference
            weights += weight
            squares += weight * weight
            if abs(v - y) <= 1 and abs(u - x) <= 1:
                total_close += difference
                count += F(1.0)
    if not weights > F(0.0):
        return LARGE, LARGE, F(1.0)
    return total / weights, total_close / max(count, F(1.0)), weights * weights / squares


@jit_rows_inline
def _fill_costs(scene: EdgeScene, y: int, x: int, out: FloatImage) -> None:
    """Fill the figures that follow from costs: at the pixel's own disparity and at its neighbours' extremes."""
    rows, cols = scene.disparity.shape
    own = scene.disparity[y, x]
    low = high = own
    for v in range(max(0, y - NEIGHBOURHOOD), min(rows, y + NEIGHBOURHOOD + 1)):
        for u in range(max(0, x - NEIGHBOURHOOD), min(cols, x + NEIGHBOURHOOD + 1)):
            if scene.matched[v, u]:
                low, high = min(low, scene.disparity[v, u]), max(high, scene.disparity[v, u])
    mine, mine_close, worth = _matching_costs(scene, y, x, own)
    best, close, jump = LARGE, LARGE, F(0.0)
    for other in (low, high):
        if abs(other - own) >= OTHER_SURFACE_PX:
            cost, cost_close, _ = _matching_costs(scene, y, x, other)
            if cost < best:
                best, close, jump = cost, cost_close, other - own
    out[0], out[1], out[2], out[3], out[4], out[5] = best - mine, close - mine_close, worth, mine, mine_close, jump


@jit_rows_inline
def _fill_surroundings(scene: EdgeScene, y: int, x: int, out: FloatImage) -> None:
    """Fill the figures that follow from the disparities and grey levels around."""
    disparity, left = scene.disparity, scene.left
    rows, cols = disparity.shape
    own = disparity[y, x]
    count, total, squares, weights, same, nearer = F(0.0), F(0.0), F(0.0), F(0.0), F(0.0), F(0.0)
    for v in range(max(0, y - RADIUS), min(rows, y + RADIUS + 1)):
        for u in range(max(0, x - RADIUS), min(cols, x + RADIUS + 1)):
            grey = left[v, u] - left[y, x]
            total += grey
            squares += grey * grey
            count += F(1.0)
            weight = WEIGHT_BY_GREY[int(abs(grey))]
            weights += weight
            if scene.valid[v, u] and abs(disparity[v, u] - own) <= ALIKE_PX:
                same += weight
            elif disparity[v, u] - own > ALIKE_PX:
                nearer += weight
    mean = total / count
    out[6] = np.sqrt(max(squares / count - mean * mean, F(0.0)))
    out[7], out[8] = same / weights, nearer / weights
    target, claim = np.rint(F(x) - own), F(0.0)
    for u in range(max(0, x - CLAIM_PX), min(cols, x + CLAIM_PX + 1)):
        if abs(np.rint(F(u) - disparity[y, u]) - target) <= F(1.0):
            claim = max(claim, disparity[y, u] - own)
    out[9] = claim
    out[10] = F(0.5) * (disparity[y, min(x + 1, cols - 1)] - disparity[y, max(x - 1, 0)])
    out[11] = F(0.5) * (disparity[min(y + 1, rows - 1), x] - disparity[max(y - 1, 0), x])


@jit_rows
def edge_figures(scene: EdgeScene, chosen: IntArray) -> FloatImage:
    """Return the figures of pixels `(N, 13)`, given by their places in the flat image.

    Columns: margin in cost of the best other surface over the pixel's own (window, 3 x 3 pixels), grey levels, `LARGE`
    if there is no other; number of pixels that the window is worth; both costs at the own disparity; jump to the other
    surface, pixels; standard deviation of the grey levels around; shares of the pixels around of like grey that are on
    the own surface and on nearer ones; by how many pixels of disparity a nearer surface claims the same pixel of the
    right image; slope of the disparity along rows and columns; standard deviation of the disparity, pixels.
    """
    cols = scene.disparity.shape[1]
    out = np.empty((len(chosen), FIGURES), F)
    for n in prange(len(chosen)):
        y, x = chosen[n] // cols, chosen[n] % cols
        _fill_costs(scene, y, x, out[n])
        _fill_surroundings(scene, y, x, out[n])
        out[n, 12] = scene.sigma[y, x]
    return out


def edge_evidence(scene: EdgeScene, chosen: IntArray) -> FloatImage:
    """Return what a network judges pixels by `(N, 13)`: the figures without unit, of the size of one.

    Costs are taken relative to the typical one of the pair: real images match less well than their noise explains.
    """
    figures = edge_figures(scene, chosen)
    if not len(figures):
        return figures
    typical = max(float(np.median(figures[:, 3])), MIN_TYPICAL_GREY)
    alone = figures[:, 5] == 0.0
    margins = _signed_log(figures[:, :2] * (np.array([2.0, 1.0]) / typical))
    out = figures.astype(np.float64)
    out[:, :2] = np.where(alone[:, None], MAX_LOG, np.clip(margins, -MAX_LOG, MAX_LOG))
    out[:, [2, 12]] = np.log(figures[:, [2, 12]])
    out[:, [3, 4, 6]] = np.log(np.maximum(figures[:, [3, 4, 6]] / typical, MIN_COST))
    out[:, 5] = np.clip(_signed_log(figures[:, 5]), -MAX_LOG, MAX_LOG)
    out[:, 9] = np.log1p(figures[:, 9])
    return np.ascontiguousarray(out, F)


def _signed_log(values: NDArray[np.floating]) -> NDArray[np.floating]:
    return np.asarray(np.sign(values) * np.log1p(np.abs(values)))


class EdgeNetwork(NamedTuple):
    """A network with one hidden layer of K rectified linear units, float32."""

    low: FloatImage  # `(13,)`. Evidence is clipped to the range that was common where the weights were learnt
    high: FloatImage  # `(13,)`, likewise
    hidden: FloatImage  # `(K, 13)`, weights of the evidence
    hidden_offset: FloatImage  # `(K,)`
    output: FloatImage  # `(K,)`, weights of the hidden layer
    output_offset: FloatImage  # `(1,)`


@cache
def edge_network() -> EdgeNetwork:
    """Return the network that is part of the suite."""
    text = files("sfr_loc_map.mapping.disparity").joinpath("edge_network.json").read_text(encoding="utf-8")
    weights = json.loads(text)
    return EdgeNetwork(*(np.asarray(weights[name], F) for name in EdgeNetwork._fields))


@jit_rows
def _log_odds(network: EdgeNetwork, evidence: FloatImage) -> FloatImage:
    low, high = network.low, network.high
    hidden, hidden_offset, output = network.hidden, network.hidden_offset, network.output
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


def wrong_surface_log_odds(scene: EdgeScene, chosen: IntArray) -> FloatImage:
    """Return the log odds `(N,)` that pixels, given by their places in the flat image, are on the wrong surface."""
    return _log_odds(edge_network(), edge_evidence(scene, chosen))

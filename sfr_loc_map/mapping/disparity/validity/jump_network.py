"""Detection of pixels beside a disparity jump that probably have the disparity of the wrong surface.

    scene -> classified_pixels -> jump_features -> network_input -> log odds -> threshold (`wrong_surface_mask`)

A network with one hidden layer classifies a pixel by thirteen features, such as the matching costs at the disparity of
the pixel and at the disparity of the other surface. A pixel is on the wrong surface if its log odds exceed a threshold
that depends on the sigma of the pair and on the depth of the pixel.

The weights (`jump_network.json`) were trained on rendered ground with known disparity (`tools/train_jump_network.py`).
They are valid only for the features of the training. Train the network again after a change of

- the constants below and in `matching_cost`, or the features themselves;
- the classified pixels: those that pass `pixel_status.judge_before_wrong_surface`. They depend on all earlier stages.

The file also contains the constants, and the number of classified pixels and the mean inputs of a reference pair.
`test_wrong_surface` compares both with the code, so that a change fails the test.

The following properties of the features must not be corrected without a new training:

- `close_cost` is 0 if a part of the window is inside the right image, but none of the 3 x 3 pixels is.
- `same_surface` counts only valid pixels, and `nearer_surface` counts valid and invalid pixels.
- `occluder_px` compares right columns with a tolerance and counts valid and invalid disparities.
  `surfaces.occlusion_mask` is stricter, because it decides without other features.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, FloatImage, IntArray, Mask, median
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.matching_cost import (
    NO_COST,
    WEIGHT_BY_GREY,
    WINDOW_RADIUS,
    ConstantCost,
    constant_cost,
)
from sfr_loc_map.mapping.disparity.surfaces import (
    SURFACE_JUMP_PX,
    DisparityScene,
    depth_ratio,
    slope_along_columns,
    slope_along_rows,
)
from sfr_loc_map.mapping.filters import dilated, square_element

SMALL_JUMP_PX = F(0.7)
"""Disparities that differ by more than this may belong to two surfaces that the refinement has joined by a ramp,
pixels. Costs are compared only with surfaces that differ by `SURFACE_JUMP_PX` or more."""
SURFACE_RADIUS = 3  #: Half the side of the window in which other surfaces are searched, pixels.
OCCLUDER_COLUMNS = 6  #: Maximum distance of a surface that may occlude the pixel in the right image, columns.
SAME_COLUMN_PX = F(1.0)
"""Pixels correspond to the same right pixel if their columns in the right image differ by up to this, pixels."""
LOG_ODDS_AT_1_PX = F(3.3)
"""Log odds above which a pixel is invalid if the median sigma of the pair is 1 pixel. The logarithm of the median
sigma, pixels, is added, because an outlier has more effect on the error of a precise map."""
DEPTH_POWER = F(2.0)
"""The odds are multiplied by this power of the depth ratio, because the error in metres of a disparity on the wrong
surface grows with the square of the depth."""
SIGMA_STRIDE = 16  #: Every sixteenth valid pixel is used for the median sigma.

# Conversion of features to inputs of the network.
MAX_LOG = 3.0
"""Logarithms of margins and jumps are clipped to +/- this value, which is also the logarithm of the margin without
another surface."""
MIN_TYPICAL_COST = 0.5  #: Lower bound of the typical cost of a pair, grey levels: a typical rounding difference.
MIN_RELATIVE_COST = 0.05  #: Lower bound of the ratio of a cost to the typical cost, for the logarithm.
WINDOW_MARGIN_SCALE = 2.0  #: Factor of the window margin, which varies less than the margin of 3 x 3 pixels.


class JumpFeatures(NamedTuple):
    """Features of N pixels, or the inputs of the network, `(N,)` float32 each; the weights are in this order."""

    window_margin: FloatArray32  #: Window cost of the best other surface minus `window_cost`, grey levels.
    close_margin: FloatArray32  #: The same margin over 3 x 3 pixels.
    effective_pixels: FloatArray32  #: Number of pixels with equal weights that is equivalent to the window.
    window_cost: FloatArray32  #: Window cost at the disparity of the pixel, grey levels.
    close_cost: FloatArray32  #: The same cost over 3 x 3 pixels.
    jump_px: FloatArray32  #: Disparity of the other surface minus that of the pixel, pixels; 0 if none exists.
    contrast: FloatArray32  #: Standard deviation of the grey levels of the window.
    same_surface: FloatArray32  #: Weighted fraction of the window on the surface of the pixel.
    nearer_surface: FloatArray32  #: Weighted fraction of the window on nearer surfaces.
    occluder_px: FloatArray32  #: Disparity of the nearest surface at the same right pixel minus that of the pixel.
    slope_x: FloatArray32  #: Slope of the disparity along the row, pixels per pixel.
    slope_y: FloatArray32  #: Slope of the disparity along the column, pixels per pixel.
    sigma_px: FloatArray32  #: Standard deviation of the disparity, pixels.


class SurfaceCosts(NamedTuple):
    """Matching costs of a pixel at its own disparity and at the disparity of the best other surface nearby."""

    own: ConstantCost
    window_margin: np.float32  #: Window cost of the other surface minus that of `own`; about `NO_COST` if none exists.
    close_margin: np.float32  #: The same margin over 3 x 3 pixels.
    jump_px: np.float32  #: Disparity of the other surface minus that of the pixel, pixels; 0 if none exists.


class JumpNetwork(NamedTuple):
    """A network with one hidden layer of K rectified linear units, float32."""

    low: FloatArray32  #: `(13,)`, smallest input in the training; inputs are clipped to the training range.
    high: FloatArray32  #: `(13,)`, largest input in the training.
    hidden: FloatArray32  #: `(K, 13)`, weights of the input.
    hidden_offset: FloatArray32  #: `(K,)`.
    output: FloatArray32  #: `(K,)`, weights of the hidden layer.
    output_offset: FloatArray32  #: `(1,)`.


def wrong_surface_mask(scene: DisparityScene) -> Mask:
    """Return the mask of the valid pixels `(H, W)` beside a jump that are probably on the wrong surface."""
    wrong = np.zeros(scene.valid.shape, np.bool_)
    flat_indices = classified_pixels(scene)
    if not len(flat_indices):
        return wrong
    log_odds = _log_odds(jump_network(), network_input(jump_features(scene, flat_indices)))
    log_depth_ratio = np.log(depth_ratio(scene.disparity, SURFACE_RADIUS).flat[flat_indices])
    median_sigma_px = median(scene.sigma[scene.valid][::SIGMA_STRIDE])
    threshold = LOG_ODDS_AT_1_PX + np.log(median_sigma_px)
    wrong.flat[flat_indices] = log_odds + DEPTH_POWER * log_depth_ratio > threshold
    return wrong


def classified_pixels(scene: DisparityScene) -> IntArray:
    """Return the flat indices of the pixels that are classified: the valid pixels beside a jump."""
    return np.flatnonzero(_beside_jump(scene.disparity) & scene.valid)


def _beside_jump(disparity: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` at or near a disparity jump."""
    neighbours = square_element(3)
    jump = np.asarray(cv2.dilate(disparity, neighbours) - cv2.erode(disparity, neighbours), F) > SMALL_JUMP_PX
    return dilated(jump, SURFACE_RADIUS)


def jump_features(scene: DisparityScene, flat_indices: IntArray) -> JumpFeatures:
    """Return the features of the pixels with the given flat indices."""
    slope_x = slope_along_rows(scene.disparity)
    slope_y = slope_along_columns(scene.disparity)
    return _features(scene, slope_x, slope_y, flat_indices)


@jit_rows
def _features(scene: DisparityScene, slope_x: FloatImage, slope_y: FloatImage, flat_indices: IntArray) -> JumpFeatures:
    """Return the features of pixels, given the slopes `(H, W)` of the disparity along rows and along columns."""
    cols = scene.disparity.shape[1]
    count = len(flat_indices)
    window_margin = np.empty(count, F)
    close_margin = np.empty(count, F)
    effective_pixels = np.empty(count, F)
    window_cost = np.empty(count, F)
    close_cost = np.empty(count, F)
    jump_px = np.empty(count, F)
    contrast = np.empty(count, F)
    same_surface = np.empty(count, F)
    nearer_surface = np.empty(count, F)
    occluder_px = np.empty(count, F)
    for n in prange(count):
        y = flat_indices[n] // cols
        x = flat_indices[n] % cols
        costs = _surface_costs(scene, y, x)
        window_margin[n] = costs.window_margin
        close_margin[n] = costs.close_margin
        effective_pixels[n] = costs.own.effective_pixels
        window_cost[n] = costs.own.cost
        close_cost[n] = costs.own.close_cost
        jump_px[n] = costs.jump_px
        contrast[n], same_surface[n], nearer_surface[n] = _neighbourhood(scene, y, x)
        occluder_px[n] = _occluder(scene.disparity, y, x)
    return JumpFeatures(
        window_margin=window_margin,
        close_margin=close_margin,
        effective_pixels=effective_pixels,
        window_cost=window_cost,
        close_cost=close_cost,
        jump_px=jump_px,
        contrast=contrast,
        same_surface=same_surface,
        nearer_surface=nearer_surface,
        occluder_px=occluder_px,
        slope_x=slope_x.ravel()[flat_indices],
        slope_y=slope_y.ravel()[flat_indices],
        sigma_px=scene.sigma.ravel()[flat_indices],
    )


@jit_rows_inline
def _surface_costs(scene: DisparityScene, y: int, x: int) -> SurfaceCosts:
    """Return the costs of the pixel's surface and of the nearest or farthest surface nearby, whichever fits better."""
    rows, cols = scene.disparity.shape
    own = scene.disparity[y, x]
    low = own
    high = own
    for v in range(max(0, y - SURFACE_RADIUS), min(rows, y + SURFACE_RADIUS + 1)):
        for u in range(max(0, x - SURFACE_RADIUS), min(cols, x + SURFACE_RADIUS + 1)):
            if not np.isnan(scene.matched[v, u]):
                low = min(low, scene.disparity[v, u])
                high = max(high, scene.disparity[v, u])
    at_own = constant_cost(scene, y, x, own)
    best = NO_COST
    best_close = NO_COST
    jump = F(0.0)
    for other in (low, high):
        if abs(other - own) >= SURFACE_JUMP_PX:
            at_other = constant_cost(scene, y, x, other)
            if at_other.cost < best:
                best = at_other.cost
                best_close = at_other.close_cost
                jump = other - own
    return SurfaceCosts(at_own, best - at_own.cost, best_close - at_own.close_cost, jump)


@jit_rows_inline
def _neighbourhood(scene: DisparityScene, y: int, x: int) -> tuple[np.float32, np.float32, np.float32]:
    """Return the contrast of the window around a pixel, and the fractions on its own and on nearer surfaces.

    The fractions are weighted by similarity of grey level to the pixel. The contrast is not weighted.
    """
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
    contrast = np.sqrt(max(squares / count - mean * mean, F(0.0)))
    return contrast, same / weights, nearer / weights


@jit_rows_inline
def _occluder(disparity: FloatImage, y: int, x: int) -> np.float32:
    """Return by how much the disparity of the nearest surface at the same right pixel exceeds that of the pixel."""
    cols = disparity.shape[1]
    own = disparity[y, x]
    right_column = np.rint(F(x) - own)
    nearer = F(0.0)
    for u in range(max(0, x - OCCLUDER_COLUMNS), min(cols, x + OCCLUDER_COLUMNS + 1)):
        if abs(np.rint(F(u) - disparity[y, u]) - right_column) <= SAME_COLUMN_PX:
            nearer = max(nearer, disparity[y, u] - own)
    return nearer


def network_input(features: JumpFeatures) -> FloatArray32:
    """Return the features as numbers of order 1 `(N, 13)`.

    Costs are relative to the typical cost of the pair, because real images match less well than their noise explains.
    """
    typical = max(median(features.window_cost), MIN_TYPICAL_COST)
    has_other_surface = features.jump_px != 0.0

    def log_relative(grey: FloatArray32) -> FloatArray32:
        """Return the logarithm of a difference of grey levels relative to the typical cost."""
        return np.asarray(np.log(np.maximum(grey / typical, MIN_RELATIVE_COST)))

    def log_margin(margin: FloatArray32, scale: float) -> FloatArray32:
        """Return the signed logarithm of a margin relative to the typical cost, clipped."""
        clipped = np.clip(_signed_log(margin.astype(np.float64) * (scale / typical)), -MAX_LOG, MAX_LOG)
        return np.asarray(np.where(has_other_surface, clipped, MAX_LOG), F)

    inputs = JumpFeatures(
        window_margin=log_margin(features.window_margin, WINDOW_MARGIN_SCALE),
        close_margin=log_margin(features.close_margin, 1.0),
        effective_pixels=np.log(features.effective_pixels),
        window_cost=log_relative(features.window_cost),
        close_cost=log_relative(features.close_cost),
        jump_px=np.clip(_signed_log(features.jump_px), -MAX_LOG, MAX_LOG),
        contrast=log_relative(features.contrast),
        same_surface=features.same_surface,
        nearer_surface=features.nearer_surface,
        occluder_px=np.log1p(features.occluder_px),
        slope_x=features.slope_x,
        slope_y=features.slope_y,
        sigma_px=np.log(features.sigma_px),
    )
    return np.ascontiguousarray(np.column_stack(inputs), F)


def _signed_log(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return `sign(x) log(1 + |x|)`."""
    return np.asarray(np.sign(values) * np.log1p(np.abs(values)))


@cache
def jump_network() -> JumpNetwork:
    """Return the trained network."""
    text = files("sfr_loc_map.mapping.disparity.validity").joinpath("jump_network.json").read_text(encoding="utf-8")
    weights = json.loads(text)
    return JumpNetwork(*(np.asarray(weights[name], F) for name in JumpNetwork._fields))


@jit_rows
def _log_odds(network: JumpNetwork, inputs: FloatArray32) -> FloatArray32:
    """Return the output of the network `(N,)` for inputs `(N, 13)`: the log odds of the wrong surface."""
    low = network.low
    high = network.high
    hidden = network.hidden
    hidden_offset = network.hidden_offset
    output = network.output
    out = np.empty(len(inputs), F)
    for n in prange(len(inputs)):
        total = network.output_offset[0]
        for k in range(len(output)):
            unit = hidden_offset[k]
            for i in range(hidden.shape[1]):
                unit += hidden[k, i] * min(max(inputs[n, i], low[i]), high[i])
            total += output[k] * max(unit, F(0.0))
        out[n] = total
    return out

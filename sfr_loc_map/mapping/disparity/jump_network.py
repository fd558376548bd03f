"""The network that classifies pixels beside disparity jumps: the log odds that a pixel is on the wrong surface.

    scene -> classified_pixels -> jump_features -> network_input -> log odds (`log_odds_of_pixels`)

A network with one hidden layer classifies a pixel by thirteen features, such as the matching costs at the disparity of
the pixel and at the disparity of the other surface. The weights (`jump_network.json`) were trained on rendered ground
with known disparity (`tools/train_jump_network.py`). They are valid only for the features of the training. Train the
network again after a change of

- the constants below and in `matching_cost`, or the features themselves;
- the classified pixels: those that pass `validity.status_before_wrong_surface`, which depend on all earlier stages.

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
from sfr_loc_map.mapping.disparity.surfaces import SURFACE_JUMP_PX, slope_along_columns, slope_along_rows
from sfr_loc_map.mapping.filters import dilated, square_element

SMALL_JUMP_PX = F(0.7)
"""Disparities that differ by more than this may belong to two surfaces that the refinement has joined by a ramp,
pixels. Pixels beside jumps above 0.7 px have twice the total squared error of pixels beside jumps above 1.5 px
(measurements/mapper_trials.md). Costs are compared only with surfaces that differ by `SURFACE_JUMP_PX` or more."""
SURFACE_RADIUS = 3
"""Half the side of the window in which other surfaces are searched, pixels: smoothing moves edges by one or two
cells."""
OCCLUDER_COLUMNS = 6
"""Maximum distance, columns, of a surface along the row that may occlude the pixel in the right image: twice
`SURFACE_RADIUS`, because both edges may be displaced. Fixed by the training of the network."""
SAME_COLUMN_PX = F(1.0)
"""Pixels correspond to the same right pixel if their columns in the right image differ by up to this, pixels."""
SURROUNDING_COUNT = 10  #: The first ten `JumpFeatures` depend on the surrounding pixels.

# Conversion of features to inputs of the network.
MAX_LOG = 3.0
"""Logarithms of margins and jumps are clipped to +/- this value. The logarithm of a margin has this value if there is
no other surface."""
MIN_TYPICAL_COST = 0.5  #: Lower bound of the typical cost of a pair, grey levels: a typical rounding difference.
MIN_RELATIVE_COST = 0.05  #: Lower bound of the ratio of a cost to the typical cost, for the logarithm.
WINDOW_MARGIN_SCALE = 2.0  #: Factor of the window margin, which varies less than the margin of 3 x 3 pixels.


class JumpScene(NamedTuple):
    """Input of the classification, `(H, W)` each; `HoleScene` is the input of the filling of holes."""

    left: FloatImage  #: Grey levels, float32 with integer values.
    right: FloatImage  #: Corrected grey levels.
    disparity: FloatImage  #: Pixels.
    has_initial: Mask  #: Pixels that the semi-global matching has matched.
    valid: Mask  #: Pixels that passed the earlier tests.
    sigma: FloatImage  #: Standard deviation of the disparity, pixels.


class JumpFeatures(NamedTuple):
    """Features of N pixels `(N,)` float32 each; the network's weights are in this order."""

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


class Neighbourhood(NamedTuple):
    """Contrast and surfaces of the window around a pixel."""

    contrast: np.float32  #: Standard deviation of the grey levels.
    same_surface: np.float32  #: Weighted fraction on the surface of the pixel.
    nearer_surface: np.float32  #: Weighted fraction on nearer surfaces.


class JumpNetwork(NamedTuple):
    """A network with one hidden layer of K rectified linear units, float32."""

    low: FloatArray32  #: `(13,)`, smallest input in the training; inputs are clipped to the training range.
    high: FloatArray32  #: `(13,)`, largest input in the training.
    hidden: FloatArray32  #: `(K, 13)`, weights of the input.
    hidden_offset: FloatArray32  #: `(K,)`.
    output: FloatArray32  #: `(K,)`, weights of the hidden layer.
    output_offset: FloatArray32  #: `(1,)`.


def classified_pixels(scene: JumpScene) -> IntArray:
    """Return the flat indices of the pixels that are classified: the valid pixels beside a jump."""
    return np.flatnonzero(_beside_jump(scene.disparity) & scene.valid)


def log_odds_of_pixels(scene: JumpScene, flat_indices: IntArray) -> FloatArray32:
    """Return the log odds `(N,)` that the pixels with the given flat indices are on the wrong surface."""
    return _log_odds(jump_network(), network_input(jump_features(scene, flat_indices)))


def _beside_jump(disparity: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` at or near a disparity jump."""
    neighbours = square_element(3)
    jump = np.asarray(cv2.dilate(disparity, neighbours) - cv2.erode(disparity, neighbours), F) > SMALL_JUMP_PX
    return dilated(jump, SURFACE_RADIUS)


def jump_features(scene: JumpScene, flat_indices: IntArray) -> JumpFeatures:
    """Return the features of the pixels with the given flat indices."""
    slope_x = slope_along_rows(scene.disparity).flat[flat_indices]
    slope_y = slope_along_columns(scene.disparity).flat[flat_indices]
    sigma_px = scene.sigma.flat[flat_indices]
    surroundings = _features_of_surroundings(scene, flat_indices)
    return JumpFeatures._make([*surroundings, slope_x, slope_y, sigma_px])


@jit_rows
def _features_of_surroundings(scene: JumpScene, flat_indices: IntArray) -> FloatArray32:
    """Return the first ten `JumpFeatures` `(10, N)`, which depend on the surrounding pixels."""
    cols = scene.disparity.shape[1]
    features = np.empty((SURROUNDING_COUNT, len(flat_indices)), F)
    for n in prange(len(flat_indices)):
        y = flat_indices[n] // cols
        x = flat_indices[n] % cols
        costs = _surface_costs(scene, y, x)
        around = _neighbourhood(scene, y, x)
        in_order = (
            costs.window_margin,
            costs.close_margin,
            costs.own.effective_pixels,
            costs.own.cost,
            costs.own.close_cost,
            costs.jump_px,
            around.contrast,
            around.same_surface,
            around.nearer_surface,
            _occluder(scene.disparity, y, x),
        )
        for k in range(SURROUNDING_COUNT):
            features[k, n] = in_order[k]
    return features


@jit_rows_inline
def _surface_costs(scene: JumpScene, y: int, x: int) -> SurfaceCosts:
    """Return the costs of the pixel's surface and of the nearest or farthest surface nearby, whichever fits better."""
    rows, cols = scene.disparity.shape
    own = scene.disparity[y, x]
    low = own
    high = own
    for v in range(max(0, y - SURFACE_RADIUS), min(rows, y + SURFACE_RADIUS + 1)):
        for u in range(max(0, x - SURFACE_RADIUS), min(cols, x + SURFACE_RADIUS + 1)):
            if scene.has_initial[v, u]:
                low = min(low, scene.disparity[v, u])
                high = max(high, scene.disparity[v, u])
    at_own = constant_cost(scene.left, scene.right, y, x, own)
    best = NO_COST
    best_close = NO_COST
    jump = F(0.0)
    for other in (low, high):
        if abs(other - own) >= SURFACE_JUMP_PX:
            at_other = constant_cost(scene.left, scene.right, y, x, other)
            if at_other.cost < best:
                best = at_other.cost
                best_close = at_other.close_cost
                jump = other - own
    return SurfaceCosts(at_own, best - at_own.cost, best_close - at_own.close_cost, jump)


@jit_rows_inline
def _neighbourhood(scene: JumpScene, y: int, x: int) -> Neighbourhood:
    """Return the contrast and the surfaces of the window around a pixel, weighted by similarity of grey level."""
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
    return Neighbourhood(contrast, same / weights, nearer / weights)


@jit_rows_inline
def _occluder(disparity: FloatImage, y: int, x: int) -> np.float32:
    """Return the disparity of the nearest surface at the same right pixel minus that of the pixel, at least 0."""
    cols = disparity.shape[1]
    own = disparity[y, x]
    right_column = np.rint(F(x) - own)
    nearer = F(0.0)
    for u in range(max(0, x - OCCLUDER_COLUMNS), min(cols, x + OCCLUDER_COLUMNS + 1)):
        if abs(np.rint(F(u) - disparity[y, u]) - right_column) <= SAME_COLUMN_PX:
            nearer = max(nearer, disparity[y, u] - own)
    return nearer


def network_input(features: JumpFeatures) -> FloatArray32:
    """Return the features as numbers of order 1 `(N, 13)`, in the order of `JumpFeatures`.

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

    inputs = (
        log_margin(features.window_margin, WINDOW_MARGIN_SCALE),
        log_margin(features.close_margin, 1.0),
        np.log(features.effective_pixels),
        log_relative(features.window_cost),
        log_relative(features.close_cost),
        np.clip(_signed_log(features.jump_px), -MAX_LOG, MAX_LOG),
        log_relative(features.contrast),
        features.same_surface,
        features.nearer_surface,
        np.log1p(features.occluder_px),
        features.slope_x,
        features.slope_y,
        np.log(features.sigma_px),
    )
    return np.ascontiguousarray(np.column_stack(inputs), F)


def _signed_log(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return `sign(x) log(1 + |x|)`."""
    return np.asarray(np.sign(values) * np.log1p(np.abs(values)))


@cache
def jump_network() -> JumpNetwork:
    """Return the trained network."""
    text = files("sfr_loc_map.mapping.disparity").joinpath("jump_network.json").read_text(encoding="utf-8")
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

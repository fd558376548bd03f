"""Pixels without a valid disparity take that of a surface beside them, where the images say which.

The hypotheses of a pixel are the surfaces that it meets along eight directions, continued as planes. Each is judged by
the images: the matching cost over the pixels around, mostly those that have no disparity either. The scale is the cost
of valid pixels beside holes in the same pair. Two surfaces cannot be seen at one pixel of the right image.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, IntArray, Mask
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.edge_evidence import (
    LARGE,
    MAX_DIFFERENCE,
    OTHER_SURFACE_PX,
    RADIUS,
    WEIGHT_BY_DISTANCE,
    WEIGHT_BY_GREY,
)
from sfr_loc_map.mapping.disparity.filters import depth_ratio, within

F = np.float32

PASSES = 2  #: What was filled offers its surface to its neighbours in the next pass.
REACH = 12  #: Rows or columns within which a surface is a hypothesis.
SLOPE_PX = 2  #: Distance over which a surface's slope is taken, pixels.
VALID_WEIGHT = F(0.3)
"""Weight in a window of pixels that have a disparity: they would only repeat what they were found to be."""
COST_PERCENTILE = 93.0
"""A filled pixel matches no worse than so many percent of the valid pixels beside holes: `BESIDE` pixels or less from
one. Every `SAMPLE`th of them is taken."""
BESIDE, SAMPLE, MIN_SAMPLES = 3, 5, 50
MARGIN_SIGMAS = 1.5  #: Margin in matching cost over any other hypothesis, in standard deviations of noise.
ASIDE_PX = F(2.0)  #: A surface that nothing else confirms must match better than disparities so far to either side.
SAME_PX = F(0.5)  #: Hypotheses that differ by less are judged once.
MIN_ALIKE = 5  #: Of the eight pixels around a filled one so many must belong to its surface.
FILLED_SIGMA_PX = F(0.5)
"""Smallest standard deviation of a filled disparity. The root of the mean squared error was 0.2 to 0.9 on rendered
ground, two thirds of them were within 0.16 to 0.3."""
MAX_DEPTH_RATIO, NEAR_PX = F(4.0), 7
"""A hole takes no surface that is so many times as far as another one within so many pixels, as behind the rim of a
crater: one such pixel in ten thousand would be most of the error of a map."""
_DIRECTIONS = np.array([[0, 1], [0, -1], [1, 0], [-1, 0], [1, 1], [-1, -1], [1, -1], [-1, 1]])
"""Rows and columns of a step; opposite directions follow each other."""


class HoleScene(NamedTuple):
    """What a pass fills, `(H, W)` each."""

    left: FloatImage  # whole grey levels
    right: FloatImage  # grey levels, corrected
    disparity: FloatImage  # pixels
    valid: Mask  # whose disparities count as surfaces
    open: Mask  # which pixels may be filled
    matched: FloatImage  # pixels, what the matcher found, NaN for nothing
    distance: FloatImage  # rows or columns to a valid pixel


class Claims(NamedTuple):
    """Smallest and largest disparity `(H, W)` of the pixels that correspond to each pixel of the right image."""

    low: FloatImage
    high: FloatImage


def fill_holes(
    left: FloatImage,
    right: FloatImage,
    disparity: FloatImage,
    valid: Mask,
    matched: FloatImage,
    noise: float,
    may: Mask,
) -> tuple[FloatImage, Mask]:
    """Return the disparities with those of pixels that take a surface beside them, and which these are.

    Images and masks are `(H, W)`. Valid disparities count as surfaces; what the matcher found is NaN for nothing; the
    noise is the standard deviation of a residual, grey levels; pixels are filled where they may.
    """
    known, beside = valid, may
    chosen = np.flatnonzero(within(~valid, BESIDE) & valid)[::SAMPLE]
    costs = own_costs(HoleScene(left, right, disparity, valid, ~valid, matched, disparity), chosen)
    limit = np.percentile(costs, COST_PERCENTILE) if len(costs) >= MIN_SAMPLES else 0.0
    for _ in range(PASSES if limit > 0.0 else 0):
        distance = np.asarray(cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_C, 3), F)
        scene = HoleScene(left, right, disparity, known, beside & ~known, matched, distance)
        found = fill_pass(scene, right_claims(disparity, known), F(limit), F(MARGIN_SIGMAS * noise))
        added = np.isfinite(found)
        merged, either = np.where(added, found, disparity), known | added
        added = confirmed(merged, either, added, right_claims(merged, either))
        disparity, known = np.where(added, found, disparity), known | added
        beside = may & within(added, REACH)
    near_enough = depth_ratio(np.where(known, disparity, F(0.0)), NEAR_PX) < MAX_DEPTH_RATIO
    return disparity, known & ~valid & near_enough


@jit_rows
def fill_pass(scene: HoleScene, claims: Claims, limit: np.float32, margin: np.float32) -> FloatImage:
    """Return the disparities `(H, W)` of the open pixels that one pass fills, NaN elsewhere.

    In grey levels of cost: the limit for a filled pixel, and the margin over other hypotheses of a window that is worth
    one pixel.
    """
    rows, cols = scene.disparity.shape
    out = np.full((rows, cols), F(np.nan))
    for n in prange(rows):
        # Even rows first, then odd ones: each of two threads gets as many holes as the other.
        y = 2 * n if 2 * n < rows else 2 * n - rows + 1 - rows % 2
        for x in range(cols):
            if scene.open[y, x] and scene.distance[y, x] <= REACH:
                out[y, x] = _filled(scene, claims, limit, margin, y, x)
    return out


@jit_rows_inline
def _filled(scene: HoleScene, claims: Claims, limit: np.float32, margin: np.float32, y: int, x: int) -> np.float32:
    """Return the disparity of the best hypothesis of a pixel, NaN if none is good enough.

    Where the field agrees with it, it is the field's.
    """
    found = hypotheses(scene, y, x)
    possible, count = np.zeros(8, np.bool_), 0
    for k in range(8):
        possible[k] = not _is_contradicted(found[k, 0], claims, y, x)
        count += possible[k]
    if count == 0:
        return F(np.nan)
    cost, worth = _costs(scene, y, x, found)
    best, lowest = 0, LARGE
    for k in range(8):
        if possible[k] and cost[k] < lowest:
            best, lowest = k, cost[k]
    disparity: np.float32 = found[best, 0]
    rival, enclosed = LARGE, False
    for k in range(8):
        if abs(found[k, 0] - disparity) > OTHER_SURFACE_PX:
            rival = min(rival, cost[k])
    needed = cost[best] + margin / np.sqrt(worth[best])
    if not (possible[best] and cost[best] <= limit and rival >= needed):
        return F(np.nan)
    for k in range(0, 8, 2):  # met in two opposite directions
        opposite = abs(found[k + 1, 0] - disparity) < OTHER_SURFACE_PX
        enclosed |= abs(found[k, 0] - disparity) < OTHER_SURFACE_PX and opposite
    if not (enclosed or abs(scene.matched[y, x] - disparity) < OTHER_SURFACE_PX):
        for side in (-ASIDE_PX, ASIDE_PX):
            if plane_cost(scene, y, x, disparity + side, found[best, 1], found[best, 2])[0] < needed:
                return F(np.nan)
    own: np.float32 = scene.disparity[y, x]
    return own if abs(own - disparity) < OTHER_SURFACE_PX else disparity


@jit_rows_inline
def _costs(scene: HoleScene, y: int, x: int, found: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the matching cost of each hypothesis `(8,)`, and how many pixels its window is worth."""
    cost, worth = np.full(8, LARGE), np.ones(8, F)
    for k in range(8):
        if found[k, 0] == found[k, 0]:
            first = 0
            while first < k and not abs(found[first, 0] - found[k, 0]) < SAME_PX:
                first += 1
            if first < k:
                cost[k], worth[k] = cost[first], worth[first]
            else:
                cost[k], worth[k] = plane_cost(scene, y, x, found[k, 0], found[k, 1], found[k, 2])
    return cost, worth


@jit_rows_inline
def hypotheses(scene: HoleScene, y: int, x: int) -> FloatImage:
    """Return the first surface along each direction, continued to the pixel as a plane `(8, 3)`; NaN if there is none.

    Columns: disparity at the pixel, and its slope along rows and columns, pixels for each pixel.
    """
    rows, cols = scene.disparity.shape
    found = np.full((8, 3), F(np.nan))
    for k in range(8):
        dy, dx = _DIRECTIONS[k, 0], _DIRECTIONS[k, 1]
        s = int(scene.distance[y, x])
        while s <= REACH:
            v, u = y + s * dy, x + s * dx
            if not (0 <= v < rows and 0 <= u < cols):
                break
            if scene.valid[v, u]:
                slope_x, slope_y = _surface_slope(scene, v, u, 0, 1), _surface_slope(scene, v, u, 1, 0)
                found[k, 0] = scene.disparity[v, u] - F(s) * (slope_x * F(dx) + slope_y * F(dy))
                found[k, 1], found[k, 2] = slope_x, slope_y
                break
            s += int(scene.distance[v, u])
    return found


@jit_rows_inline
def _surface_slope(scene: HoleScene, y: int, x: int, dy: int, dx: int) -> np.float32:
    """Return the slope of a valid pixel's surface along an axis, from what is valid on either side."""
    rows, cols = scene.disparity.shape
    centre = scene.disparity[y, x]
    rise, run = F(0.0), F(0.0)
    for side in (-SLOPE_PX, SLOPE_PX):
        v, u = y + side * dy, x + side * dx
        if 0 <= v < rows and 0 <= u < cols and scene.valid[v, u]:
            step = scene.disparity[v, u] - centre
            if abs(step) < OTHER_SURFACE_PX:
                rise += step if side > 0 else -step
                run += F(SLOPE_PX)
    slope: np.float32 = rise / max(run, F(1.0))
    return slope


@jit_rows_inline
def plane_cost(
    scene: HoleScene, y: int, x: int, disparity: np.float32, slope_x: np.float32, slope_y: np.float32
) -> tuple[np.float32, np.float32]:
    """Return the weighted mean absolute difference around a pixel, grey levels, and how many pixels that is worth."""
    left, right = scene.left, scene.right
    rows, cols = left.shape
    total, weights, squares = F(0.0), F(0.0), F(0.0)
    for v in range(max(0, y - RADIUS), min(rows, y + RADIUS + 1)):
        start = F(x) - disparity - slope_y * F(v - y)
        for u in range(max(0, x - RADIUS), min(cols, x + RADIUS + 1)):
            column = start + (F(1.0) - slope_x) * F(u - x)
            if not (column >= F(0.0) and column < F(cols - 1)):
                continue
            k = int(column)
            value = right[v, k] + (column - F(k)) * (right[v, k + 1] - right[v, k])
            weight = WEIGHT_BY_GREY[int(abs(left[v, u] - left[y, x]))]
            weight *= WEIGHT_BY_DISTANCE[v - y + RADIUS, u - x + RADIUS]
            weight *= VALID_WEIGHT if scene.valid[v, u] else F(1.0)
            total += weight * min(abs(value - left[v, u]), MAX_DIFFERENCE)
            weights += weight
            squares += weight * weight
    if not weights > F(0.0):
        return LARGE, F(0.0)
    return total / weights, weights * weights / squares


@jit_rows
def own_costs(scene: HoleScene, chosen: IntArray) -> FloatImage:
    """Return the matching costs `(N,)` of valid pixels, given by their places in the flat image."""
    cols = scene.disparity.shape[1]
    out = np.empty(len(chosen), F)
    for n in prange(len(chosen)):
        y, x = chosen[n] // cols, chosen[n] % cols
        slope_x, slope_y = _surface_slope(scene, y, x, 0, 1), _surface_slope(scene, y, x, 1, 0)
        out[n] = plane_cost(scene, y, x, scene.disparity[y, x], slope_x, slope_y)[0]
    return out


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
def _is_contradicted(disparity: np.float32, claims: Claims, y: int, x: int) -> bool:
    """Tell whether the partner of a pixel lies outside the right image or belongs to another surface."""
    column = F(x) - disparity
    if not (column >= F(0.0) and column < F(claims.low.shape[1] - 1)):
        return True
    u = int(np.rint(column))
    nearer: bool = claims.high[y, u] > disparity + OTHER_SURFACE_PX
    farther: bool = claims.low[y, u] < disparity - OTHER_SURFACE_PX
    return nearer or farther


@jit_rows
def confirmed(disparity: FloatImage, known: Mask, added: Mask, claims: Claims) -> Mask:
    """Tell which added pixels `(H, W)` are no single ones and have a partner that is no other surface's.

    Added pixels are known; claims are of the known ones.
    """
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        for x in range(cols):
            if not added[y, x] or _is_contradicted(disparity[y, x], claims, y, x):
                continue
            alike = -1  # without the pixel itself
            for v in range(max(0, y - 1), min(rows, y + 2)):
                for u in range(max(0, x - 1), min(cols, x + 2)):
                    if known[v, u] and abs(disparity[v, u] - disparity[y, x]) < OTHER_SURFACE_PX:
                        alike += 1
            out[y, x] = alike >= MIN_ALIKE
    return out

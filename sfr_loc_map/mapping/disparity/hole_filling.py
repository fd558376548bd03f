"""Pixels without a valid disparity take that of a surface beside them, where the images say which.

The hypotheses of a pixel are the surfaces that it meets along eight directions, continued as planes. Each is judged by
the images: the matching cost over the pixels around, mostly those that have no disparity either. The scale is the cost
of valid pixels beside holes in the same pair.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.filters import depth_ratio
from sfr_loc_map.mapping.disparity.occlusion import LARGE, OTHER_SURFACE_PX
from sfr_loc_map.mapping.disparity.partner_claims import Claims, confirmed, is_contradicted, right_claims
from sfr_loc_map.mapping.disparity.surface_hypotheses import (
    REACH,
    Field,
    Images,
    Plane,
    hypotheses,
    own_costs,
    plane_cost,
)

F = np.float32

PASSES = 2
"""What was filled offers its surface to its neighbours in the next pass."""
COST_PERCENTILE = 90.0
"""A filled pixel matches no worse than so many percent of the valid pixels beside holes: `BESIDE` pixels or less from
one. Every `SAMPLE`th of them is taken."""
BESIDE, SAMPLE, MIN_SAMPLES = 3, 5, 50
MARGIN_SIGMAS = 1.5
"""Margin in matching cost over any other hypothesis, in standard deviations of noise."""
ASIDE_PX = F(2.0)
"""A surface that nothing else confirms must match better than disparities so far to either side."""
SAME_PX = F(0.5)
"""Hypotheses that differ by less are judged once."""
FILLED_SIGMA_PX = F(0.5)
"""Smallest standard deviation of a filled disparity. The root of the mean squared error was 0.2 to 0.9 on rendered
ground, two thirds of them were within 0.16 to 0.3."""


MAX_DEPTH_RATIO, NEAR_PX = F(4.0), 7
"""A hole takes no surface that is so many times as far as another one within so many pixels, as behind the rim of a
crater: one such pixel in ten thousand would be most of the error of a map."""


class Filled(NamedTuple):
    """Disparities `(H, W)` with those of holes that were filled, and which these are."""

    disparity: FloatImage
    filled: Mask


def fill_holes(
    images: Images, disparity: FloatImage, valid: Mask, matched: FloatImage, noise: float, may: Mask
) -> Filled:
    """Return the disparities with those of pixels that take a surface beside them.

    Args:
        images: What is matched.
        disparity: `(H, W)`, pixels.
        valid: `(H, W)`, which of them count.
        matched: `(H, W)`, pixels, what the matcher found, NaN for nothing.
        noise: Standard deviation of a residual, grey levels.
        may: `(H, W)`, which pixels may be filled.
    """
    known, beside = valid, may
    limit = _cost_limit(images, Field(disparity, valid, ~valid, matched, disparity))
    for _ in range(PASSES if limit > 0.0 else 0):
        present = Field(disparity, known, beside & ~known, matched, distance_to(known))
        found = fill_pass(images, present, right_claims(disparity, known), F(limit), F(MARGIN_SIGMAS * noise))
        added = np.isfinite(found)
        merged, either = np.where(added, found, disparity), known | added
        added = confirmed(merged, either, added, right_claims(merged, either))
        disparity, known = np.where(added, found, disparity), known | added
        beside = may & within(added, REACH)
    near_enough = depth_ratio(np.where(known, disparity, F(0.0)), NEAR_PX) < MAX_DEPTH_RATIO
    return Filled(disparity, known & ~valid & near_enough)


def distance_to(valid: Mask) -> FloatImage:
    """Return how many rows or columns, whichever is more, each pixel is from a valid one."""
    return np.asarray(cv2.distanceTransform((~valid).astype(np.uint8), cv2.DIST_C, 3), F)


def within(pixels: Mask, reach: int) -> Mask:
    """Tell which pixels are within so many rows and columns of one that is set."""
    square = np.ones((2 * reach + 1,) * 2, np.uint8)
    return np.asarray(cv2.dilate(pixels.astype(np.uint8), square)).astype(np.bool_)


def _cost_limit(images: Images, field: Field) -> float:
    """Return the matching cost that a filled pixel may have, grey levels; 0 if too little is known."""
    beside = within(field.open, BESIDE) & field.valid
    chosen = np.flatnonzero(beside)[::SAMPLE]
    if len(chosen) < MIN_SAMPLES:
        return 0.0
    return float(np.percentile(own_costs(images, field, chosen), COST_PERCENTILE))


@jit_rows_inline
def _enclosed(found: FloatImage, best: np.float32) -> bool:
    """Tell whether one surface is met in two opposite directions."""
    for k in range(0, len(found), 2):
        if abs(found[k, 0] - best) < OTHER_SURFACE_PX and abs(found[k + 1, 0] - best) < OTHER_SURFACE_PX:
            return True
    return False


@jit_rows_inline
def _judged_before(found: FloatImage, k: int) -> int:
    """Return the first hypothesis of the same disparity."""
    for i in range(k):
        if abs(found[i, 0] - found[k, 0]) < SAME_PX:
            return i
    return k


@jit_rows_inline
def _costs(images: Images, valid: Mask, y: int, x: int, found: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Return the matching cost of each hypothesis `(8,)`, and how many pixels its window is worth."""
    cost, worth = np.full(8, LARGE), np.ones(8, F)
    for k in range(8):
        if found[k, 0] == found[k, 0]:
            before = _judged_before(found, k)
            if before < k:
                cost[k], worth[k] = cost[before], worth[before]
            else:
                plane = Plane(found[k, 0], found[k, 1], found[k, 2])
                cost[k], worth[k] = plane_cost(images, valid, y, x, plane)
    return cost, worth


@jit_rows_inline
def _other_cost(found: FloatImage, cost: FloatImage, disparity: np.float32) -> np.float32:
    """Return the lowest cost among the hypotheses of other surfaces."""
    lowest = LARGE
    for k in range(8):
        if abs(found[k, 0] - disparity) > OTHER_SURFACE_PX:
            lowest = min(lowest, cost[k])
    return lowest


@jit_rows_inline
def _cost_aside(images: Images, valid: Mask, y: int, x: int, plane: Plane) -> np.float32:
    """Return the lower cost of the disparities to either side of a plane's."""
    lowest = LARGE
    for side in (-ASIDE_PX, ASIDE_PX):
        aside = Plane(plane.disparity + side, plane.slope_x, plane.slope_y)
        lowest = min(lowest, plane_cost(images, valid, y, x, aside)[0])
    return lowest


@jit_rows_inline
def _cheapest(cost: FloatImage, possible: Mask) -> int:
    """Return the possible hypothesis of the lowest cost, the first of equals; one without a cost is taken at once."""
    best, lowest = 0, LARGE
    for k in range(8):
        if possible[k] and (cost[k] < lowest or np.isnan(cost[k])):
            best, lowest = k, cost[k]
            if np.isnan(lowest):
                break
    return best


@jit_rows_inline
def _filled(
    images: Images, field: Field, claims: Claims, limit: np.float32, margin: np.float32, y: int, x: int
) -> np.float32:
    """Return the disparity of the best hypothesis of a pixel, NaN if none is good enough.

    Where the field agrees with it, it is the field's.
    """
    found = hypotheses(field, y, x)
    possible, count = np.zeros(8, np.bool_), 0
    for k in range(8):
        possible[k] = not is_contradicted(found[k, 0], claims, y, x)
        count += possible[k]
    if count == 0:
        return F(np.nan)
    cost, worth = _costs(images, field.valid, y, x, found)
    best = _cheapest(cost, possible)
    disparity: np.float32 = found[best, 0]
    needed = cost[best] + margin / np.sqrt(worth[best])
    if not (possible[best] and cost[best] <= limit and _other_cost(found, cost, disparity) >= needed):
        return F(np.nan)
    if not (_enclosed(found, disparity) or abs(field.matched[y, x] - disparity) < OTHER_SURFACE_PX):
        plane = Plane(disparity, found[best, 1], found[best, 2])
        if _cost_aside(images, field.valid, y, x, plane) < needed:
            return F(np.nan)
    own: np.float32 = field.disparity[y, x]
    return own if abs(own - disparity) < OTHER_SURFACE_PX else disparity


@jit_rows
def fill_pass(images: Images, field: Field, claims: Claims, limit: np.float32, margin: np.float32) -> FloatImage:
    """Return the disparities `(H, W)` of the open pixels that one pass fills, NaN elsewhere.

    Args:
        images: What is matched.
        field: Valid disparities are hypotheses, open pixels are filled.
        claims: Of the valid disparities.
        limit: Largest matching cost, grey levels.
        margin: In matching cost over other hypotheses, of a window that is worth one pixel, grey levels.
    """
    rows, cols = field.disparity.shape
    out = np.full((rows, cols), F(np.nan))
    for n in prange(rows):
        # Even rows first, then odd ones: each of two threads gets as many holes as the other.
        y = 2 * n if 2 * n < rows else 2 * n - rows + 1 - rows % 2
        for x in range(cols):
            if field.open[y, x] and field.distance[y, x] <= REACH:
                out[y, x] = _filled(images, field, claims, limit, margin, y, x)
    return out

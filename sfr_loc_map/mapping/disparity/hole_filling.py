"""Filling of invalid pixels with the disparity of a surface beside them, if both images support it.

A hole is a region of invalid pixels. The hypotheses of a pixel are the nearest surfaces along eight directions,
extrapolated as planes (`_find_hypotheses`). Each hypothesis has a matching cost over the neighbourhood of the pixel, in
which invalid pixels have a larger weight than valid pixels. A pixel is filled if all of these conditions are met.

Each pass of `fill_holes` selects the pixels that may be filled:

1. The neighbourhood of the pixel is not completely saturated.
2. A measured pixel, or in later passes a pixel that was filled in the previous pass, is within `REACH`. For all other
   pixels, the hypotheses are the same as in the previous pass.

`_propose` chooses a hypothesis (`_best_hypothesis`):

3. A hypothesis is possible: the corresponding pixel is inside the right image and belongs to no other surface
   (`_is_contradicted`). The possible hypothesis with the lowest cost is chosen.
4. Its cost is at most the `COST_PERCENTILE` of the costs of valid pixels beside holes in the same pair (`_cost_limit`).
5. Every hypothesis of another surface costs more by a margin of `MARGIN_SIGMAS`, divided by the root of the effective
   number of pixels. Hypotheses that are not possible count, too: if the images also match on such a surface, the
   matching costs are ambiguous, and the pixel is not filled.
6. The hypothesis is confirmed (`_is_confirmed`): its surface is on opposite sides of the pixel, or the matcher agrees,
   or its cost is lower by the margin than at disparities `ALTERNATIVE_PX` to either side.

`_accept` compares the proposals with their neighbours:

7. At least `MIN_SAME_SURFACE` of the eight neighbours of the pixel are on the surface of the hypothesis. Neighbours
   count if they are valid or proposed in the same pass. The corresponding pixel in the right image belongs to no other
   surface, even if all proposed pixels are included.

After all passes, `fill_holes` compares depths:

8. The depth of the pixel is less than `MAX_DEPTH_RATIO` times the depth of the nearest surface within `NEARBY_PX`.

Limits and alternatives are described in measurements/mapper_trials.md.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatArray32, FloatImage, IntArray, Mask
from sfr_loc_map.jit import interleaved_row, jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.matching_cost import NO_COST, plane_cost
from sfr_loc_map.mapping.disparity.surfaces import (
    SURFACE_JUMP_PX,
    DisparityScene,
    RightSurfaces,
    depth_ratio,
    right_surfaces,
)
from sfr_loc_map.mapping.filters import dilated, with_pixels_of, with_value

REACH = 12  #: Maximum distance over which a plane is extrapolated, rows or columns.
SLOPE_PX = 2  #: Distance over which the slope of a surface is measured, pixels: one cell of the refined field.
DIRECTIONS = np.array([[0, 1], [0, -1], [1, 0], [-1, 0], [1, 1], [-1, -1], [1, -1], [-1, 1]])
"""Row and column step of each direction; opposite directions follow each other."""
DIRECTION_COUNT = len(DIRECTIONS)  #: Number of hypotheses of a pixel.
PASSES = 2  #: Number of passes. Pixels filled in one pass provide hypotheses for their neighbours in the next pass.
COST_PERCENTILE = 93.0
"""The maximum cost of a filled pixel is this percentile of the costs of valid pixels beside holes."""
BESIDE_HOLE_PX = 3  #: Distance from a hole within which a valid pixel is beside the hole, pixels.
COST_STRIDE = 5  #: Every fifth valid pixel beside holes is used for the percentile.
MIN_SAMPLES = 50  #: Minimum number of samples for the percentile.
MARGIN_SIGMAS = 1.5  #: Required cost margin to other hypotheses, in standard deviations of the noise of one pixel.
ALTERNATIVE_PX = F(2.0)
"""Offset of the disparities on either side with which an unconfirmed hypothesis is compared, pixels."""
SAME_HYPOTHESIS_PX = F(0.5)  #: Hypotheses whose disparities differ by less are evaluated once, pixels.
MIN_SAME_SURFACE = 5  #: Minimum number of the eight neighbours that are on the surface of a filled pixel.
MIN_FILLED_SIGMA_PX = F(0.5)
"""Minimum standard deviation of a filled disparity, pixels. The refined field does not contain the surface of a hole,
so that its sigma can be too small there."""
MAX_DEPTH_RATIO = F(4.0)
"""A filled pixel must be nearer than this multiple of the depth of a nearby surface. Otherwise a pixel behind the rim
of a crater could dominate the error of a map."""
NEARBY_PX = 7  #: Distance within which depths are compared, rows or columns.


class Hypotheses(NamedTuple):
    """The nearest surface along each direction as a plane at a pixel, `(8,)` each; NaN without a surface."""

    disparity: FloatArray32  #: Disparity of the plane at the pixel, pixels.
    slope_x: FloatArray32  #: Slope of the plane along rows, pixels per pixel.
    slope_y: FloatArray32  #: Slope of the plane along columns, pixels per pixel.


def fill_holes(scene: DisparityScene, saturated: Mask, noise_grey: float) -> DisparityScene:
    """Return the scene with the disparities and sigmas of filled holes.

    The valid pixels of the returned scene are the measured and the filled pixels. Pixels of completely saturated
    neighbourhoods are not filled.

    The valid pixels of the given scene are measured. The standard deviation of a filled disparity is at least
    `MIN_FILLED_SIGMA_PX`. No hole is filled if fewer than `MIN_SAMPLES` samples are available for the maximum cost.
    `saturated` `(H, W)` is `Saturation.square_saturated`, and `noise_grey` is the noise of a residual.
    """
    cost_limit = _cost_limit(scene)
    if cost_limit is None:
        return scene
    min_margin = F(MARGIN_SIGMAS * noise_grey)
    after = scene
    newly_valid = scene.valid
    for _ in range(PASSES):
        has_new_hypotheses = dilated(newly_valid, REACH)
        fillable = ~saturated & has_new_hypotheses & ~after.valid
        proposed_px = _propose(after, fillable, cost_limit, min_margin)
        newly_valid = _accept(after, proposed_px)
        after = after._replace(
            disparity=with_pixels_of(proposed_px, newly_valid, after.disparity), valid=after.valid | newly_valid
        )
    # Depths are compared after all passes. A rejected pixel may therefore have provided a hypothesis in a later pass.
    valid_px = with_value(F(0.0), ~after.valid, after.disparity)
    is_filled = after.valid & ~scene.valid & (depth_ratio(valid_px, NEARBY_PX) < MAX_DEPTH_RATIO)
    return scene._replace(
        disparity=with_pixels_of(after.disparity, is_filled, scene.disparity),
        sigma=with_pixels_of(np.maximum(scene.sigma, MIN_FILLED_SIGMA_PX), is_filled, scene.sigma),
        valid=scene.valid | is_filled,
    )


def _cost_limit(scene: DisparityScene) -> np.float32 | None:
    """Return the maximum matching cost of a filled pixel, grey levels; None if too few pixels are beside holes."""
    beside_holes = np.flatnonzero(dilated(~scene.valid, BESIDE_HOLE_PX) & scene.valid)
    costs = _own_costs(scene, beside_holes[::COST_STRIDE])
    if len(costs) < MIN_SAMPLES:
        return None
    return F(np.percentile(costs, COST_PERCENTILE))


def _propose(scene: DisparityScene, fillable: Mask, cost_limit: np.float32, min_margin: np.float32) -> FloatImage:
    """Return the disparities `(H, W)` that a pass proposes for fillable pixels, NaN elsewhere.

    `cost_limit` is the maximum cost of a filled pixel, and `min_margin` the required margin to other hypotheses for a
    window of one effective pixel, both in grey levels.
    """
    distance = np.asarray(cv2.distanceTransform((~scene.valid).astype(np.uint8), cv2.DIST_C, 3), F)
    surfaces = right_surfaces(scene.disparity, scene.valid)
    return _best_hypotheses(scene, fillable, distance, surfaces, cost_limit, min_margin)


def _accept(scene: DisparityScene, proposed_px: FloatImage) -> Mask:
    """Return the mask of the pixels `(H, W)` whose proposed disparity is accepted."""
    is_proposed = np.isfinite(proposed_px)
    px = with_pixels_of(proposed_px, is_proposed, scene.disparity)
    valid = scene.valid | is_proposed
    return _on_their_surface(px, valid, is_proposed, right_surfaces(px, valid))


@jit_rows
def _best_hypotheses(
    scene: DisparityScene,
    fillable: Mask,
    distance: FloatImage,
    surfaces: RightSurfaces,
    cost_limit: np.float32,
    min_margin: np.float32,
) -> FloatImage:
    """Return the disparities of the best hypotheses `(H, W)` of fillable pixels, NaN if none meets the conditions.

    `distance` `(H, W)` is the distance to the nearest valid pixel, rows or columns. `surfaces` are the surfaces of the
    valid pixels in the right image.
    """
    rows, cols = scene.disparity.shape
    out = np.full((rows, cols), F(np.nan))
    for k in prange(rows):
        y = interleaved_row(k, rows)
        for x in range(cols):
            if fillable[y, x]:
                hypotheses = _find_hypotheses(scene, distance, y, x)
                out[y, x] = _best_hypothesis(scene, hypotheses, surfaces, cost_limit, min_margin, y, x)
    return out


@jit_rows_inline
def _find_hypotheses(scene: DisparityScene, distance: FloatImage, y: int, x: int) -> Hypotheses:
    """Return the nearest surface along each direction, extrapolated to the pixel as a plane.

    `distance` `(H, W)` is the distance to the nearest valid pixel, rows or columns. All pixels nearer than it are
    invalid, so the search along a direction advances by this distance.
    """
    rows, cols = scene.disparity.shape
    planes = np.full((3, DIRECTION_COUNT), F(np.nan))
    disparities = planes[0]
    slopes_x = planes[1]
    slopes_y = planes[2]
    for k in range(DIRECTION_COUNT):
        dy = DIRECTIONS[k, 0]
        dx = DIRECTIONS[k, 1]
        steps = int(distance[y, x])
        while steps <= REACH:
            v = y + steps * dy
            u = x + steps * dx
            if not (0 <= v < rows and 0 <= u < cols):
                break
            if scene.valid[v, u]:
                slope_x = _surface_slope(scene, v, u, 0, 1)
                slope_y = _surface_slope(scene, v, u, 1, 0)
                disparities[k] = scene.disparity[v, u] - F(steps) * (slope_x * F(dx) + slope_y * F(dy))
                slopes_x[k] = slope_x
                slopes_y[k] = slope_y
                break
            steps += int(distance[v, u])
    return Hypotheses(disparities, slopes_x, slopes_y)


@jit_rows_inline
def _surface_slope(scene: DisparityScene, y: int, x: int, dy: int, dx: int) -> np.float32:
    """Return the slope of a valid pixel's surface along an axis, from valid pixels of this surface on either side.

    The slopes in `surfaces` use all pixels, valid or not, and therefore include jumps.
    """
    rows, cols = scene.disparity.shape
    centre = scene.disparity[y, x]
    rise = F(0.0)
    run = F(0.0)
    for side in (-SLOPE_PX, SLOPE_PX):
        v = y + side * dy
        u = x + side * dx
        if 0 <= v < rows and 0 <= u < cols and scene.valid[v, u]:
            step = scene.disparity[v, u] - centre
            if abs(step) < SURFACE_JUMP_PX:
                rise += step if side > 0 else -step
                run += F(SLOPE_PX)
    slope: np.float32 = rise / max(run, F(1.0))
    return slope


@jit_rows_inline
def _best_hypothesis(
    scene: DisparityScene,
    hypotheses: Hypotheses,
    surfaces: RightSurfaces,
    cost_limit: np.float32,
    min_margin: np.float32,
    y: int,
    x: int,
) -> np.float32:
    """Return the disparity of the best hypothesis of a pixel, NaN if it does not meet the conditions 3 to 6.

    If the refined field agrees with the hypothesis, the disparity of the field is returned.
    """
    possible = np.zeros(DIRECTION_COUNT, np.bool_)
    count = 0
    for k in range(DIRECTION_COUNT):
        possible[k] = not _is_contradicted(hypotheses.disparity[k], surfaces, y, x)
        count += possible[k]
    if count == 0:  # condition 3
        return F(np.nan)
    cost, effective_pixels = _hypothesis_costs(scene, y, x, hypotheses)
    best = -1
    lowest = NO_COST
    for k in range(DIRECTION_COUNT):
        if possible[k] and cost[k] < lowest:
            best = k
            lowest = cost[k]
    if best < 0 or lowest > cost_limit:  # condition 4; without a cost, no hypothesis meets the condition
        return F(np.nan)
    disparity: np.float32 = hypotheses.disparity[best]
    lowest_other = NO_COST
    for k in range(DIRECTION_COUNT):
        if abs(hypotheses.disparity[k] - disparity) > SURFACE_JUMP_PX:
            lowest_other = min(lowest_other, cost[k])
    required = lowest + min_margin / np.sqrt(effective_pixels[best])
    if lowest_other < required:  # condition 5
        return F(np.nan)
    if not _is_confirmed(scene, hypotheses, best, required, y, x):  # condition 6
        return F(np.nan)
    own: np.float32 = scene.disparity[y, x]
    return own if abs(own - disparity) < SURFACE_JUMP_PX else disparity


@jit_rows_inline
def _is_confirmed(
    scene: DisparityScene, hypotheses: Hypotheses, best: int, required: np.float32, y: int, x: int
) -> bool:
    """Return whether a hypothesis is enclosed, agrees with the matcher, or matches better than its alternatives.

    `required` is the cost of the hypothesis plus the margin.
    """
    disparity = hypotheses.disparity[best]
    if _is_enclosed(hypotheses, disparity) or abs(scene.matched[y, x] - disparity) < SURFACE_JUMP_PX:
        return True
    for side in (-ALTERNATIVE_PX, ALTERNATIVE_PX):
        cost, _ = plane_cost(scene, y, x, disparity + side, hypotheses.slope_x[best], hypotheses.slope_y[best])
        if cost < required:
            return False
    return True


@jit_rows_inline
def _is_enclosed(hypotheses: Hypotheses, disparity: np.float32) -> bool:
    """Return whether the surface of a disparity is found in two opposite directions."""
    found = False
    for k in range(0, DIRECTION_COUNT, 2):
        one = abs(hypotheses.disparity[k] - disparity) < SURFACE_JUMP_PX
        opposite = abs(hypotheses.disparity[k + 1] - disparity) < SURFACE_JUMP_PX
        found |= one and opposite
    return found


@jit_rows_inline
def _hypothesis_costs(
    scene: DisparityScene, y: int, x: int, hypotheses: Hypotheses
) -> tuple[FloatArray32, FloatArray32]:
    """Return the matching cost of each hypothesis `(8,)`, `NO_COST` without a surface, and its effective pixels `(8,)`.

    Hypotheses of nearly the same disparity are evaluated once.
    """
    cost = np.full(DIRECTION_COUNT, NO_COST)
    effective_pixels = np.ones(DIRECTION_COUNT, F)
    for k in range(DIRECTION_COUNT):
        if np.isnan(hypotheses.disparity[k]):
            continue
        first = 0
        while first < k:
            is_same = abs(hypotheses.disparity[first] - hypotheses.disparity[k]) < SAME_HYPOTHESIS_PX
            if is_same:
                break
            first += 1
        if first < k:
            cost[k] = cost[first]
            effective_pixels[k] = effective_pixels[first]
        else:
            cost[k], effective_pixels[k] = plane_cost(
                scene, y, x, hypotheses.disparity[k], hypotheses.slope_x[k], hypotheses.slope_y[k]
            )
    return cost, effective_pixels


@jit_rows
def _own_costs(scene: DisparityScene, flat_indices: IntArray) -> FloatArray32:
    """Return the matching costs `(N,)` of valid pixels, given by flat indices, at their own disparity."""
    cols = scene.disparity.shape[1]
    out = np.empty(len(flat_indices), F)
    for n in prange(len(flat_indices)):
        y = flat_indices[n] // cols
        x = flat_indices[n] % cols
        slope_x = _surface_slope(scene, y, x, 0, 1)
        slope_y = _surface_slope(scene, y, x, 1, 0)
        out[n], _ = plane_cost(scene, y, x, scene.disparity[y, x], slope_x, slope_y)
    return out


@jit_rows_inline
def _is_contradicted(disparity: np.float32, surfaces: RightSurfaces, y: int, x: int) -> bool:
    """Return whether a hypothesis is contradicted by the right image.

    A hypothesis is contradicted if one of the following is true:

    - Its disparity is NaN: no surface exists in that direction.
    - The corresponding pixel is outside the right image, or in its last column, because the matching cost interpolates
      to the right of the corresponding point.
    - The corresponding pixel belongs to a nearer or a farther surface. A measured pixel may hide a farther surface
      (`surfaces.occlusion_mask`), but a hypothesis is not measured.
    """
    column = F(x) - disparity
    is_inside = column >= F(0.0) and column < F(surfaces.low.shape[1] - 1)
    if np.isnan(disparity) or not is_inside:
        return True
    u = int(np.rint(column))
    has_nearer: bool = surfaces.high[y, u] > disparity + SURFACE_JUMP_PX
    has_farther: bool = surfaces.low[y, u] < disparity - SURFACE_JUMP_PX
    return has_nearer or has_farther


@jit_rows
def _on_their_surface(disparity: FloatImage, valid: Mask, proposed: Mask, surfaces: RightSurfaces) -> Mask:
    """Return the mask of the proposed pixels `(H, W)` with neighbours on their surface and without a contradiction.

    `valid` includes the proposed pixels, and `surfaces` are the surfaces of all valid pixels.
    """
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        for x in range(cols):
            if not proposed[y, x] or _is_contradicted(disparity[y, x], surfaces, y, x):
                continue
            same_surface = -1  # does not count the pixel itself
            for v in range(max(0, y - 1), min(rows, y + 2)):
                for u in range(max(0, x - 1), min(cols, x + 2)):
                    if valid[v, u] and abs(disparity[v, u] - disparity[y, x]) < SURFACE_JUMP_PX:
                        same_surface += 1
            out[y, x] = same_surface >= MIN_SAME_SURFACE
    return out

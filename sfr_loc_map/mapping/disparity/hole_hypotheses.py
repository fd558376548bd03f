"""The hypotheses of a pixel in a hole: the surfaces beside it, extrapolated as planes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatArray32, FloatImage, Mask
from sfr_loc_map.jit import jit_rows_inline
from sfr_loc_map.mapping.disparity.surfaces import SURFACE_JUMP_PX

REACH = 12
"""Maximum distance over which a plane is extrapolated, rows or columns. With 6 or 24 the density of the five pairs
changes by 0.0015 or less (measurements/mapper_trials.md)."""
SLOPE_PX = 2  #: Distance over which the slope of a surface is measured, pixels: one cell of the refined field.
DIRECTIONS = np.array([[0, 1], [0, -1], [1, 0], [-1, 0], [1, 1], [-1, -1], [1, -1], [-1, 1]])
"""Row and column step of each direction; opposite directions follow each other."""
DIRECTION_COUNT = len(DIRECTIONS)
"""Number of hypotheses of a pixel."""


class HoleScene(NamedTuple):
    """Input of a pass, `(H, W)` each."""

    left: FloatImage  #: Grey levels, float32 with integer values.
    right: FloatImage  #: Corrected grey levels.
    disparity: FloatImage  #: Pixels.
    valid: Mask  #: Pixels with a valid disparity, measured or filled in an earlier pass.
    initial: FloatImage  #: Disparities of the semi-global matching, pixels; NaN at unmatched pixels.


class Hypotheses(NamedTuple):
    """The nearest surface along each direction as a plane at a pixel, `(8,)` each; NaN without a surface."""

    disparity: FloatArray32  #: Disparity of the plane at the pixel, pixels.
    slope_x: FloatArray32  #: Slope of the plane along rows, pixels per pixel.
    slope_y: FloatArray32  #: Slope of the plane along columns, pixels per pixel.


@jit_rows_inline
def find_hypotheses(scene: HoleScene, distance: FloatImage, y: int, x: int) -> Hypotheses:
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
                slope_x = surface_slope(scene, v, u, 0, 1)
                slope_y = surface_slope(scene, v, u, 1, 0)
                disparities[k] = scene.disparity[v, u] - F(steps) * (slope_x * F(dx) + slope_y * F(dy))
                slopes_x[k] = slope_x
                slopes_y[k] = slope_y
                break
            steps += int(distance[v, u])
    return Hypotheses(disparities, slopes_x, slopes_y)


@jit_rows_inline
def surface_slope(scene: HoleScene, y: int, x: int, dy: int, dx: int) -> np.float32:
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
def is_enclosed(hypotheses: Hypotheses, disparity: np.float32) -> bool:
    """Return whether the surface of a disparity is found in two opposite directions."""
    found = False
    for k in range(0, DIRECTION_COUNT, 2):
        one = abs(hypotheses.disparity[k] - disparity) < SURFACE_JUMP_PX
        opposite = abs(hypotheses.disparity[k + 1] - disparity) < SURFACE_JUMP_PX
        found |= one and opposite
    return found

"""A pair with its disparities, and the surfaces in it: jumps between them, their slopes, and their visibility.

Three functions compare a pixel with the surfaces at the corresponding pixel of the right image:

=============================  =========================================================================================
function                       result
=============================  =========================================================================================
surfaces.occlusion_mask        whether that pixel is outside the right image or belongs to a nearer surface
hole_filling._is_contradicted  the same for a hypothesis, which is also contradicted by a farther surface
jump_network._occluder         how much nearer the nearest surface at that column is, pixels: a feature of the network
=============================  =========================================================================================
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatImage, Mask
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.filters import square_element

SURFACE_JUMP_PX = F(1.0)
"""Neighbouring disparities that differ by more than this belong to two surfaces, pixels: the disparity of ground
changes by less from pixel to pixel, and a ramp of this slope is parallel to a ray of the right camera. A difference of
exactly this value counts as a jump in some functions and not in others."""
MIN_DIVISOR_DISPARITY_PX = F(0.3)  #: Lower bound of disparities for ratios of depths, pixels.
CENTRAL_DIFFERENCE = np.array([[-0.5, 0.0, 0.5]], F)
"""Taps of the slope of a disparity. At the border, which is repeated, the slope is half of the difference to the only
neighbour. Slopes of grey levels are also smoothed: along rows by a Gaussian (`data_term`), and along columns
by the Sobel operator (`vertical_disparity`)."""


class DisparityScene(NamedTuple):
    """The images of a pair with its disparities, `(H, W)` each."""

    left: FloatImage  #: Left image, grey levels, float32 with integer values.
    right: FloatImage  #: Right image after its correction, grey levels.
    matched: FloatImage  #: Disparities of the semi-global matching, pixels; NaN where unmatched.
    #: Disparities, pixels, defined everywhere. At invalid pixels they are only a smooth continuation.
    disparity: FloatImage
    sigma: FloatImage  #: Standard deviation of the disparity, pixels.
    valid: Mask  #: Valid pixels, for the stage that receives the scene; `estimate_disparity` keeps their status.


class RightSurfaces(NamedTuple):
    """Disparities `(H, W)` of the valid left pixels that correspond to each pixel of the right image, pixels."""

    low: FloatImage  #: Smallest disparity; infinite if no pixel corresponds.
    high: FloatImage  #: Largest disparity; minus infinity if no pixel corresponds.


def slope_along_rows(disparity: FloatImage) -> FloatImage:
    """Return the slope of a disparity along rows `(H, W)`, pixels per pixel."""
    return np.asarray(cv2.filter2D(disparity, -1, CENTRAL_DIFFERENCE, borderType=cv2.BORDER_REPLICATE), F)


def slope_along_columns(disparity: FloatImage) -> FloatImage:
    """Return the slope of a disparity along columns `(H, W)`, pixels per pixel."""
    return np.asarray(cv2.filter2D(disparity, -1, CENTRAL_DIFFERENCE.T, borderType=cv2.BORDER_REPLICATE), F)


def depth_ratio(disparity: FloatImage, reach: int) -> FloatImage:
    """Return the ratio `(H, W)` of each depth to the smallest depth within `reach` rows and columns."""
    clipped = np.maximum(disparity, MIN_DIVISOR_DISPARITY_PX)
    return np.asarray(cv2.dilate(clipped, square_element(2 * reach + 1)) / clipped, F)


@jit_rows
def right_surfaces(disparity: FloatImage, valid: Mask) -> RightSurfaces:
    """Return the disparities that correspond to each pixel of the right image."""
    rows, cols = disparity.shape
    low = np.full((rows, cols), F(np.inf))
    high = np.full((rows, cols), F(-np.inf))
    for y in prange(rows):
        for x in range(cols):
            if valid[y, x]:
                u = int(np.rint(F(x) - disparity[y, x]))
                if 0 <= u < cols:
                    low[y, u] = min(low[y, u], disparity[y, x])
                    high[y, u] = max(high[y, u], disparity[y, x])
    return RightSurfaces(low, high)


@jit_rows
def occlusion_mask(disparity: FloatImage, surfaces: RightSurfaces) -> Mask:
    """Return the mask of the pixels `(H, W)` that are occluded in the right image.

    The corresponding pixel of an occluded pixel is outside the right image or belongs to a nearer surface.
    """
    rows, cols = disparity.shape
    out = np.zeros((rows, cols), np.bool_)
    for y in prange(rows):
        for x in range(cols):
            u = int(np.rint(F(x) - disparity[y, x]))
            out[y, x] = not (0 <= u < cols) or surfaces.high[y, u] > disparity[y, x] + SURFACE_JUMP_PX
    return out

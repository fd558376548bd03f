"""Saturated pixels: they have no texture, and their residuals are small although the disparity may be wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.jit import jit_rows

F = np.float32

SATURATED_SQUARE_PX = 5
"""A pixel is invalid if the square of this side around it is completely saturated, pixels: its slope, of five columns
and three rows, is then 0."""
NEIGHBOURHOOD_PX = 11
"""Side of the square in which saturated pixels increase the uncertainty of a pixel, pixels: of the order of the radius
over which the refinement smooths."""
SIGMA_GROWTH = F(1.5)
"""Relative growth of sigma in a completely saturated neighbourhood. Chosen on rendered, half clipped ground."""

SATURATED_GREY_LEVELS = np.where(np.isin(np.arange(256), (0, 255)), 255, 0).astype(np.uint8)
"""By grey level: 255 if the level is saturated, otherwise 0."""
SIGMA_FACTORS = F(1.0) + SIGMA_GROWTH / F(255.0) * np.arange(256, dtype=F)
"""By the mean of a neighbourhood, 0 to 255: factor on sigma. The noise that is measured in the images is too small
there, because clipping removes it."""


@dataclass(frozen=True, slots=True, eq=False)
class Saturation:
    """Saturation of a pair around each pixel of the left image."""

    saturated: Mask  #: `(H, W)`, the square around the pixel is completely saturated in one of the images.
    neighbourhood: GreyImage  #: `(H, W)`, saturated fraction of the pixel's neighbourhood, 0 to 255.
    fraction: float  #: Fraction of the pixels that are saturated in either image.


def measure_saturation(left: GreyImage, right: GreyImage, disparity_px: FloatImage) -> Saturation:
    """Return the saturation around each pixel and its corresponding pixel; the disparities have no holes."""
    saturated_left = cv2.LUT(left, SATURATED_GREY_LEVELS)
    saturated_right = cv2.LUT(right, SATURATED_GREY_LEVELS)
    if saturated_right.any():
        saturated_right = _warped(saturated_right, disparity_px)
    square = np.ones((SATURATED_SQUARE_PX, SATURATED_SQUARE_PX), np.uint8)
    saturated = np.maximum(cv2.erode(saturated_left, square), cv2.erode(saturated_right, square)) > 0
    either = np.maximum(saturated_left, saturated_right)
    neighbourhood = np.asarray(cv2.blur(either, (NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX)), np.uint8)
    return Saturation(saturated, neighbourhood, float(np.count_nonzero(either) / either.size))


def _warped(right: cv2.typing.MatLike, disparity_px: FloatImage) -> cv2.typing.MatLike:
    """Return the right image at the pixels of the left one, 0 outside."""
    rows, cols = disparity_px.shape
    x = np.arange(cols, dtype=F) - disparity_px
    y = np.arange(rows, dtype=F)[:, None].repeat(cols, axis=1)
    return cv2.remap(right, x, y, cv2.INTER_NEAREST)


def widened_sigma(cloud: PointCloud, saturations: Mapping[int, Saturation]) -> NDArray[np.float32]:
    """Return the standard deviations `(N,)` of points, metres, increased beside saturated pixels.

    The saturations are given by the points' `pair`.
    """
    affected = {pair: item.neighbourhood for pair, item in saturations.items() if item.fraction > 0.0}
    if not affected:
        return cloud.sigma.copy()
    shape = next(iter(affected.values())).shape
    neighbourhoods = np.zeros((max(saturations) + 1, *shape), np.uint8)
    for pair, neighbourhood in affected.items():
        neighbourhoods[pair] = neighbourhood
    return _widened(cloud.sigma, cloud.pair, cloud.v, cloud.u, neighbourhoods)


@jit_rows
def _widened(
    sigma: NDArray[np.float32],
    pair: NDArray[np.uint8],
    v: NDArray[np.uint16],
    u: NDArray[np.uint16],
    neighbourhoods: NDArray[np.uint8],
) -> NDArray[np.float32]:
    """Return the standard deviations `(N,)` times the factors of the neighbourhoods `(pairs, H, W)`."""
    out = np.empty_like(sigma)
    for n in prange(len(sigma)):
        out[n] = sigma[n] * SIGMA_FACTORS[neighbourhoods[pair[n], v[n], u[n]]]
    return out

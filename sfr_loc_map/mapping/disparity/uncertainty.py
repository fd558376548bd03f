"""The standard deviation of each disparity: of noise and smoothing, wider beside saturated pixels.

What the calibration adds to the sigma of a point: `mapping/reprojection.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask, median
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.filters import box_mean, second_differences, upsample_bilinear
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity

F = np.float32

NOISE_INFORMATION = F(0.2026)
"""Information that noise alone simulates in one cell: four times the energy of the slope's taps over four, for the mean
of two images has a quarter of the residual's variance."""
MAX_SIGMA_PX = F(2.0)
WINDOW_CELLS = 9
SHAPE_SHARE = F(0.34)  #: Error for each pixel of second difference and square cell of smoothing radius.
CREASE_SHARE = F(1.2)
"""Error for each pixel by which the second difference within 3 x 3 cells exceeds its median: beside edges and creases
the field is off by as much as it bends. Both shares were found on several rendered grounds, lights and cameras at once.
"""
MAX_CREASE_PX = F(1.0)
"""Larger second differences are edges between surfaces; the error beside them does not grow with their height."""
EDGE_FACTOR = 10.0  #: Second differences beyond so many times the median are edges, no shape of the ground.

_CLIPPED = np.where(np.isin(np.arange(256), (0, 255)), 255, 0).astype(np.uint8)
"""By grey level: 255 for saturated ones, 0 for others."""
FLAT_PX = 5  #: A pixel whose square of this side is saturated throughout has nothing to match.
AROUND_PX = 11  #: Saturated pixels count for the uncertainty of those within a square of this side.
SIGMA_GROWTH = F(1.5)
"""How much sigma grows where all pixels around are saturated: their residuals are small without being right, so the
noise that is measured in the images is too small. Found on rendered ground of which half is clipped."""
SIGMA_FACTORS = F(1.0) + SIGMA_GROWTH / F(255.0) * np.arange(256, dtype=F)
"""Factor on sigma by the mean around a pixel."""


def disparity_sigma(refined: RefinedDisparity) -> FloatImage:
    """Return the standard deviation of each disparity `(H, W)` float32, pixels; pixels are judged and fused by it, too.

    A field with information h per cell and smoothness weight s has, under white noise, the variance
    `integral d2k / (2 pi)^2 1 / (h + s k^4) = 1 / (8 sqrt(h s))` at each point. To that come the bias of smoothing,
    which grows with the second differences that are left and with the square of the smoothing radius,
    `(s / h)^(1/4)` cells, and the error beside creases.
    """
    height, width = refined.disparity_px.shape
    information = np.maximum(box_mean(refined.information, WINDOW_CELLS) - NOISE_INFORMATION, F(1e-3))
    weight = np.sqrt(box_mean(refined.weights.along_x, WINDOW_CELLS) * box_mean(refined.weights.along_y, WINDOW_CELLS))
    along_x, along_y = second_differences(refined.cells_px)
    curvature = np.abs(along_x) + np.abs(along_y)
    typical = median(curvature)
    of_ground = box_mean(np.minimum(curvature, F(EDGE_FACTOR * typical)), WINDOW_CELLS)
    noise = F(0.125) / np.sqrt(information * weight)
    bias = np.square(SHAPE_SHARE * of_ground) * (weight / information)
    crease = np.square(CREASE_SHARE * np.clip(box_mean(curvature, 3) - F(typical), F(0.0), MAX_CREASE_PX))
    sigma = upsample_bilinear(np.sqrt(noise + bias + crease), (2 * noise.shape[0], 2 * noise.shape[1]))
    return np.asarray(np.minimum(sigma[:height, :width], MAX_SIGMA_PX), F)


@dataclass(frozen=True, slots=True, eq=False)
class Saturation:
    """How saturated the images are around each pixel of the left one: there is no texture, and highlights move."""

    flat: Mask  #: `(H, W)`, there is nothing but saturation in one of the images.
    #: `(H, W)` uint8, the mean around each pixel of 0 for pixels that are not saturated, 255 for others.
    around: GreyImage
    share: float  #: Share of the pixels of the left image that are saturated in either.

    def widen(self, sigma: NDArray[np.float32], cloud: PointCloud, number: int) -> None:
        """Multiply the standard deviations `(N,)` of the points of a cloud's pair by their factors, in place."""
        if self.share > 0.0:
            _widen(sigma, cloud.v, cloud.u, cloud.pair == number, self.around)


@jit_rows
def _widen(
    sigma: NDArray[np.float32], v: NDArray[np.uint16], u: NDArray[np.uint16], which: Mask, around: GreyImage
) -> None:
    for n in prange(len(sigma)):
        if which[n]:
            sigma[n] *= SIGMA_FACTORS[around[v[n], u[n]]]


def saturation(left: GreyImage, right: GreyImage, disparity_px: FloatImage) -> Saturation:
    """Return how saturated both images are around each pixel and its partner; the disparity `(H, W)` has no holes."""
    clipped_left, clipped_right = cv2.LUT(left, _CLIPPED), cv2.LUT(right, _CLIPPED)
    if clipped_right.any():
        rows, cols = left.shape
        x, y = np.arange(cols, dtype=F) - disparity_px, np.arange(rows, dtype=F)[:, None].repeat(cols, axis=1)
        clipped_right = cv2.remap(clipped_right, x, y, cv2.INTER_NEAREST)  # 0 outside
    square = np.ones((FLAT_PX, FLAT_PX), np.uint8)
    flat = np.maximum(cv2.erode(clipped_left, square), cv2.erode(clipped_right, square)) > 0
    either = np.maximum(clipped_left, clipped_right)
    around = np.asarray(cv2.blur(either, (AROUND_PX, AROUND_PX)), np.uint8)
    return Saturation(flat, around, float(np.count_nonzero(either) / either.size))

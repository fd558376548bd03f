"""Saturated pixels: where an image is clipped it has no texture of the ground, and highlights move with the camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.jit import jit_rows

F = np.float32

BLACK, WHITE = 0, 255
_CLIPPED = np.where(np.isin(np.arange(256), (BLACK, WHITE)), 255, 0).astype(np.uint8)
"""By grey level: 255 for saturated ones, 0 for others."""
FLAT_PX = 5
"""A pixel whose square of this side is saturated throughout has nothing to match."""
AROUND_PX = 11
"""Saturated pixels count for the uncertainty of those within a square of this side."""
SIGMA_GROWTH = F(1.5)
"""How much sigma grows where all pixels around are saturated: their residuals are small without being right, so the
noise that is measured in the images is too small. Found on rendered ground of which half is clipped."""
_FACTORS = F(1.0) + SIGMA_GROWTH / F(255.0) * np.arange(256, dtype=F)
"""Factor on sigma by the mean around a pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class Saturation:
    """How saturated the images are around each pixel of the left one.

    Attributes:
        flat: `(H, W)`, there is nothing but saturation in one of the images.
        around: `(H, W)` uint8, the mean around each pixel of 0 for pixels that are not saturated, 255 for others.
        share: Share of the pixels of the left image that are saturated in either.
    """

    flat: Mask
    around: GreyImage
    share: float

    @property
    def sigma_factor(self) -> FloatImage:
        """What the stated standard deviation of a disparity is to be multiplied by, `(H, W)` float32."""
        return _FACTORS[self.around]

    def widen(self, sigma: NDArray[np.float32], cloud: PointCloud, number: int) -> None:
        """Multiply the standard deviations `(N,)` of a pair's points by the factors of their pixels.

        Args:
            sigma: Changed in place.
            cloud: Points of one or several pairs.
            number: Of this pair in the cloud.
        """
        if self.share > 0.0:
            _widen(sigma, cloud.v, cloud.u, cloud.pair == number, self.around, _FACTORS)


@jit_rows
def _widen(
    sigma: NDArray[np.float32],
    v: NDArray[np.uint16],
    u: NDArray[np.uint16],
    which: Mask,
    around: GreyImage,
    factors: NDArray[np.float32],
) -> None:
    """Multiply some standard deviations `(N,)` by the factors `(256,)` of what is around their pixels."""
    for n in prange(len(sigma)):
        if which[n]:
            sigma[n] *= factors[around[v[n], u[n]]]


def saturation(left: GreyImage, right: GreyImage, disparity_px: FloatImage) -> Saturation:
    """Return how saturated both images are around each pixel and its partner.

    Args:
        left: `(H, W)` uint8.
        right: `(H, W)` uint8.
        disparity_px: `(H, W)` float32, pixels, without holes.
    """
    clipped_left, clipped_right = cv2.LUT(left, _CLIPPED), cv2.LUT(right, _CLIPPED)
    if clipped_right.any():
        clipped_right = _at_partner(np.asarray(clipped_right, np.uint8), disparity_px)
    square = np.ones((FLAT_PX, FLAT_PX), np.uint8)
    flat = np.maximum(cv2.erode(clipped_left, square), cv2.erode(clipped_right, square)) > 0
    either = np.maximum(clipped_left, clipped_right)
    around = np.asarray(cv2.blur(either, (AROUND_PX, AROUND_PX)), np.uint8)
    return Saturation(flat, around, float(np.count_nonzero(either) / either.size))


@jit_rows
def _at_partner(image: GreyImage, disparity_px: FloatImage) -> GreyImage:
    """Return the right image's value at the partner of each left pixel, 0 where that lies outside."""
    rows, cols = image.shape
    out = np.zeros((rows, cols), np.uint8)
    for y in prange(rows):
        for x in range(cols):
            column = F(x) - disparity_px[y, x]
            if -0.5 <= column <= cols - 0.5:  # half to even
                nearest = int(np.rint(column))
                out[y, x] = image[y, nearest] if nearest < cols else np.uint8(0)
    return out

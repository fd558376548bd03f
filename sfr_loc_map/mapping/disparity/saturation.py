"""Saturated pixels: where an image is clipped it has no texture of the ground, and highlights move with the camera."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.mapping.disparity.filters import box_mean

F = np.float32

BLACK, WHITE = 0, 255
FLAT_PX = 5
"""A pixel whose square of this side is saturated throughout has nothing to match."""
AROUND_PX = 11
"""Saturated pixels count for the uncertainty of those within a square of this side."""
SIGMA_GROWTH = F(1.5)
"""How much sigma grows where all pixels around are saturated: their residuals are small without being right, so the
noise that is measured in the images is too small. Found on rendered ground of which half is clipped."""


@dataclass(frozen=True, slots=True, eq=False)
class Saturation:
    """How saturated the images are around each pixel of the left one.

    Attributes:
        flat: `(H, W)`, there is nothing but saturation in one of the images.
        sigma_factor: `(H, W)` float32, what the stated standard deviation of a disparity is to be multiplied by.
        share: Share of the pixels of the left image that are saturated in either.
    """

    flat: Mask
    sigma_factor: FloatImage
    share: float

    def widened(self, cloud: PointCloud) -> NDArray[np.float32]:
        """Return the sigma of points of the left image `(N,)`, metres, multiplied by the factors of their pixels."""
        if self.share == 0.0:
            return cloud.sigma
        return np.asarray(cloud.sigma * self.sigma_factor[cloud.v, cloud.u], F)


def saturation(left: GreyImage, right: GreyImage, disparity_px: FloatImage) -> Saturation:
    """Return how saturated both images are around each pixel and its partner.

    Args:
        left: `(H, W)` uint8.
        right: `(H, W)` uint8.
        disparity_px: `(H, W)` float32, pixels, without holes.
    """
    clipped_left, clipped_right = (((image == BLACK) | (image == WHITE)).astype(F) for image in (left, right))
    if clipped_right.any():
        clipped_right = _at_partner(clipped_right, disparity_px)
    flat = (box_mean(clipped_left, FLAT_PX) > F(0.999)) | (box_mean(clipped_right, FLAT_PX) > F(0.999))
    either = np.maximum(clipped_left, clipped_right)
    around = np.maximum(box_mean(either, AROUND_PX), F(0.0))  # sums of floats may end below zero
    return Saturation(flat, F(1.0) + SIGMA_GROWTH * around, float(either.mean()))


def _at_partner(image: FloatImage, disparity_px: FloatImage) -> FloatImage:
    """Return the right image's value at the partner of each left pixel, 0 where that lies outside."""
    height, width = image.shape
    columns = np.arange(width, dtype=F)[None] - disparity_px
    rows = np.broadcast_to(np.arange(height, dtype=F)[:, None], (height, width))
    return np.asarray(cv2.remap(image, columns, np.ascontiguousarray(rows), cv2.INTER_NEAREST, borderValue=0.0), F)

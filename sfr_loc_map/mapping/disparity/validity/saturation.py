"""Saturated pixels, which have no texture. Their residuals are small although their disparity may be wrong."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, GreyImage, Mask
from sfr_loc_map.mapping.filters import square_element

SATURATED_SQUARE_PX = 5
"""Side of the square around a pixel, pixels. A pixel in a completely saturated square is invalid."""
NEARBY_SIDE_PX = 11
"""Side of the square in which saturated pixels increase the sigma of a pixel (`point_sigma`), pixels."""

SATURATED_GREY_LEVELS = np.where(np.isin(np.arange(256), (0, 255)), 255, 0).astype(np.uint8)
"""Lookup table by grey level: 255 if the level is saturated, otherwise 0."""


@dataclass(frozen=True, slots=True, eq=False)
class Saturation:
    """Saturation of a pair around each pixel of the left image."""

    #: `(H, W)`, whether the square of `SATURATED_SQUARE_PX` around the pixel is completely saturated in either image.
    square_saturated: Mask
    #: `(H, W)`, saturated fraction of the square of `NEARBY_SIDE_PX` around the pixel as an 8-bit number: 0 if
    #: no pixel is saturated, and 255 if the square is completely saturated.
    nearby_fraction_255: GreyImage
    fraction: float  #: Fraction of the pixels that are saturated in either image.


def measure_saturation(left: GreyImage, right: GreyImage, disparity_px: FloatImage) -> Saturation:
    """Return the saturation around each pixel and its corresponding pixel.

    The images are the uncorrected images of the cameras, and the disparities must be defined everywhere. The
    corresponding pixel is assumed to be in the same row. The saturation of the right image is therefore displaced by
    the vertical disparity of the pair, usually less than a pixel.
    """
    saturated_left = cv2.LUT(left, SATURATED_GREY_LEVELS)
    saturated_right = cv2.LUT(right, SATURATED_GREY_LEVELS)
    if saturated_right.any():
        saturated_right = _warped(saturated_right, disparity_px)
    around = square_element(SATURATED_SQUARE_PX)
    square_saturated = np.maximum(cv2.erode(saturated_left, around), cv2.erode(saturated_right, around)) > 0
    either = np.maximum(saturated_left, saturated_right)
    nearby_fraction_255 = np.asarray(cv2.blur(either, (NEARBY_SIDE_PX, NEARBY_SIDE_PX)), np.uint8)
    return Saturation(square_saturated, nearby_fraction_255, float(np.count_nonzero(either) / either.size))


def _warped(right: cv2.typing.MatLike, disparity_px: FloatImage) -> cv2.typing.MatLike:
    """Return the right image at the pixels of the left image, 0 outside; vertical disparity is ignored."""
    rows, cols = disparity_px.shape
    x = np.arange(cols, dtype=F) - disparity_px
    y = np.arange(rows, dtype=F)[:, None].repeat(cols, axis=1)
    return cv2.remap(right, x, y, cv2.INTER_NEAREST)

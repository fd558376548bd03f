"""The exposure of the right image relative to the left image, from quantiles of the grey levels.

Automatic exposure differs between cameras. `with_exposure_of_left` equalises the images before the semi-global
matching. `exposure_by_disparity` measures the exposure again when disparities are available.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual

EXPOSURE_STRIDE = 4  #: Exposures are compared on every fourth pixel of every fourth row.
MIN_GREY = 2.0  #: Pixels up to this grey level may be saturated and are excluded from the exposure.
MAX_GREY = 253.0  #: Pixels from this grey level on may be saturated and are also excluded.
EXPOSURE_QUANTILES = (0.1, 0.5, 0.9)  #: Quantiles of the grey levels that are compared.
MIN_GREY_RANGE = 8.0  #: Minimum range between the outer quantiles for a gain, grey levels.
GAIN_LIMITS = (0.25, 4.0)  #: Smallest and largest gain: two stops of exposure.
SAME_EXPOSURE_GREY = 8.0  #: Quantiles of equally exposed images differ by at most this, grey levels.
MIN_EXPOSURE_PIXELS = 100  #: Minimum number of pixels for an exposure.


class Exposure(NamedTuple):
    """Linear relation `right = gain left + offset` of the grey levels of two images."""

    gain: float  #: Ratio of the contrasts of the right and the left image.
    offset_grey: float  #: Grey level of the right image where the left image is 0.


def exposure_by_disparity(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> Exposure:
    """Return the exposure of the right image `(H, W)` relative to the left image, from corresponding grey levels.

    Pixels that may be saturated are excluded. If too few pixels are usable, the exposures count as equal.
    """
    left_rows, right_rows, disparity_rows = (
        np.ascontiguousarray(image[::EXPOSURE_STRIDE]) for image in (left, right, disparity_px)
    )
    residual = photometric_residual(left_rows, right_rows, disparity_rows)[:, ::EXPOSURE_STRIDE]
    left_grey = left_rows[:, ::EXPOSURE_STRIDE]
    right_grey = residual + left_grey
    usable = (left_grey > MIN_GREY) & (left_grey < MAX_GREY) & (right_grey > MIN_GREY) & (right_grey < MAX_GREY)
    if usable.sum() < MIN_EXPOSURE_PIXELS:
        return Exposure(1.0, 0.0)
    return _exposure_of(_grey_quantiles(left_grey[usable]), _grey_quantiles(right_grey[usable]))


def with_exposure_of_left(left: GreyImage, right: GreyImage) -> GreyImage:
    """Return the right image with the exposure of the left image; unchanged if the exposures are about equal.

    The grey levels of the whole images are compared, because disparities are not available yet.
    `correct_right_image` measures the exposure later from corresponding pixels.
    """
    sampled = np.s_[::EXPOSURE_STRIDE, ::EXPOSURE_STRIDE]
    left_quantiles = _grey_quantiles(left[sampled])
    right_quantiles = _grey_quantiles(right[sampled])
    if np.abs(left_quantiles - right_quantiles).max() <= SAME_EXPOSURE_GREY:
        return right
    exposure = _exposure_of(left_quantiles, right_quantiles)
    levels = np.rint((np.arange(256.0) - exposure.offset_grey) / exposure.gain)
    return np.asarray(cv2.LUT(right, np.clip(levels, 0, 255).astype(np.uint8)))


def _grey_quantiles(grey: NDArray[Any]) -> FloatArray:
    """Return the `EXPOSURE_QUANTILES` `(3,)` of a sample of grey levels."""
    return np.asarray(np.quantile(grey, EXPOSURE_QUANTILES))


def _exposure_of(left_quantiles: FloatArray, right_quantiles: FloatArray) -> Exposure:
    """Return the exposure of the right image relative to the left image, from the quantiles `(3,)` of both images.

    The gain is 1 if the left image has too little contrast.
    """
    left_low, left_median, left_high = left_quantiles.tolist()
    right_low, right_median, right_high = right_quantiles.tolist()
    gain = 1.0
    if left_high - left_low >= MIN_GREY_RANGE:
        gain = float(np.clip((right_high - right_low) / (left_high - left_low), *GAIN_LIMITS))
    return Exposure(gain, right_median - gain * left_median)

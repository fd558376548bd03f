"""The exposure of the right image relative to the left one, from quantiles of their grey levels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.mapping.disparity.photometric_residual import photometric_residual

EXPOSURE_STRIDE = 4  #: Every fourth pixel of every fourth row is compared in exposure: quantiles need fewer samples.
MIN_GREY = 2.0  #: Darker pixels may be saturated and are excluded from the exposure, grey levels.
MAX_GREY = 253.0  #: Brighter pixels may be saturated and are excluded from the exposure, grey levels.
EXPOSURE_QUANTILES = (0.1, 0.5, 0.9)  #: Quantiles of the grey levels that are compared; outliers are beyond them.
MIN_GREY_RANGE = 8.0
"""Range between the outer quantiles that a gain requires, grey levels: rounding changes the ratio of smaller ranges by
several percent."""
GAIN_LIMITS = (0.25, 4.0)  #: Smallest and largest gain: two stops of exposure.
MIN_EXPOSURE_PIXELS = 100  #: Pixels that a comparison of the exposures requires: ten beyond each outer quantile.


class Exposure(NamedTuple):
    """Linear relation `right = gain left + offset` of the grey levels of two images."""

    gain: float
    offset_grey: float


def measure_exposure(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> Exposure:
    """Return the exposure of the right image relative to the left one, from quantiles of corresponding grey levels.

    The gain is 1 where the left image has too little contrast, and the offset 0 where too few pixels are usable.
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
    left_low, left_median, left_high = np.quantile(left_grey[usable], EXPOSURE_QUANTILES)
    right_low, right_median, right_high = np.quantile(right_grey[usable], EXPOSURE_QUANTILES)
    if left_high - left_low < MIN_GREY_RANGE:
        return Exposure(1.0, float(right_median - left_median))
    gain = float(np.clip((right_high - right_low) / (left_high - left_low), *GAIN_LIMITS))
    return Exposure(gain, float(right_median - gain * left_median))

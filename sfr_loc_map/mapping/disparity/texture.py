"""Texture above the noise, and the fraction of the textured pixels that are measured."""

from __future__ import annotations

import math

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.mapping.disparity.image_noise import noise_of_image

MIN_TEXTURED_FRACTION = 0.02
"""Minimum textured fraction of an image for judging its matches. Chosen by hand: two percent of a megapixel are 20 000
pixels. Fewer may all be on one object, which does not show how the images match."""
TEXTURE_SIGMAS = 2.0
"""A neighbourhood is textured if its standard deviation exceeds this many standard deviations of the noise. The
standard deviation of 49 pixels of pure noise is accurate to 10 %."""
MIN_TEXTURE_GREY = 1.0
"""Minimum standard deviation of a textured neighbourhood, grey levels; rounding alone causes 0.3."""


def measured_textured_fraction(left: FloatImage, left_variance: FloatImage, measured: Mask) -> float:
    """Return the fraction of the left image's textured pixels that are measured; NaN if too few pixels are textured.

    `left_variance` is the `filters.local_variance` of the left image.
    """
    threshold = max(TEXTURE_SIGMAS * noise_of_image(left), MIN_TEXTURE_GREY)
    textured = left_variance > threshold**2
    count = np.count_nonzero(textured)
    if count < MIN_TEXTURED_FRACTION * textured.size:
        return math.nan
    return float(np.count_nonzero(measured & textured) / count)

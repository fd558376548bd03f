"""Texture above the noise: which fraction of the pixels that can be matched is valid."""

from __future__ import annotations

import math

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.mapping.disparity.filters import local_variance
from sfr_loc_map.mapping.robust_statistics import mad_sigma

MIN_TEXTURED_FRACTION = 0.02  #: Fraction of the image that must be textured, so that its matches can be judged.
TEXTURE_SIGMAS = 2.0
"""A neighbourhood is textured if its standard deviation exceeds this many standard deviations of the noise: that of
49 pixels of noise alone deviates from the noise by 10 %."""
MIN_TEXTURE_GREY = 1.0
"""Smallest standard deviation of a textured neighbourhood, grey levels; rounding alone causes 0.3."""
NOISE_MASK = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], np.float32)
"""Difference of two Laplacians, which cancels smooth structure (Immerkaer 1996)."""
NOISE_GAIN = 6.0  #: Factor by which the mask amplifies white noise: the root of its sum of squares.


def valid_textured_fraction(left: FloatImage, valid: Mask) -> float:
    """Return the fraction of the left image's textured pixels that are valid; NaN if too few pixels are textured."""
    threshold = max(TEXTURE_SIGMAS * image_noise(left), MIN_TEXTURE_GREY)
    textured = local_variance(left) > threshold**2
    count = np.count_nonzero(textured)
    if count < MIN_TEXTURED_FRACTION * textured.size:
        return math.nan
    return float(np.count_nonzero(valid & textured) / count)


def image_noise(image: FloatImage) -> float:
    """Return the standard deviation of the noise of an image `(H, W)`, grey levels (Immerkaer 1996)."""
    response = np.asarray(cv2.filter2D(image, -1, NOISE_MASK), np.float32)
    return mad_sigma(response[::2, ::2]) / NOISE_GAIN

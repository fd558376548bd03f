"""Whether the images of a pair match: the fraction of the textured pixels that are measured.

A pair whose images do not match is refused. The message names the likely cause, from matching downsampled images as
given, exchanged, and with nine vertical offsets. This takes less time than a pair that matches, because the images are
downsampled by 2 and by 4. The data sets of the thresholds are rendered ground, KITTI, Middlebury and Mars.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import F, FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.robust_statistics import mad_sigma
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching

MIN_TEXTURED_FRACTION = 0.02  #: Minimum textured fraction of an image for judging its matches.
TEXTURE_SIGMAS = 2.0
"""A neighbourhood is textured if its standard deviation exceeds this many standard deviations of the noise. This module
uses the noise of the image. `multiview` uses the noise of a photometric residual, which is larger."""
MIN_TEXTURE_GREY = 1.0  #: Minimum standard deviation of a textured neighbourhood, grey levels.
MIN_MEASURED_FRACTION = 0.3
"""Minimum fraction of the textured pixels that must be measured. Swapped images reach 0.07, and correct images have
0.64 or more (measurements/mapper_trials.md)."""
NOISE_MASK = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]], F)
"""Difference of two Laplacians, which cancels smooth structure (Immerkaer 1996)."""
NOISE_GAIN = 6.0  #: Factor by which the mask amplifies white noise: the root of the sum of its squared taps.
COARSE_FACTOR = 2  #: Images are downsampled by this factor to find the cause of a mismatch.
SWAPPED_FACTOR = 1.5
"""Images are probably swapped if exchanging them multiplies the matched fraction by more than this factor."""
VERTICAL_FACTOR = 4  #: Images are downsampled by this factor to find a vertical offset.
MAX_VERTICAL_ROWS = 4  #: Largest vertical offset that is tried, rows of the downsampled images: 16 pixels.
MIN_OFFSET_FRACTION = 0.75
"""Images probably have a vertical offset if more than this fraction of the pixels matches with the offset."""
CHANCE_FRACTION = 0.6  #: Matched fraction above which an offset contributes to the estimated offset.
MIN_OFFSET_PX = 2  #: Smallest vertical offset that is reported, pixels: the error of the estimate.
MIN_SWAPPED_FRACTION = 0.5
"""Images are probably swapped only if more than this fraction of the pixels matches after the exchange."""


def measured_textured_fraction(left: FloatImage, left_variance: FloatImage, measured: Mask) -> float:
    """Return the fraction of the left image's textured pixels that are measured; NaN if too few pixels are textured.

    `left_variance` is the `filters.local_variance` of the left image.
    """
    threshold = max(TEXTURE_SIGMAS * _noise_of_image(left), MIN_TEXTURE_GREY)
    textured = left_variance > threshold**2
    count = np.count_nonzero(textured)
    if count < MIN_TEXTURED_FRACTION * textured.size:
        return math.nan
    return float(np.count_nonzero(measured & textured) / count)


def _noise_of_image(image: FloatImage) -> float:
    """Return the standard deviation of the noise of an image `(H, W)`, grey levels (Immerkaer 1996)."""
    response = np.asarray(cv2.filter2D(image, -1, NOISE_MASK), F)
    return mad_sigma(response[::2, ::2]) / NOISE_GAIN


def check_matches(pair: StereoPair, fraction: float, disparity_count: int) -> None:
    """Raise MappingError if so few textured pixels are measured that their matches are due to chance.

    If too few pixels are textured, the fraction is NaN and the pair passes; `findings_of_pair` then adds a warning.
    """
    if math.isnan(fraction):
        return
    if fraction < MIN_MEASURED_FRACTION:
        raise MappingError(
            f"images of stamp {pair.stamp_ns} do not match: only {100 * fraction:.0f} % of the textured pixels "
            f"could be matched, {100 * MIN_MEASURED_FRACTION:.0f} % are required; "
            f"{_likely_cause(pair, disparity_count)}"
        )


def _likely_cause(pair: StereoPair, disparity_count: int) -> str:
    """Return the likely cause of a mismatch as a clause of the message, with what to do."""
    left = _downsampled(pair.left, COARSE_FACTOR)
    right = _downsampled(pair.right, COARSE_FACTOR)
    coarse_count = math.ceil(disparity_count / COARSE_FACTOR)
    matched_as_given = _matched_fraction(left, right, coarse_count)
    matched_swapped = _matched_fraction(right, left, coarse_count)
    if matched_swapped > max(SWAPPED_FACTOR * matched_as_given, MIN_SWAPPED_FRACTION):
        return "left and right are probably swapped: exchange them"
    offset_px = _vertical_offset_px(pair, disparity_count)
    if abs(offset_px) >= MIN_OFFSET_PX:
        direction = "lower" if offset_px > 0 else "higher"
        return f"the right image is probably about {abs(offset_px)} rows {direction}: rectify the images"
    return (
        "check that they are rectified, taken at the same time and by this rig, and that no surface is nearer than "
        "min_range_m"
    )


def _vertical_offset_px(pair: StereoPair, disparity_count: int) -> int:
    """Return the vertical offset at which the downsampled images match, pixels; 0 if they do not match.

    The offset is positive if content of the right image is lower.

    The offset is the mean of the best of the tried offsets and its neighbours, weighted by the matched fraction above
    `CHANCE_FRACTION`.
    """
    left = _downsampled(pair.left, VERTICAL_FACTOR)
    right = _downsampled(pair.right, VERTICAL_FACTOR)
    count = math.ceil(disparity_count / VERTICAL_FACTOR)
    offsets = np.arange(-MAX_VERTICAL_ROWS, MAX_VERTICAL_ROWS + 1)
    matched = np.array([_matched_fraction(left, np.roll(right, -rows, axis=0), count) for rows in offsets])
    if matched.max() <= MIN_OFFSET_FRACTION:
        return 0
    best = offsets[np.argmax(matched)]
    weights = np.maximum(matched - CHANCE_FRACTION, 0.0) * (np.abs(offsets - best) <= 1)
    return round(VERTICAL_FACTOR * float(np.average(offsets, weights=weights)))


def _downsampled(image: GreyImage, factor: int) -> GreyImage:
    """Return an image downsampled by an integer factor."""
    height, width = image.shape
    return np.asarray(cv2.resize(image, (width // factor, height // factor), interpolation=cv2.INTER_AREA), np.uint8)


def _matched_fraction(left: GreyImage, right: GreyImage, count: int) -> float:
    """Return the fraction of the pixels that are matched with `count` searched disparities."""
    return float(np.isfinite(semi_global_matching(left, right, count)).mean())

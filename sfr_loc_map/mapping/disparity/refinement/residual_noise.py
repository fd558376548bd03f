"""The noise of photometric residuals, measured in each pair.

A photometric residual is the warped right image minus the left image at a pixel, in grey levels. Its noise is the sum
of the noise of both images and of the rounding of their grey levels. The functions and their uses:

========================  ============================================  ===============================================
function                  what                                          used for
========================  ============================================  ===============================================
`rounding_noise`          standard deviation of a residual that         the lower bound of `overall_noise` and
                          rounding alone causes                         `noise_variance`
`overall_noise`           standard deviation of all residuals,          clipping residuals for the brightness offset
                          including their brightness offset             and the template (`linearise`)
`noise_variance`          variance of a residual without its            the data term and its information, and thereby
                          brightness offset, in each cell               sigma and the mismatch test (`linearise`)
`block_variance_ratio`    increase of the variance of averages, if      inflating `noise_variance` where it divides the
                          the noise is correlated between pixels        information (`linearise`)
========================  ============================================  ===============================================

`variational_refinement.linearise` calls `overall_noise`, `noise_variance` and `block_variance_ratio` in each iteration.
The noise of a pair, `noise_grey` (`RefinedDisparity`), is the median standard deviation by `noise_variance` of the last
iteration. Thresholds of `validity`, `hole_filling` and `multiview` are multiples of `noise_grey`.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage, median
from sfr_loc_map.geometry.robust_statistics import mad_sigma, spread
from sfr_loc_map.mapping.filters import downsample_mean

ROUNDING_NOISE = 0.3  #: Minimum standard deviation of a residual due to rounding, in steps of the grey levels.
GREY_STRIDE = 4  #: The steps between grey levels are measured on every fourth pixel of every fourth row.
DEFAULT_VARIANCE = F(25.0)  #: Variance of a residual if too few residuals are available, grey levels squared.
NOISE_BINS = 8  #: Ranges of the grey level in which the noise is measured, with equal numbers of residuals.
MIN_PER_BIN = 50  #: Minimum number of residuals in each range.
SAMPLED_PIXELS = np.s_[::8, ::4]  #: Pixels whose residuals are used to measure the noise.
SAMPLED_CELLS = np.s_[::4, ::2]  #: The cells of these pixels.
MIN_LEVEL_VARIANCE = 1.0  #: Lower bound of the variance of the grey levels, grey levels squared, which is a divisor.
BLOCK_PIXELS = 16.0  #: Number of pixels of a block of 4 x 4.


def rounding_noise(image: FloatImage) -> float:
    """Return the standard deviation of a residual due to the steps between an image's grey levels, grey levels."""
    steps = np.diff(np.unique(image[::GREY_STRIDE, ::GREY_STRIDE]))
    return ROUNDING_NOISE * median(steps) if len(steps) else ROUNDING_NOISE


def overall_noise(residual: FloatImage, min_noise: float) -> float:
    """Return the robust standard deviation of a residual `(H, W)` about its median, at least `min_noise`."""
    sample = residual[SAMPLED_PIXELS]
    sample = sample[np.isfinite(sample)]
    if not len(sample):
        return min_noise
    return max(spread(sample), min_noise)


def noise_variance(grey: FloatImage, residual: FloatImage, offset: FloatImage, min_noise: float) -> FloatImage:
    """Return the variance of a residual in each cell `(H/2, W/2)`, a linear function of the grey level.

    The noise of a camera has a constant part and a part that grows with the light (photon noise). The line is fitted by
    weighted least squares to robust variances in ranges of the grey level, and clipped to the smallest and the largest
    of these variances. Variances are at least the square of `min_noise` (`rounding_noise`). The variance is
    `DEFAULT_VARIANCE` if too few residuals are available.

    The weights are inverse squared variances, because the standard deviation of a variance is proportional to the
    variance.

    `grey` is the mean of the left image in each cell. The residual `(H, W)` is NaN where unknown and includes the
    brightness offset `(H/2, W/2)`.
    """
    deviation = np.abs(residual[SAMPLED_PIXELS] - offset[SAMPLED_CELLS])
    is_known = np.isfinite(deviation)
    level = grey[SAMPLED_CELLS][is_known]
    quarters = (F(4.0) * level).astype(np.uint16)  # exact for means of four integers, and sorted in linear time
    order = np.argsort(quarters, kind="stable")
    level = level[order]
    deviation = deviation[is_known][order]
    if len(level) < NOISE_BINS * MIN_PER_BIN:
        return np.full(offset.shape, DEFAULT_VARIANCE, F)
    levels = np.array([part.mean() for part in np.array_split(level, NOISE_BINS)], np.float64)
    variances = np.array([mad_sigma(part) ** 2 for part in np.array_split(deviation, NOISE_BINS)])
    variances = np.maximum(variances, min_noise**2)
    weights = 1.0 / np.square(variances)
    mean_level = np.average(levels, weights=weights)
    mean_variance = float(np.average(variances, weights=weights))
    level_variance = float(np.average(np.square(levels - mean_level), weights=weights))
    covariance = float(np.average((levels - mean_level) * (variances - mean_variance), weights=weights))
    slope = covariance / max(level_variance, MIN_LEVEL_VARIANCE)
    line = F(mean_variance) + F(slope) * (grey - F(mean_level))
    return np.asarray(np.clip(line, F(variances.min()), F(variances.max())), F)


def block_variance_ratio(means: FloatImage, offset: FloatImage, variance: FloatImage) -> np.float32:
    """Return the variance of means of 4 x 4 residuals relative to the same variance for white noise, at least 1.

    The ratio exceeds 1 if the noise is correlated between pixels, for example after filtering or compression.

    `means`, `offset` and `variance` `(H/2, W/2)` are the mean residual, the brightness offset and the variance of a
    residual in each cell. A block without residuals is excluded if its brightness offset is 0. If residuals are within
    the window of the offset, the offset is not 0, and the block is included.
    """
    blocks = downsample_mean(np.asarray((means - offset) / np.sqrt(variance), F), 2)
    known = blocks[blocks != 0]  # exactly 0: beyond the window of the offset
    if not len(known):
        return F(1.0)
    return F(max(BLOCK_PIXELS * mad_sigma(known) ** 2, 1.0))

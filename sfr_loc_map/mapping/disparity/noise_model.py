"""Noise of a photometric residual, measured in the images themselves."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.median import median
from sfr_loc_map.mapping.disparity.filters import downsample_mean
from sfr_loc_map.mapping.robust import MAD_TO_SIGMA, mad_sigma

F = np.float32

MIN_NOISE = 0.3
"""Standard deviation that the rounding to whole grey levels alone gives a residual, about."""
DEFAULT_VARIANCE = F(25.0)
"""Grey levels squared, where too few residuals are known to measure it."""
BINS, MIN_PER_BIN = 8, 50


def overall_noise(residual: FloatImage) -> float:
    """Return the robust standard deviation of a residual `(H, W)`, grey levels, at least `MIN_NOISE`."""
    sample = residual[::8, ::4]
    sample = sample[np.isfinite(sample)]
    return max(mad_sigma(sample - median(sample)), MIN_NOISE) if len(sample) else MIN_NOISE


def noise_variance(left: FloatImage, residual: FloatImage, offset: FloatImage) -> FloatImage:
    """Return the variance of a residual in each cell `(H/2, W/2)`: the best straight line over the grey level.

    A camera's noise has a constant part and one that grows with the light (photon noise).

    Args:
        left: `(H, W)`, grey levels.
        residual: `(H, W)`, grey levels, NaN where unknown.
        offset: `(H/2, W/2)`, brightness offset of the residual.
    """
    grey = downsample_mean(left, 2)
    deviation = np.abs(residual[::8, ::4] - offset[::4, ::2]).ravel()
    level = grey[::4, ::2].ravel()
    known = np.isfinite(deviation)
    order = np.argsort(level[known], kind="stable")
    level, deviation = level[known][order], deviation[known][order]
    if len(level) < BINS * MIN_PER_BIN:
        return np.full(offset.shape, DEFAULT_VARIANCE, F)
    centre = np.array([part.mean() for part in np.array_split(level, BINS)], np.float64)
    variance = np.array([(MAD_TO_SIGMA * median(part)) ** 2 for part in np.array_split(deviation, BINS)])
    variance = np.maximum(variance, MIN_NOISE**2)
    weight = 1.0 / np.square(variance)
    middle = np.average(centre, weights=weight)
    spread = float(np.average(np.square(centre - middle), weights=weight))
    mean = float(np.average(variance, weights=weight))
    slope = float(np.average((centre - middle) * (variance - mean), weights=weight)) / max(spread, 1.0)
    model = F(mean) + F(slope) * (grey - F(middle))
    return np.asarray(np.clip(model, F(variance.min()), F(variance.max())), F)

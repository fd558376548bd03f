"""Noise of a photometric residual, measured in the images themselves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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


class GreyLevels(NamedTuple):
    """Grey levels of the left image, which all residuals of a pair share.

    Attributes:
        cells: `(H/2, W/2)` float32, mean of each cell.
        sampled: `(N,)` float32, those of every fourth row and second column.
        order: `(N,)`, that sorts the sampled ones.
    """

    cells: FloatImage
    sampled: FloatImage
    order: NDArray[np.int64]


def grey_levels(left: FloatImage) -> GreyLevels:
    """Return the grey levels of an image `(H, W)`."""
    cells = downsample_mean(left, 2)
    sampled = cells[::4, ::2].ravel()
    return GreyLevels(cells, sampled, np.argsort(sampled, kind="stable"))


def noise_variance(grey: GreyLevels, residual: FloatImage, offset: FloatImage) -> FloatImage:
    """Return the variance of a residual in each cell `(H/2, W/2)`: the best straight line over the grey level.

    A camera's noise has a constant part and one that grows with the light (photon noise).

    Args:
        grey: Of the left image.
        residual: `(H, W)`, grey levels, NaN where unknown.
        offset: `(H/2, W/2)`, brightness offset of the residual.
    """
    deviation = np.abs(residual[::8, ::4] - offset[::4, ::2]).ravel()
    order = grey.order[np.isfinite(deviation)[grey.order]]
    level, deviation = grey.sampled[order], deviation[order]
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
    model = grey.cells - F(middle)
    model *= F(slope)
    model += F(mean)
    return np.clip(model, F(variance.min()), F(variance.max()), out=model)

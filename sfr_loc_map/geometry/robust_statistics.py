"""Robust statistics of residuals: scale and weight that are insensitive to outliers (Huber 1981)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, median

MAD_TO_SIGMA = 1.4826  #: Ratio of the standard deviation to the median absolute deviation of a normal distribution.


def mad_sigma(deviations: NDArray[np.floating[Any]]) -> float:
    """Return the robust standard deviation of deviations from the centre, `1.4826 median |e|`."""
    return MAD_TO_SIGMA * median(np.abs(deviations))


def spread(values: NDArray[np.floating[Any]]) -> float:
    """Return the robust standard deviation of values about their median; NaN if there are no values."""
    return mad_sigma(values - values.dtype.type(median(values)))


def cauchy_weight(residuals: FloatArray, scale: float) -> FloatArray:
    """Return the weights `1 / (1 + (r / scale)^2)` of residuals: a residual of size `scale` has half the weight.

    Under normal noise a scale of 2.385 standard deviations has an efficiency of 95 % (Holland and Welsch 1977). A
    smaller scale gives less weight to outliers.
    """
    return np.asarray(1.0 / (1.0 + np.square(residuals / scale)))

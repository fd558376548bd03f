"""Confidence intervals by resampling whole drives, because errors within a drive are not independent."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.statistics.intervals import student_quantile

MIN_DRIVES = 5  #: Minimum number of drives for an interval.
RESAMPLES = 2000
"""Number of resamplings. The relative standard error of a standard deviation is 1 / sqrt(2 RESAMPLES), here 1.6 %."""
SEED = 20260101  #: Seed of the resamplings, an arbitrary number, so that equal results have equal intervals.


@lru_cache(maxsize=8)
def drawn_weights(drives: int) -> FloatArray:
    """Return how often each drive is drawn `(RESAMPLES, D)`; equal numbers of drives give equal weights."""
    rng = np.random.default_rng([SEED, drives])
    return rng.multinomial(drives, np.full(drives, 1.0 / drives), RESAMPLES).astype(np.float64)


def half_width(drawn: FloatArray, drives: int) -> float:
    """Return half of the width of the 95 % interval from the values of the resamplings `(RESAMPLES,)`.

    Student's t and the divisor `drives - 1` widen the interval for small numbers of drives.
    """
    spread = float(np.std(drawn)) * float(np.sqrt(drives / (drives - 1.0)))
    return float(student_quantile(0.975, drives - 1.0)) * spread

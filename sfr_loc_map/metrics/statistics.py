"""Figures of series of values, and quantiles as scipy.stats computes them, without its slow import.

SciPy's special functions are imported when the first figure needs them: nodes must start quickly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.score import Column, SampleStatistic, Statistic


@jit
def moments(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means and sums of squared differences from them, of each column of `(N, K)`.

    Welford's recurrence (1962), in the order of the values: exact to rounding however large the mean is.
    """
    mean, squares = np.zeros(values.shape[1]), np.zeros(values.shape[1])
    for i in range(len(values)):
        for k in range(len(mean)):
            before = values[i, k] - mean[k]
            mean[k] += before / (i + 1)
            squares[k] += before * (values[i, k] - mean[k])
    return mean, squares


def statistic(count: int, mean: FloatArray, squares: FloatArray) -> Statistic:
    """Return the statistic of the columns of a vector from their `moments` [4.2.3]; None where undefined.

    Of several columns the norm of the mean vector and the norm of the sigmas [4.1.3]; of one the mean with its sign,
    which is left out in mean + 3 sigma.
    """
    if not count:
        return Statistic(mean=None, sigma=None, mean_plus_3sigma=None)
    middle = float(mean[0]) if len(mean) == 1 else norm(mean)
    if count < 2:
        return Statistic(mean=middle, sigma=None, mean_plus_3sigma=None)
    sigmas = np.sqrt(squares / (count - 1))
    sigma = float(sigmas[0]) if len(sigmas) == 1 else norm(sigmas)
    return Statistic(mean=middle, sigma=sigma, mean_plus_3sigma=abs(middle) + 3.0 * sigma)


def norm(values: FloatArray) -> float:
    """Return the Cartesian norm of a short vector, always summed in the same order."""
    total = 0.0
    for value in values.tolist():
        total += value * value
    return float(np.sqrt(total))


def sample_statistic(values: NDArray[np.floating]) -> SampleStatistic:
    """Return the statistic of all values; None where undefined."""
    data = np.asarray(values, dtype=np.float64)
    count = len(data)
    mean = float(np.mean(data)) if count else None
    sigma = float(np.std(data, ddof=1)) if count > 1 else None
    p50, p95 = (float(p) for p in np.percentile(data, (50.0, 95.0))) if count else (None, None)
    total = mean + 3.0 * sigma if mean is not None and sigma is not None else None
    return SampleStatistic(count=count, mean=mean, sigma=sigma, mean_plus_3sigma=total, p50=p50, p95=p95)


def column(values: FloatArray, digits: int | None = 9) -> Column:
    """Return numbers for figures, rounded (the score itself is not) unless digits is None; None where not finite."""
    exact = values.tolist()
    rounded = exact if digits is None else [round(value, digits) for value in exact]
    return tuple(value if math.isfinite(value) else None for value in rounded)


def chi2_quantile(share: float, freedom: float) -> float:
    """Return the value that a chi-squared variable stays below with this probability.

    Its distribution function is the regularised lower incomplete gamma function P(freedom / 2, x / 2)
    (Abramowitz and Stegun 26.4.19).
    """
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(freedom / 2.0, share))


def student_quantile(share: float, freedom: float) -> float:
    """Return the value that a Student t variable stays below with this probability."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, share))


def student_share(value: float, freedom: float) -> float:
    """Return the probability with which a Student t variable stays below a value."""
    from scipy.special import stdtr

    return float(stdtr(freedom, value))


def holm(probabilities: Sequence[float | None]) -> list[float | None]:
    """Return probabilities corrected for their number (Holm 1979); None stays and does not count."""
    known = sorted((value, index) for index, value in enumerate(probabilities) if value is not None)
    corrected: list[float | None] = [None] * len(probabilities)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, value * (len(known) - rank)))
        corrected[index] = largest
    return corrected

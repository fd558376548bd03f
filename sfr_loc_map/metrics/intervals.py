"""The 95 % interval of mean + 3 sigma from sub-trajectories that overlap, and the distributions that tests need.

Sub-trajectories that share frames share errors: n of them, each overlapping L starts, are worth about m = n / L. So
blocks of at least L consecutive ones are drawn (circular block bootstrap, Politis and Romano 1992). The
shortfall of blocks is corrected for overlapping sums, whose correlation falls linearly to 0 over L starts:

- A block of length l shows a variance that is too small by the factor r = sum (1 - |h|/l)(1 - |h|/L) / sum (1 - |h|/L)
  over |h| < L; m blocks, by (m - 1) / m.
- The sample variance is itself too small, by (1 - 1/m) / (1 - 1/n), and the norm of a mean vector too large, by the
  scatter of the mean. The interval is centred on the figure corrected for both.
- The scatter of the resampled figures is scaled by Student's t on a logarithmic scale, since the figure is positive.
  Its degrees of freedom, (m - 1) times the root of the number of directions that the errors have, at least 1.5, and a
  widening by a tenth (unsigned errors: a quarter, for they are skewed) are set by experiment.

test/campaigns/interval_coverage.py measures how often the interval holds the true value. SciPy's special functions are
imported when the first figure needs them, because nodes must start quickly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray

Interval = tuple[float, float]  #: Lower and upper bound of a 95 % interval.
MAX_BLOCKS = 512  #: Largest number of groups of consecutive errors; the size of a group is a power of two.
RESAMPLES = 1000
SEED = 20240229
WIDENING, WIDENING_UNSIGNED = 1.1, 1.25
"""Factors by which resampled figures scatter less than the true ones; the second is for unsigned errors."""
MIN_FREEDOM = 1.5
MIN_INDEPENDENT = 2.0  #: With fewer independent sub-trajectories there is no interval.


class Scatter(NamedTuple):
    """How a figure scatters: standard deviation, and the degrees of freedom that it is known with."""

    sigma: float
    freedom: float

    @property
    def half_width(self) -> float:
        """Half the width of the 95 % interval, by Student's t."""
        return student_quantile(0.975, self.freedom) * self.sigma


def interval95(errors: FloatArray, overlap: float, *, unsigned: bool) -> Interval | None:
    """Return the 95 % interval of mean + 3 sigma of errors `(n,)` or `(n, d)`; None if too few are independent.

    `overlap` starts lie within one sub-trajectory on average; unsigned errors are never negative.
    """
    vectors = errors.reshape(len(errors), -1)
    count = len(vectors)
    independent = count / max(overlap, 1.0)
    if count < 2 or independent < MIN_INDEPENDENT or not np.isfinite(np.sum(vectors)):
        return None
    mean = np.mean(vectors, axis=0)
    offsets = vectors - mean
    variances = np.sum(np.square(offsets), axis=0) / (count - 1.0)
    size = float(np.linalg.norm(mean))
    if not variances.any():
        return size, size
    group = 1
    while group * MAX_BLOCKS < count:
        group *= 2
    means, figures, share = resampled(group_moments(offsets, group), mean, overlap, group)
    share *= 1.0 - 1.0 / independent
    variance_of_mean = float(np.mean(np.sum(np.square(means - mean), axis=1))) / share
    true_size = max(size - variance_of_mean / size, 0.0) if size > 0.0 else 0.0
    true_sigma = np.sqrt(np.sum(variances) * (1.0 - 1.0 / count) / (1.0 - 1.0 / independent))
    centre = float(true_size + 3.0 * true_sigma)
    directions = float(np.sum(variances) ** 2 / np.sum(np.square(variances)))
    freedom = (independent - 1.0) * np.sqrt(directions)
    scatter = scatter_of(figures, share, freedom, unsigned=unsigned)
    factor = float(np.exp(scatter.half_width / centre))
    return centre / factor, centre * factor


def scatter_of_difference(a: FloatArray, b: FloatArray, overlap: float, *, unsigned: bool) -> Scatter | None:
    """Return the scatter of the difference of mean + 3 sigma of paired errors `(n, d)`; None of too few.

    Both series are resampled in the same blocks, so that errors which they share do not count.
    """
    independent = len(a) / overlap
    if independent < MIN_INDEPENDENT:
        return None
    drawn = []
    share = 1.0
    for errors in (a, b):
        mean = np.mean(errors, axis=0)
        _, figures, share = resampled(group_moments(errors - mean, 1), mean, overlap)
        drawn.append(figures)
    share *= 1.0 - 1.0 / independent
    return scatter_of(drawn[1] - drawn[0], share, independent - 1.0, unsigned=unsigned)


def scatter_of(figures: FloatArray, share: float, freedom: float, *, unsigned: bool) -> Scatter:
    """Return the scatter of a figure from resampled ones `(B,)`, which show this fraction of its variance."""
    widening = WIDENING_UNSIGNED if unsigned else WIDENING
    return Scatter(float(widening * np.std(figures) / np.sqrt(share)), max(freedom, MIN_FREEDOM))


class Moments(NamedTuple):
    """Number of values n `(...)`, mean and sum of squared deviations from that mean `(..., d)` of some series."""

    n: FloatArray
    mean: FloatArray
    squares: FloatArray

    def rows(self, index: NDArray[np.integer]) -> Moments:
        """Return the moments of the series of an index, in its shape."""
        return Moments(self.n[index], self.mean[index], self.squares[index])


def group_moments(offsets: FloatArray, size: int) -> Moments:
    """Return the moments of groups of `size` consecutive offsets `(n, d)`; the last group may be shorter."""
    first = np.arange(0, len(offsets), size)
    count = np.diff(first, append=len(offsets))
    mean = np.add.reduceat(offsets, first) / count[:, None]
    deviations = offsets - np.repeat(mean, count, axis=0)
    return Moments(count.astype(np.float64), mean, np.add.reduceat(np.square(deviations), first))


def joined(parts: Moments) -> Moments:
    """Return the moments of series that are joined along the last axis of their number.

    Squares are summed about the common mean (Chan, Golub, LeVeque 1983), so that no digits cancel.
    """
    count = np.sum(parts.n, axis=-1)
    number = parts.n[..., None]
    mean = np.sum(number * parts.mean, axis=-2) / count[..., None]
    apart = number * np.square(parts.mean - mean[..., None, :])
    return Moments(count, mean, np.sum(parts.squares + apart, axis=-2))


def resampled(groups: Moments, mean: FloatArray, overlap: float, size: int = 1) -> tuple[FloatArray, FloatArray, float]:
    """Return mean vectors `(B, d)` and figures `(B,)` of resampled series, and the fraction of the variance they show.

    `groups` are those of `group_moments`, of `size` offsets from the mean each. The same number of groups is drawn the
    same way each time.
    """
    count = len(groups.n)
    block = min(max(1, int(np.ceil(overlap / size))), count)
    circle = (np.arange(count)[:, None] + np.arange(block)) % count
    blocks = joined(groups.rows(circle))
    draws = -(-count // block)
    drawn = np.random.default_rng(SEED).integers(0, count, (RESAMPLES, draws), dtype=np.int32)
    series = joined(blocks.rows(drawn))
    means = mean + series.mean
    variances = series.squares / np.maximum(series.n - 1.0, 1.0)[:, None]
    figures = np.linalg.norm(means, axis=1) + 3.0 * np.sqrt(np.sum(variances, axis=1))
    lags = np.arange(1.0, np.ceil(overlap))
    fall = 1.0 - lags / overlap
    shown = np.maximum(1.0 - lags / float(block * size), 0.0)
    share = float((1.0 + 2.0 * np.sum(fall * shown)) / (1.0 + 2.0 * np.sum(fall)))
    return means, figures, share


# ---- distributions, as scipy.stats computes them, without its slow import


def chi2_interval95(freedom: float, count: int) -> Interval:
    """Return the 2.5 % and 97.5 % points of a chi-squared variable, over a count."""
    return chi2_quantile(0.025, freedom) / count, chi2_quantile(0.975, freedom) / count


def chi2_quantile(share: float, freedom: float) -> float:
    """Return the value that a chi-squared variable stays below with this probability (Abramowitz, Stegun 26.4.19)."""
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(freedom / 2.0, share))


def normal_quantile(share: float) -> float:
    """Return the value that a standard normal variable stays below with this probability."""
    from scipy.special import ndtri

    return float(ndtri(share))


def student_quantile(share: float, freedom: float) -> float:
    """Return the value that a Student t variable stays below with this probability."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, share))


def holm(probabilities: Sequence[float | None]) -> list[float | None]:
    """Return probabilities corrected for their number (Holm 1979); None stays and does not count."""
    known = sorted((value, index) for index, value in enumerate(probabilities) if value is not None)
    corrected: list[float | None] = [None] * len(probabilities)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, value * (len(known) - rank)))
        corrected[index] = largest
    return corrected

"""The 95 % interval of mean + 3 sigma from overlapping sub-trajectories, and the distributions that tests need.

Sub-trajectories that share frames share errors. n sub-trajectories that overlap L starts each are equivalent to about
m = n / L independent ones. Blocks of at least L consecutive sub-trajectories are therefore resampled (circular block
bootstrap, Politis and Romano 1992). The bias of block resampling is corrected for overlapping sums, whose correlation
falls linearly to 0 over L starts:

- Blocks of length l underestimate the variance by the factor r = sum (1 - |h|/l)(1 - |h|/L) / sum (1 - |h|/L), over the
  lags |h| < L. Resampling m blocks underestimates the variance by the factor (m - 1) / m.
- The sample variance is too small by the factor (1 - 1/m) / (1 - 1/n). The norm of a mean vector is too large because
  of the scatter of the mean. The interval is centred on the figure after both corrections.
- The scatter of the resampled figures is scaled by Student's t on a logarithmic scale, because the figure is positive.
  The degrees of freedom are (m - 1) sqrt(k), and at least 1.5, where k = (sum v)^2 / sum v^2 is the effective number of
  components of the errors with the variances v. The interval is widened by 10 %, or by 25 % for unsigned errors, which
  are skewed. The degrees of freedom and the widening were chosen by experiment.

test/campaigns/interval_coverage.py measures how often the interval contains the true value. SciPy's special functions
are imported when the first figure requires them, because nodes must start quickly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.formulas import mean_plus_3sigma

Interval = tuple[float, float]  #: Lower and upper bound of a 95 % interval.
MAX_BLOCKS = 512  #: Maximum number of groups of consecutive errors; the size of a group is a power of two.
RESAMPLES = 1000
SEED = 20240229
WIDENING, WIDENING_UNSIGNED = 1.1, 1.25
"""Factors by which the scatter of resampled figures is too small, for signed and for unsigned errors."""
MIN_FREEDOM = 1.5
INDEPENDENT_FOR_INTERVAL = 2.0  #: Minimum number of independent sub-trajectories for an interval.


class Scatter(NamedTuple):
    """The standard deviation of a figure, and the degrees of freedom of this standard deviation."""

    sigma: float
    freedom: float

    @property
    def half_width(self) -> float:
        """Half the width of the 95 % interval, by Student's t."""
        return student_quantile(0.975, self.freedom) * self.sigma


def interval95(errors: FloatArray, overlap: float, *, unsigned: bool) -> Interval | None:
    """Return the 95 % interval of mean + 3 sigma of errors `(n,)` or `(n, d)`; None if too few are independent.

    `overlap` is the mean number of starts within one sub-trajectory. Unsigned errors cannot be negative.
    """
    count = len(errors)
    independent = count / max(overlap, 1.0)
    if independent < INDEPENDENT_FOR_INTERVAL or not np.isfinite(np.sum(errors)):
        return None
    vectors = errors.reshape(count, -1)
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
    centre = float(mean_plus_3sigma(true_size, true_sigma))
    directions = float(np.sum(variances) ** 2 / np.sum(np.square(variances)))
    freedom = (independent - 1.0) * np.sqrt(directions)
    scatter = scatter_of(figures, share, freedom, unsigned=unsigned)
    factor = float(np.exp(scatter.half_width / centre))
    return centre / factor, centre * factor


def scatter_of_difference(a: FloatArray, b: FloatArray, overlap: float, *, unsigned: bool) -> Scatter | None:
    """Return the scatter of the difference of mean + 3 sigma of paired errors `(n, d)`; None if there are too few.

    Both series are resampled in the same blocks, so that their common errors cancel.
    """
    independent = len(a) / overlap
    if independent < INDEPENDENT_FOR_INTERVAL:
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
    """Return the scatter of a figure from resampled figures `(B,)`, which have the fraction `share` of its variance."""
    widening = WIDENING_UNSIGNED if unsigned else WIDENING
    return Scatter(float(widening * np.std(figures) / np.sqrt(share)), max(freedom, MIN_FREEDOM))


class SeriesMoments(NamedTuple):
    """Number of values n `(...)` of series, their means and sums of squared deviations from the mean `(..., d)`."""

    n: FloatArray
    mean: FloatArray
    squares: FloatArray

    def rows(self, index: NDArray[np.integer]) -> SeriesMoments:
        """Return the moments of the indexed series, in the shape of the index."""
        return SeriesMoments(self.n[index], self.mean[index], self.squares[index])


def group_moments(offsets: FloatArray, size: int) -> SeriesMoments:
    """Return the moments of groups of `size` consecutive offsets `(n, d)`; the last group may be smaller."""
    first = np.arange(0, len(offsets), size)
    count = np.diff(first, append=len(offsets))
    mean = np.add.reduceat(offsets, first) / count[:, None]
    deviations = offsets - np.repeat(mean, count, axis=0)
    return SeriesMoments(count.astype(np.float64), mean, np.add.reduceat(np.square(deviations), first))


def joined(parts: SeriesMoments) -> SeriesMoments:
    """Return the moments of series that are concatenated along the last axis of `n`.

    Squares are summed about the common mean to avoid cancellation (Chan, Golub, LeVeque 1983).
    """
    count = np.sum(parts.n, axis=-1)
    number = parts.n[..., None]
    mean = np.sum(number * parts.mean, axis=-2) / count[..., None]
    apart = number * np.square(parts.mean - mean[..., None, :])
    return SeriesMoments(count, mean, np.sum(parts.squares + apart, axis=-2))


def resampled(
    groups: SeriesMoments, mean: FloatArray, overlap: float, size: int = 1
) -> tuple[FloatArray, FloatArray, float]:
    """Return resampled mean vectors `(B, d)` and figures `(B,)`, and the fraction of the variance that they have.

    `groups` are the result of `group_moments` for `size` offsets from the mean. The draws depend only on the number of
    groups, because the seed is fixed.
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
    figures = mean_plus_3sigma(np.linalg.norm(means, axis=1), np.sqrt(np.sum(variances, axis=1)))
    lags = np.arange(1.0, np.ceil(overlap))
    fall = 1.0 - lags / overlap
    shown = np.maximum(1.0 - lags / float(block * size), 0.0)
    share = float((1.0 + 2.0 * np.sum(fall * shown)) / (1.0 + 2.0 * np.sum(fall)))
    return means, figures, share


# ---- distributions of scipy.stats, without its slow import


def chi2_interval95(freedom: float, count: int) -> Interval:
    """Return the 2.5 % and 97.5 % quantiles of a chi-squared variable, divided by `count`."""
    return chi2_quantile(0.025, freedom) / count, chi2_quantile(0.975, freedom) / count


def chi2_quantile(share: float, freedom: float) -> float:
    """Return the quantile of the chi-squared distribution at a probability (Abramowitz, Stegun 26.4.19)."""
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(freedom / 2.0, share))


def normal_quantile(share: float) -> float:
    """Return the quantile of the standard normal distribution at a probability."""
    from scipy.special import ndtri

    return float(ndtri(share))


def student_quantile(share: float, freedom: float) -> float:
    """Return the quantile of Student's t distribution at a probability."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, share))


def holm(probabilities: Sequence[float | None]) -> list[float | None]:
    """Return p-values corrected for their number (Holm 1979). A None remains None and is not counted."""
    known = sorted((value, index) for index, value in enumerate(probabilities) if value is not None)
    corrected: list[float | None] = [None] * len(probabilities)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, value * (len(known) - rank)))
        corrected[index] = largest
    return corrected

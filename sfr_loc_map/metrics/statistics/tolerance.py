"""Statements about the distribution of all errors from a sample: tolerance bounds, confidence, number of drives.

A tolerance bound exceeds a fraction `prob` of all errors with a given `confidence`. For normal errors a small sample
suffices, and the bound is `norm(mean) + k norm(sigma)`, a generalised mean + 3 sigma. For other errors the bound is
an order statistic: the largest of n values exceeds the fraction p of all errors with the confidence `1 - p^n` (Wilks
1941). n is the number of independent values. For the factor n need not be an integer; for the order statistic n is the
length of the shortest series (`Sample.series_count`).

The factor k is computed from samples of normal errors with the observed ratio of sigmas. Two cases bound the factor. If
the mean is zero, errors of both signs are outside the bound. If the mean dominates along the main axis, the one-sided
factor of the noncentral t distribution applies (Hahn and Meeker 1991, section 4.6).
`test/campaigns/tolerance_coverage.py` measures how often the bounds hold.

SciPy's special functions are imported when the first figure requires them, because nodes must start quickly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask

THREE_SIGMA = 0.9973  #: Fraction of normal errors on one axis that are within 3 sigma (ECSS-E-ST-60-10C).
CONFIDENCE = 0.9  #: Default confidence for `THREE_SIGMA`; requires 852 drives without a failure.
DRAWS = 1 << 15  #: Number of samples from which factors and confidences are computed.
NORMALS = 1 << 15  #: Number of sampled errors for the radius that contains a fraction of all errors.
MIN_TESTED = 200
"""Minimum number of values for a test of normality. With fewer values the test often accepts errors with heavy tails,
whose bound is then far too small. The test accepts one in two samples of 20 values from Student's t with three degrees
of freedom, one in six samples of 60 values, and one in twenty of 100 values."""
ACCEPTED = 0.25  #: Minimum p-value to accept values as normal; the common 0.05 accepts too many heavy tails.
RISK = 0.4
"""Fraction of the risk `1 - confidence` that is assigned to the normal factor. The remainder covers the assumptions of
the factor: that the ratio of the sigmas is known, and that the acceptance by the test does not depend on sigma."""
MOST = 1_000_000  #: Maximum number of drives that is reported.
SEARCHED = 4096  #: Number of drives in one step of a search.


class BoundMethod(StrEnum):
    """How a bound was computed."""

    ASSUMED = "assumed normal"  #: The factor of a normal distribution, which the limits file declares.
    NORMAL = "tested normal"  #: The factor of a normal distribution, which a test of the values accepted.
    ORDER = "order"  #: An order statistic: one of the largest values.


# ---- fractions of failures


def zero_failure_count(prob: float, confidence: float) -> int:
    """Return how many independent values without a failure demonstrate the fraction `prob`: 59 for 95 % at 95 %."""
    return math.ceil(round(math.log(1.0 - confidence) / math.log(prob), 9))


def allowed_failures(count: int, prob: float, confidence: float) -> int:
    """Return the maximum number of failures among `count` values that demonstrate `prob`; -1 for too few values."""
    from scipy.special import bdtr

    if count < zero_failure_count(prob, confidence):
        return -1
    fewest, most = 0, count
    while fewest < most:
        middle = (fewest + most + 1) // 2
        if bdtr(middle, count, 1.0 - prob) <= 1.0 - confidence:
            fewest = middle
        else:
            most = middle - 1
    return fewest


def is_disproved(failures: int, count: int, prob: float, confidence: float) -> bool:
    """Return whether this number of failures excludes the fraction `prob` with this confidence."""
    from scipy.special import bdtrc

    return failures > 0 and bool(bdtrc(failures - 1, count, 1.0 - prob) <= 1.0 - confidence)


def count_for_rate(failures: int, count: int, prob: float, confidence: float) -> int | None:
    """Return how many values are required to demonstrate the fraction `prob` at the observed failure rate.

    The rate is `failures / count`. The result is the smallest such number that is not below `count`; None if a search
    up to `MOST` finds none. Without an observed failure, the result is `zero_failure_count`.
    """
    from scipy.special import bdtr

    if not failures:
        return zero_failure_count(prob, confidence)
    rate = failures / count
    if rate >= 1.0 - prob:
        return None

    def demonstrates(counts: IntArray) -> Mask:
        failing = np.ceil(rate * counts - 1e-9)
        return np.asarray(bdtr(failing, counts, 1.0 - prob) <= 1.0 - confidence)

    enough = _least(lambda n: bool(demonstrates(np.array([n])).all()), count)
    if enough is None:
        return None
    # a smaller number may suffice as well, because the number of failures is rounded up
    for first in range(count, enough, SEARCHED):
        counts = np.arange(first, min(first + SEARCHED, enough))
        smaller = counts[demonstrates(counts)]
        if len(smaller):
            return int(smaller[0])
    return enough


def _least(holds: Callable[[int], bool], start: int) -> int | None:
    """Return a number at which a rule holds, by bisection; None if the search exceeds `MOST`.

    The result is at least `start` and at least 2. It is the smallest such number if the rule holds for all numbers
    above it.
    """
    high = max(start, 2)
    while not holds(high):
        high *= 2
        if high > MOST:
            return None
    low = max(start, 2) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


# ---- normal errors


def _spread_evenly(count: int, columns: int) -> FloatArray:
    """Return a low-discrepancy sequence `(count, columns)` in the unit cube (additive recurrence, Roberts 2018)."""
    root = 2.0
    for _ in range(64):  # root of x^(d + 1) = x + 1
        root = (1.0 + root) ** (1.0 / (columns + 1.0))
    steps = np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, columns + 1.0)
    return np.asarray((0.5 + steps) % 1.0)


@lru_cache(maxsize=1)
def _normal_points() -> FloatArray:
    """Return errors `(NORMALS, 3)` of a standard normal distribution."""
    from scipy.special import ndtri

    return np.asarray(ndtri(_spread_evenly(NORMALS, 3)))


@lru_cache(maxsize=64)
def _samples(count: float) -> tuple[FloatArray, FloatArray]:
    """Return the means and variances, each `(DRAWS, 3)`, of samples of `count` standard normal errors."""
    from scipy.special import gammaincinv, ndtr

    points, freedom = _sample_points(), count - 1.0
    grid = np.linspace(-5.0, 5.0, 1001)
    quantiles = np.sqrt(2.0 / freedom * gammaincinv(freedom / 2.0, ndtr(grid)))
    return points[:, :3] / math.sqrt(count), np.square(np.interp(points[:, 3:], grid, quantiles))


@lru_cache(maxsize=1)
def _sample_points() -> FloatArray:
    """Return points `(DRAWS, 6)` of a standard normal distribution."""
    from scipy.special import ndtri

    return np.asarray(ndtri(_spread_evenly(DRAWS, 6)))


@lru_cache(maxsize=256)
def radius_of(prob: float, shape: tuple[float, ...]) -> float:
    """Return the radius that contains the fraction `prob` of zero-mean normal errors with up to 3 sigmas `shape`."""
    from scipy.special import ndtri

    if np.count_nonzero(shape) == 1:
        return float(max(shape) * ndtri((1.0 + prob) / 2.0))
    return float(np.quantile(np.linalg.norm(_normal_points()[:, : len(shape)] * shape, axis=1), prob))


def confidence_of(
    factor: float, count: float, shape: tuple[float, ...], prob: float, *, zero_mean: bool = False
) -> float | None:
    """Return the confidence that a bound covers at least the fraction `prob` of normal errors.

    The bound is `norm(mean) + factor norm(sigma)`, and `shape` contains the sigmas of the errors. The result is the
    lower of the confidences for a mean of zero and for a dominant mean, or with `zero_mean` the confidence for a mean
    of zero. None for fewer than two independent values.
    """
    if count < 2.0 or not any(shape):
        return None
    return min(float(np.mean(need <= factor)) for need in _needed_factors(count, shape, prob)[: 1 if zero_mean else 2])


def vector_factor(count: float, shape: tuple[float, ...], prob: float, confidence: float) -> float:
    """Return k for which `norm(mean) + k norm(sigma)` exceeds a fraction `prob` of normal errors, with this confidence.

    `shape` are the relative sigmas of the axes.
    """
    return max(float(np.quantile(need, confidence)) for need in _needed_factors(count, shape, prob))


def _needed_factors(count: float, shape: tuple[float, ...], prob: float) -> tuple[FloatArray, FloatArray]:
    """Return the factors `(DRAWS,)` with which the bounds just contain `prob`, for a zero and for a dominant mean.

    Sigmas are divided by the largest sigma, because the factors depend only on their ratios.
    """
    from scipy.special import ndtri

    sizes = np.asarray(shape) / max(shape)
    offsets, variances = _samples(count)
    axes = len(sizes)
    spread = np.sqrt(variances[:, :axes] @ np.square(sizes))
    radius = radius_of(prob, tuple(sizes.tolist()))
    of_zero_mean = (radius - np.linalg.norm(offsets[:, :axes] * sizes, axis=1)) / spread
    main = int(np.argmax(sizes))
    of_mean = (float(ndtri(prob)) - offsets[:, main]) / spread
    return of_zero_mean, of_mean


def normality(values: FloatArray) -> float | None:
    """Return the p-value of a test of normality; None for fewer than eight values.

    The test is that of Anderson and Darling with estimated mean and sigma (D'Agostino and Stephens 1986, table 4.9).
    """
    from scipy.special import log_ndtr

    count = len(values)
    if count < 8:
        return None
    spread = float(np.std(values, ddof=1))
    if spread <= 0.0:
        return 0.0
    scaled = np.sort((values - np.mean(values)) / spread)
    weights = 2.0 * np.arange(1, count + 1) - 1.0
    statistic = -count - float(np.mean(weights * (log_ndtr(scaled) + log_ndtr(-scaled[::-1]))))
    a = statistic * (1.0 + 0.75 / count + 2.25 / count**2)
    if a < 0.2:
        return 1.0 - math.exp(-13.436 + 101.14 * a - 223.73 * a * a)
    if a < 0.34:
        return 1.0 - math.exp(-8.318 + 42.796 * a - 59.938 * a * a)
    if a < 0.6:
        return math.exp(0.9177 - 4.279 * a - 1.38 * a * a)
    return math.exp(1.2937 - 5.709 * a + 0.0186 * a * a) if a < 13.0 else 0.0


# ---- a sample


class Sample(NamedTuple):
    """Errors in order, `(n,)` or vectors `(n, d)`, with their effective sample size."""

    errors: FloatArray
    independent: float

    @property
    def vectors(self) -> FloatArray:
        """The errors as vectors `(n, d)`."""
        return self.errors if self.errors.ndim == 2 else self.errors[:, None]

    @property
    def sizes(self) -> FloatArray:
        """The sizes of the errors `(n,)`."""
        return np.asarray(np.linalg.norm(self.vectors, axis=1))

    @property
    def step(self) -> int:
        """Number of errors from one independent error to the next."""
        return max(1, math.ceil(len(self.errors) / max(self.independent, 1.0) - 1e-9))

    @property
    def series_count(self) -> int:
        """Number of errors of the shortest series that has every `step`-th error.

        The number is smaller than `independent` if the step is rounded up.
        """
        return len(self.errors) // self.step


class Moments(NamedTuple):
    """Norms of mean and sigma of a sample, its sigmas along the principal axes, and the p-value of normality."""

    mean: float
    sigma: float
    shape: tuple[float, ...]  #: Sigmas along the principal axes, largest first.
    significance: float | None


def moments(sample: Sample) -> Moments | None:
    """Return the moments of a sample; None for fewer than two independent values, or if an error is unknown.

    The variance of overlapping errors is corrected by (1 - 1/n) / (1 - 1/m) for n errors, of which m are independent.
    Normality is tested with independent errors along each principal axis whose sigma is at least a tenth of the largest
    sigma.
    """
    vectors, count = sample.vectors, len(sample.errors)
    if count < 2 or sample.independent < 2.0 or not np.isfinite(vectors).all():
        return None
    mean = np.mean(vectors, axis=0)
    covariance = (vectors - mean).T @ (vectors - mean) / (count - 1.0)
    covariance *= (1.0 - 1.0 / count) / (1.0 - 1.0 / min(sample.independent, count))
    values, axes = np.linalg.eigh(covariance)
    shape = np.sqrt(np.maximum(values[::-1], 0.0))
    along = vectors @ axes[:, ::-1]
    tested = [normality(along[:: sample.step, axis]) for axis in range(len(shape)) if shape[axis] >= 0.1 * shape[0]]
    known = [value for value in tested if value is not None]
    significance = min(1.0, min(known) * len(known)) if known else None  # Bonferroni correction over the axes
    return Moments(float(np.linalg.norm(mean)), float(np.linalg.norm(shape)), tuple(shape.tolist()), significance)


class ToleranceBound(NamedTuple):
    """Upper and lower confidence bound of a quantile of the errors."""

    upper: float | None  #: None if the sample is too small.
    lower: float | None  #: 0 if the sample is too small; None without an independent value.
    method: BoundMethod  #: Method of the upper bound; the lower bound is an order statistic.


def method_of(sample: Sample, known: Moments | None, *, is_normal: bool) -> BoundMethod:
    """Return the method for a sample; `is_normal` declares that errors are normal, which no small sample can prove."""
    if known is None:
        return BoundMethod.ORDER
    if is_normal:
        return BoundMethod.ASSUMED
    if known.significance is None or min(sample.independent, len(sample.errors)) < MIN_TESTED:
        return BoundMethod.ORDER
    return BoundMethod.NORMAL if known.significance >= ACCEPTED else BoundMethod.ORDER


def tolerance_bound(sample: Sample, prob: float, confidence: float, *, is_normal: bool = False) -> ToleranceBound:
    """Return the bounds of the quantile `prob`: by a normal factor if allowed, otherwise by order statistics."""
    upper, lower = order_bounds(sample, prob, confidence)
    known = moments(sample)
    method = method_of(sample, known, is_normal=is_normal)
    if known is not None and method is not BoundMethod.ORDER:
        count = min(sample.independent, float(len(sample.errors)))
        upper = known.mean + normal_factor(count, known.shape, prob, confidence) * known.sigma
    return ToleranceBound(upper, lower, method)


def normal_factor(count: float, shape: tuple[float, ...], prob: float, confidence: float) -> float:
    """Return the factor of a normal bound, at a higher confidence that covers the factor's assumptions (`RISK`)."""
    if not any(shape):
        return 0.0
    return vector_factor(count, shape, prob, 1.0 - RISK * (1.0 - confidence))


def order_bounds(sample: Sample, prob: float, confidence: float) -> tuple[float | None, float | None]:
    """Return the bounds of the quantile `prob` by order statistics of the sizes, None if there are too few errors.

    Overlapping errors are divided into series of errors that do not overlap. The number of failures that a series may
    have follows from the length of the shortest series. The result is the largest upper bound and the smallest lower
    bound of the series.
    """
    sizes, step, count = sample.sizes, sample.step, sample.series_count
    if count < 1 or sample.independent + 1e-9 < 1.0 or not np.isfinite(sizes).all():
        return None, None
    discarded, failing = allowed_failures(count, prob, confidence), disproving_failures(count, prob, confidence)
    series = [np.sort(sizes[first::step])[::-1] for first in range(step)]
    upper = max(float(each[min(discarded, len(each) - 1)]) for each in series) if discarded >= 0 else None
    lower = 0.0 if failing is None else min(float(each[min(failing, len(each)) - 1]) for each in series)
    return upper, lower


@lru_cache(maxsize=1024)
def disproving_failures(count: int, prob: float, confidence: float) -> int | None:
    """Return the smallest number of failures that excludes the fraction `prob`, None if there is no such number."""
    return next((n for n in range(1, count + 1) if is_disproved(n, count, prob, confidence)), None)


def count_needed(
    sample: Sample, limit: float, prob: float, confidence: float, *, is_normal: bool = False
) -> int | None:
    """Return how many independent values like the sample demonstrate `prob` within a limit; None if no number does."""
    series = sample.sizes[:: sample.step]
    by_order = count_for_rate(int(np.count_nonzero(series > limit)), max(len(series), 1), prob, confidence)
    known = moments(sample)
    if known is None or method_of(sample, known, is_normal=is_normal) is BoundMethod.ORDER:
        return by_order
    by_factor = normal_count(known, limit, prob, confidence)
    return by_factor if by_factor is None or is_normal else max(by_factor, MIN_TESTED)


def normal_count(known: Moments, limit: float, prob: float, confidence: float) -> int | None:
    """Return how many independent normal values with these moments prove that a fraction is within a limit."""
    if known.sigma == 0.0:
        return 2 if known.mean <= limit else None
    room = (limit - known.mean) / known.sigma
    return _least(lambda n: normal_factor(float(n), known.shape, prob, confidence) <= room, 2)

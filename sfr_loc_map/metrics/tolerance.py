"""What a sample proves about errors that were not observed: tolerance bounds, confidence, number of drives.

A tolerance bound exceeds a stated share of all errors (`prob`) with a stated `confidence`. A normal distribution needs
few values: its bound is `norm(mean) + k norm(sigma)`, the form of the document's mean + 3 sigma. Without it the order
of the values decides: the largest of n values exceeds the share p of all errors with the confidence `1 - p^n` (Wilks
1941). n counts independent values and need not be a whole number.

The factor k follows from samples of normal errors with the ratio of sigmas that was observed. Two cases bound it: a
mean of zero, where `norm(error)` counts on both sides, and a mean that dominates along the main axis, where the
one-sided factor of the noncentral t distribution applies (Hahn and Meeker 1991, section 4.6).
`test/campaigns/tolerance_coverage.py` measures how often the bounds hold.

SciPy's special functions are imported when the first figure needs them, because nodes must start quickly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import StrEnum
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray

THREE_SIGMA = 0.9973  #: Share of the errors on one axis that lie within three sigma (ECSS-E-ST-60-10C, 3 sigma level).
CONFIDENCE = 0.9  #: Confidence that accompanies that share by default: 852 drives without a failure.
DRAWS = 1 << 15  #: Samples by which factors and confidences are computed.
NORMALS = 1 << 15  #: Errors by which the radius that holds a share of them is computed.
MIN_TESTED = 200
"""With fewer values a test of normality accepts errors with heavy tails (Student's t with three degrees of freedom: one
in two of 20 values, one in six of 60, one in twenty of 100), whose bound would then be far too small."""
ACCEPTED = 0.25  #: Significance below which values are not taken as normal, for the same reason not the usual 0.05.
RISK = 0.4
"""Fraction of the risk `1 - confidence` for the normal factor. The rest is for what the factor takes as known: the
ratio of the sigmas, and that the test accepts normal errors whatever their sigma."""
MOST = 1_000_000  #: Largest number of drives that is stated.


class BoundMethod(StrEnum):
    """How a bound was computed."""

    ASSUMED = "assumed normal"  #: A factor of a normal distribution, which was declared.
    NORMAL = "tested normal"  #: A factor of a normal distribution, which a test of the values accepted.
    ORDER = "order"  #: One of the largest values.


# ---- shares of failures


def zero_failure_count(prob: float, confidence: float) -> int:
    """Return how many independent values without a failure prove a share: 59 for 95 % with 95 % confidence."""
    return math.ceil(round(math.log(1.0 - confidence) / math.log(prob), 9))


def allowed_failures(count: int, prob: float, confidence: float) -> int:
    """Return how many of the values may fail so that a share is still proved; -1 if there are too few values."""
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
    """Return whether so many failures exclude the share with this confidence."""
    from scipy.special import bdtrc

    return failures > 0 and bool(bdtrc(failures - 1, count, 1.0 - prob) <= 1.0 - confidence)


def count_for_rate(failures: int, count: int, prob: float, confidence: float) -> int | None:
    """Return the least number of values that proves a share if they fail as often as those seen; None for no number."""
    if not failures:
        return zero_failure_count(prob, confidence)
    rate = failures / count
    if rate >= 1.0 - prob:
        return None
    return _least(lambda n: allowed_failures(n, prob, confidence) >= math.ceil(rate * n - 1e-9), count)


def _least(holds: Callable[[int], bool], start: int) -> int | None:
    """Return the least number, found by doubling and halving, at which a rule holds; None if none of `MOST`."""
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
    """Return points `(count, columns)` of the unit cube with low discrepancy (additive recurrence, Roberts 2018)."""
    root = 2.0
    for _ in range(64):  # of x^(d + 1) = x + 1
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
    """Return offsets of the mean and variances, each `(DRAWS, 3)`, of samples of standard normal errors."""
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
    """Return the radius that holds a share of normal errors about zero with these sigmas, at most three."""
    from scipy.special import ndtri

    if np.count_nonzero(shape) == 1:
        return float(max(shape) * ndtri((1.0 + prob) / 2.0))
    return float(np.quantile(np.linalg.norm(_normal_points()[:, : len(shape)] * shape, axis=1), prob))


def confidence_of(
    factor: float, count: float, shape: tuple[float, ...], prob: float, *, zero_mean: bool = False
) -> float | None:
    """Return the confidence that `norm(mean) + factor norm(sigma)` exceeds a share of normal errors with these sigmas.

    It is the lower one of a mean of zero and of a mean that dominates, unless the mean is known to be zero. None for
    fewer than two independent values.
    """
    if count < 2.0 or not any(shape):
        return None
    return min(float(np.mean(need <= factor)) for need in _needed_factors(count, shape, prob)[: 1 if zero_mean else 2])


def vector_factor(count: float, shape: tuple[float, ...], prob: float, confidence: float) -> float:
    """Return k so that `norm(mean) + k norm(sigma)` of normal errors with these sigmas exceeds a share of all."""
    return max(float(np.quantile(need, confidence)) for need in _needed_factors(count, shape, prob))


def _needed_factors(count: float, shape: tuple[float, ...], prob: float) -> tuple[FloatArray, FloatArray]:
    """Return the factors `(DRAWS,)` with which samples just meet a share: of a mean of zero, and of one that dominates.

    Sigmas are in units of the largest, so that the same shape gives the same factors.
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
    """Return the significance of values as a sample of a normal distribution; None for fewer than eight.

    Anderson and Darling's test with mean and sigma estimated (D'Agostino and Stephens 1986, table 4.9).
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
        """Errors this far apart are independent."""
        return max(1, math.ceil(len(self.errors) / max(self.independent, 1.0) - 1e-9))


class Moments(NamedTuple):
    """Norms of mean and sigma of a sample, its sigmas along the principal axes, and its significance as normal."""

    mean: float
    sigma: float
    shape: tuple[float, ...]  #: Largest first.
    significance: float | None


def moments(sample: Sample) -> Moments | None:
    """Return the moments of a sample; None for fewer than two independent values, or errors that are unknown.

    The variance of errors that overlap is too small by (1 - 1/m) / (1 - 1/n). Normality is tested along each principal
    axis with a sigma of at least a tenth of the largest one, on errors that are independent.
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
    significance = min(1.0, min(known) * len(known)) if known else None  # Bonferroni: any axis may refuse it
    return Moments(float(np.linalg.norm(mean)), float(np.linalg.norm(shape)), tuple(shape.tolist()), significance)


class ToleranceBound(NamedTuple):
    """An upper bound of a share of the errors, and a lower bound of the same quantile."""

    upper: float | None  #: None where the sample is too small.
    lower: float | None  #: With the same confidence the share of the errors that is smaller is less than stated.
    method: BoundMethod  #: Of the upper one; the lower one is by order.


def method_of(sample: Sample, known: Moments | None, *, is_normal: bool) -> BoundMethod:
    """Return how a sample is bounded; `is_normal` declares that errors are normal, which no small sample can show."""
    if known is None:
        return BoundMethod.ORDER
    if is_normal:
        return BoundMethod.ASSUMED
    if known.significance is None or min(sample.independent, len(sample.errors)) < MIN_TESTED:
        return BoundMethod.ORDER
    return BoundMethod.NORMAL if known.significance >= ACCEPTED else BoundMethod.ORDER


def tolerance_bound(sample: Sample, prob: float, confidence: float, *, is_normal: bool = False) -> ToleranceBound:
    """Return the bounds of a share of the errors: of a normal distribution where that is allowed, else by order."""
    upper, lower = order_bounds(sample, prob, confidence)
    known = moments(sample)
    method = method_of(sample, known, is_normal=is_normal)
    if known is not None and method is not BoundMethod.ORDER:
        count = min(sample.independent, float(len(sample.errors)))
        upper = known.mean + normal_factor(count, known.shape, prob, confidence) * known.sigma
    return ToleranceBound(upper, lower, method)


def normal_factor(count: float, shape: tuple[float, ...], prob: float, confidence: float) -> float:
    """Return the factor of a bound: that of the vectors, at a confidence that leaves room for what was estimated."""
    if not any(shape):
        return 0.0
    return vector_factor(count, shape, prob, 1.0 - RISK * (1.0 - confidence))


def order_bounds(sample: Sample, prob: float, confidence: float) -> tuple[float | None, float | None]:
    """Return the bounds of a share of the errors by the order of their sizes, None where there are too few.

    Errors that overlap form several series, each of errors that do not. Each series has bounds of its own, of which the
    largest upper one counts and the least lower one.
    """
    sizes, step = sample.sizes, sample.step
    count = int(min(sample.independent + 1e-9, len(sizes)))
    if count < 1 or not np.isfinite(sizes).all():
        return None, None
    discarded, failing = allowed_failures(count, prob, confidence), disproving_failures(count, prob, confidence)
    series = [np.sort(sizes[first::step])[::-1] for first in range(step)]
    upper = max(float(each[min(discarded, len(each) - 1)]) for each in series) if discarded >= 0 else None
    lower = 0.0 if failing is None else min(float(each[min(failing, len(each)) - 1]) for each in series)
    return upper, lower


@lru_cache(maxsize=1024)
def disproving_failures(count: int, prob: float, confidence: float) -> int | None:
    """Return the least number of failures that excludes a share, None if none of them does."""
    return next((n for n in range(1, count + 1) if is_disproved(n, count, prob, confidence)), None)


def count_needed(
    sample: Sample, limit: float, prob: float, confidence: float, *, is_normal: bool = False
) -> int | None:
    """Return how many independent values like these prove that a share is within a limit; None if no number does."""
    series = sample.sizes[:: sample.step]
    by_order = count_for_rate(int(np.count_nonzero(series > limit)), max(len(series), 1), prob, confidence)
    known = moments(sample)
    if known is None or method_of(sample, known, is_normal=is_normal) is BoundMethod.ORDER:
        return by_order
    by_factor = normal_count(known, limit, prob, confidence)
    return by_factor if by_factor is None or is_normal else max(by_factor, MIN_TESTED)


def normal_count(known: Moments, limit: float, prob: float, confidence: float) -> int | None:
    """Return how many independent normal values with these moments prove that a share lies within a limit."""
    if known.sigma == 0.0:
        return 2 if known.mean <= limit else None
    room = (limit - known.mean) / known.sigma
    return _least(lambda n: normal_factor(float(n), known.shape, prob, confidence) <= room, 2)

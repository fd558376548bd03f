"""What is said of many values: mean, scatter, percentiles, interval."""

from __future__ import annotations

from dataclasses import dataclass

Interval = tuple[float, float]
"""Lower and upper bound of a 95 % interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """Mean and scatter of one error.

    Attributes:
        mean: Sum of the values over n; of a vector the norm of the mean vector [4.1.3].
        sigma: `sqrt(sum (e_i - mean)^2 / (n - 1))`; of a vector the norm of the sigmas of its axes [4.1.3].
        mean_plus_3sigma: `|mean| + 3 sigma`.
    """

    mean: float | None
    sigma: float | None
    mean_plus_3sigma: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class IntervalStatistic(Statistic):
    """Mean and scatter of one error over sub-trajectories, with the interval of their sum.

    Attributes:
        mean_plus_3sigma_ci95: 95 % interval of mean + 3 sigma by circular block bootstrap; see `metrics.confidence`.
    """

    mean_plus_3sigma_ci95: Interval | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleStatistic:
    """Mean, scatter and percentiles of a set of single values.

    Attributes:
        count: Number of values n.
        mean: `sum e_i / n`.
        sigma: `sqrt(sum (e_i - mean)^2 / (n - 1))` [4.1.3].
        mean_plus_3sigma: `mean + 3 sigma`.
        p50: Median, interpolated linearly between values.
        p95: 95th percentile, alike.
    """

    count: int
    mean: float | None
    sigma: float | None
    mean_plus_3sigma: float | None
    p50: float | None
    p95: float | None

"""Errors of many drives as those of one: their sub-trajectories pooled, as the specification's statistics ask [4.1.3].

Counts, means and sigmas of the drives give count, mean and sigma of all their values exactly (Chan, Golub, LeVeque
1983). The 95 % interval resamples whole drives: errors within one drive are not independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.config import Condition
from sfr_loc_map.metrics.score import ConditionScore, IntervalStatistic, Statistic
from sfr_loc_map.metrics.statistics import student_quantile

MIN_DRIVES = 5
"""With fewer drives there is no interval."""
RESAMPLES = 2000
SEED = 20260101


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Count, mean and sum of squared deviations of each drive.

    Attributes:
        count: `(D,)`.
        mean: `(D, d)`.
        squares: `(D, d)` sum of squared deviations from the drive's mean.
    """

    count: FloatArray
    mean: FloatArray
    squares: FloatArray

    @classmethod
    def of(cls, drives: Sequence[tuple[int, Sequence[Statistic]]]) -> Moments:
        """Return the moments of drives, each with its count and the statistics of its components.

        Drives with fewer than two values are left out: their sigma is undefined.
        """
        used = [(n, parts) for n, parts in drives if n > 1]
        count = np.array([float(n) for n, _ in used])
        mean = np.array([[_known(part.mean) for part in parts] for _, parts in used])
        sigma = np.array([[_known(part.sigma) for part in parts] for _, parts in used])
        return cls(count, mean, np.square(sigma) * (count[:, None] - 1.0) if used else sigma)

    def pooled(self, weights: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return norm of the mean and norm of the sigma `(R,)` of all values.

        Args:
            weights: `(R, D)` how often each drive counts; None: once each.
        """
        weights = np.ones((1, len(self.count))) if weights is None else weights
        total = weights @ self.count
        mean = (weights @ (self.count[:, None] * self.mean)) / total[:, None]
        # about the common mean of the drives as they are, so that nothing cancels
        centre = (self.count[:, None] * self.mean).sum(axis=0) / self.count.sum()
        offset = self.mean - centre
        second = weights @ (self.squares + self.count[:, None] * np.square(offset))
        squares = second - total[:, None] * np.square(mean - centre)
        sigma = np.sqrt(np.maximum(squares, 0.0) / (total[:, None] - 1.0))
        return np.sqrt(np.square(mean).sum(axis=1)), np.sqrt(np.square(sigma).sum(axis=1))


def _known(value: float | None) -> float:
    """Return a figure of two values or more: it is defined."""
    assert value is not None
    return value


def pooled_statistic(moments: Moments) -> IntervalStatistic:
    """Return mean, sigma and mean + 3 sigma of all values, with the interval of the last."""
    if not len(moments.count):
        return IntervalStatistic(mean=None, sigma=None, mean_plus_3sigma=None, mean_plus_3sigma_ci95=None)
    mean, sigma = (float(values[0]) for values in moments.pooled())
    figure, drives = mean + 3.0 * sigma, len(moments.count)
    interval = None
    if drives >= MIN_DRIVES and figure > 0.0:
        means, sigmas = moments.pooled(drawn_weights(drives))
        spread = float(np.std(np.log(np.maximum(means + 3.0 * sigmas, 1e-300)))) * np.sqrt(drives / (drives - 1.0))
        factor = float(np.exp(student_quantile(0.975, drives - 1.0) * spread))
        interval = (figure / factor, figure * factor)
    return IntervalStatistic(mean=mean, sigma=sigma, mean_plus_3sigma=figure, mean_plus_3sigma_ci95=interval)


@lru_cache(maxsize=8)
def drawn_weights(drives: int) -> NDArray[np.float64]:
    """Return how often each drive is drawn `(RESAMPLES, D)`, the same for the same number."""
    rng = np.random.default_rng([SEED, drives])
    return rng.multinomial(drives, np.full(drives, 1.0 / drives), RESAMPLES).astype(np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledCondition:
    """Errors over the sub-trajectories of one condition of all drives.

    Attributes:
        condition: What ends a sub-trajectory.
        drives: Drives with at least two of them.
        count: Sub-trajectories.
        position_m: Position error.
        attitude_deg: Attitude error.
        heading_deg: Heading error; the mean is taken without its sign.
    """

    condition: Condition
    drives: int
    count: int
    position_m: IntervalStatistic
    attitude_deg: IntervalStatistic
    heading_deg: IntervalStatistic


FIGURES = ("position_m", "attitude_deg", "heading_deg")


def moments_of(scores: Sequence[ConditionScore], figure: str) -> Moments:
    """Return the moments of a figure of drives: of the position by axis, of angles as they are."""
    if figure == "position_m":
        return Moments.of(
            [(item.count, (item.components.x_m, item.components.y_m, item.components.z_m)) for item in scores]
        )
    return Moments.of([(item.count, (getattr(item, figure),)) for item in scores])


def pool(scores: Sequence[ConditionScore]) -> PooledCondition:
    """Return the pooled errors of the scores of one condition, one score a drive."""
    used = [item for item in scores if item.count > 1]
    statistics = {figure: pooled_statistic(moments_of(used, figure)) for figure in FIGURES}
    return PooledCondition(
        condition=scores[0].condition, drives=len(used), count=sum(item.count for item in used), **statistics
    )

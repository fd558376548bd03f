"""Comparison of one figure in the last nights with reference nights, over all jobs and for each job.

Values are compared on the scale of their kind (`SCALES`). The shift of the mean over all jobs, and the shift of each
job, have prediction intervals of Student's t from the scatter of the reference nights.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.suite.statistics.figures import ComparedKind

MIN_REFERENCE = 5  #: Minimum number of reference nights to estimate their scatter.
MIN_JOBS_OF_SCATTER = 6  #: Minimum number of jobs whose scatter replaces that of too few nights.
MAX_FREEDOM = 5.0  #: Upper bound of the degrees of freedom: nights have heavier tails than a normal distribution.
FALSE_NAMES = 0.1  #: Probability that an alarm names at least one unchanged job.


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale on which a kind of figure is compared: logarithm, count or identity."""

    apply: Callable[[FloatArray], FloatArray]  #: Converts values to the scale; NaN if undefined.
    #: Converts a mean on the scale to the reported mean; None if the reported mean is that of the values.
    undo: Callable[[float], float] | None
    floor: float  #: Minimum standard deviation of a job from night to night.
    of_host: bool = False  #: Whether the figure depends on the host, which all jobs of a night share.


def log_scale(floor: float, *, of_host: bool = False) -> Scale:
    """Return the scale of positive values, whose logarithms are compared; values that are not positive are missing."""
    return Scale(lambda x: np.log(np.where(x > 0.0, x, np.nan)), lambda value: float(np.exp(value)), floor, of_host)


COUNT = Scale(lambda x: 2.0 * np.sqrt(x + 0.375), None, 1.0)
"""Scale of a count n: `2 sqrt(n + 3/8)`, whose standard deviation is about 1 for Poisson counts (Anscombe 1948).

The scale is for the test only, because a mean of roots is far below the mean of counts that differ between jobs.
"""
#: The minimum standard deviations (`Scale.floor`) were chosen by hand: 5 % of an error or a time, 10 % of a NEES, 2 %
#: of memory, and 10 % of the jobs.
SCALES: Mapping[ComparedKind, Scale] = {
    ComparedKind.ACCURACY: log_scale(0.05),
    ComparedKind.NEES: log_scale(0.1),
    ComparedKind.LOST: COUNT,
    ComparedKind.DEGRADED: COUNT,
    ComparedKind.MISSING: COUNT,
    ComparedKind.FAILED: Scale(np.copy, float, 0.1),
    ComparedKind.TIME: log_scale(0.05, of_host=True),
    ComparedKind.MEMORY: log_scale(0.02, of_host=True),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """A change of the mean of nights relative to reference nights, on the scale of the comparison."""

    jobs: tuple[int, ...]  #: Changed jobs.
    of: int  #: Number of jobs with values before and after.
    before: float  #: Mean over the changed jobs before the change.
    after: float
    half_width: float  #: Half-width of the 95 % prediction interval of `after` from the reference nights.
    window: int  #: Number of nights whose mean revealed the change.


def is_last_night_tested(x: FloatArray, scale: Scale) -> bool:
    """Return whether the scatter of values `(D, T)` of jobs and nights is known, so that the last night is tested."""
    jobs = _JobShifts.of(x[:, :-1], x[:, -1:], scale)
    return bool(len(jobs.indices)) and bool(np.isfinite(jobs.scatter_of_mean(scale)[0]))


def compare_nights(before: FloatArray, after: FloatArray, scale: Scale, false_alarm_rate: float) -> Shift | None:
    """Return the change of the mean of nights `(D, W)` relative to reference nights `(D, N)`, None without a change.

    Half of the false-alarm rate is assigned to the mean over the jobs, the other half to the single jobs.
    """
    jobs = _JobShifts.of(before, after, scale)
    count = len(jobs.indices)
    if not count:
        return None
    sigma, freedom = jobs.scatter_of_mean(scale)
    has_mean_changed = abs(float(jobs.shifts.mean())) > sigma * float(_quantile(false_alarm_rate / 2, freedom))
    if not has_mean_changed and not jobs.exceeding(false_alarm_rate / 2).any():
        return None
    named = jobs.exceeding(FALSE_NAMES)
    number_named = int(named.sum())
    if 0 < number_named <= count / 2:
        sigma = float(np.sqrt(np.mean(np.square(jobs.sigmas[named])) / number_named))
        freedom = float(jobs.nights.max() - 1)
    else:
        named = np.ones(count, np.bool_)
        sigma = sigma if np.isfinite(sigma) else scale.floor / np.sqrt(count)
    return Shift(
        jobs=tuple(jobs.indices[named].tolist()),
        of=count,
        before=float(jobs.usual[named].mean()),
        after=float(jobs.present[named].mean()),
        half_width=sigma * float(_quantile(0.05, freedom)),
        window=jobs.window,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _JobShifts:
    """Shifts of the jobs that have values in the reference nights and in the compared nights."""

    indices: NDArray[np.intp]
    usual: FloatArray  #: Mean of each job over the reference nights.
    present: FloatArray  #: Mean of each job over the compared nights.
    deviations: FloatArray  #: Values of the reference nights minus their mean, `(job, night)`.
    nights: FloatArray  #: Number of reference nights of each job.
    per_compared_night: FloatArray  #: Inverse of the number of compared nights in which a job has a value.
    sigmas: FloatArray  #: Standard deviation of each shift.
    window: int  #: Number of compared nights.

    @classmethod
    def of(cls, before: FloatArray, after: FloatArray, scale: Scale) -> _JobShifts:
        """Return the shifts of the compared nights, `after` `(D, W)`, from the reference nights, `before` `(D, N)`."""
        usual, present = known_mean(before.T), known_mean(after.T)
        indices = np.flatnonzero(np.isfinite(present - usual))
        deviations = before[indices] - usual[indices, None]
        nights = np.asarray(np.isfinite(deviations).sum(axis=1), np.float64)
        variances = np.nansum(np.square(deviations), axis=1) / np.maximum(nights - 1, 1)
        is_long = nights >= MIN_REFERENCE
        if is_long.any():  # variances below the median, such as that of a job that never varied, become the median
            variances = np.maximum(variances, np.median(variances[is_long]))
        variances = np.maximum(variances, scale.floor**2)
        per_compared_night = 1.0 / np.isfinite(after[indices]).sum(axis=1)
        sigmas = np.sqrt(variances * (per_compared_night + 1.0 / nights))
        return cls(
            indices=indices,
            usual=usual[indices],
            present=present[indices],
            deviations=deviations,
            nights=nights,
            per_compared_night=per_compared_night,
            sigmas=sigmas,
            window=after.shape[1],
        )

    @property
    def shifts(self) -> FloatArray:
        """Shift of each job."""
        return self.present - self.usual

    def exceeding(self, false_alarm_rate: float) -> NDArray[np.bool_]:
        """Return which jobs changed, with the given rate of false alarms over all jobs together."""
        sizes = np.where(self.nights >= MIN_REFERENCE, np.abs(self.shifts) / self.sigmas, 0.0)
        return np.asarray(sizes > _quantile(false_alarm_rate / len(self.indices), self.nights - 1.0))

    def scatter_of_mean(self, scale: Scale) -> tuple[float, float]:
        """Return the standard deviation of the mean shift and its degrees of freedom; infinity if unknown.

        The scatter follows from the reference nights, or from the jobs if there are too few nights. The scatter of
        the jobs does not contain the speed of the host, which all jobs of a night share.
        """
        means = known_mean(self.deviations)
        means = means[np.isfinite(means)]
        nights, jobs = len(means), len(self.indices)
        if nights >= MIN_REFERENCE:
            per_night = float(self.per_compared_night.mean())
            sigma, freedom = float(np.std(means, ddof=1)) * np.sqrt(per_night + 1.0 / nights), nights - 1.0
        elif jobs >= MIN_JOBS_OF_SCATTER and not scale.of_host:
            sigma, freedom = float(np.std(self.shifts, ddof=1) / np.sqrt(jobs)), jobs - 1.0
        else:
            sigma, freedom = np.inf, 1.0
        return max(sigma, scale.floor / np.sqrt(jobs)), freedom


def _quantile(two_sided: float, freedom: FloatArray | float) -> FloatArray:
    """Return the two-sided quantile of Student's t for a probability of exceedance."""
    return np.asarray(-stdtrit(np.clip(freedom, 1.0, MAX_FREEDOM), 0.5 * two_sided))


def known_mean(values: FloatArray) -> FloatArray:
    """Return the mean `(N,)` of the known values of each column of `(K, N)`; NaN if a column has no known value."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.asarray(np.nanmean(values, axis=0))

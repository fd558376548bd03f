"""Shifts of one figure from night to night, in its values `(job, night)` on the scale of the figure (`SCALES`).

The nights since the last shift form one level, at which the figure is assumed to be constant. Each night is examined
by these comparisons, each of the mean over some nights with the mean over reference nights before them:

    step    the last night, and the last 4 nights, with up to 30 nights before them
    slow    the last 4 nights with the first 10 nights of the level, because a slow change also moves the nights just
            before the last ones, and increases their scatter
    return  for 5 nights after a shift, the last nights with the reference nights of the shift

A comparison tests the mean shift over all jobs and the shift of each job, by intervals of Student's t from the scatter
of the reference nights (`JobShifts`).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.suite.history.scales import Scale

WINDOWS = (1, 4)
"""Numbers of last nights over which the mean is taken: 1 detects large changes immediately, 4 small changes later."""
REFERENCE = 30  #: Maximum number of reference nights.
FIRST_NIGHTS = 10  #: Number of nights at the beginning of a level that are the reference for slow changes.
SLOW_SHARE = 0.1
"""Fraction of the false-alarm rate of a night that is assigned to the comparison for slow changes.

The windows share the rest. A small fraction delays the detection of slow changes by some nights, but leaves the
detection of steps almost unchanged."""
MIN_REFERENCE = 5  #: Minimum number of reference nights to estimate their scatter.
MIN_JOBS_OF_SCATTER = 6  #: Minimum number of jobs whose scatter replaces that of too few nights.
MAX_FREEDOM = 5.0  #: Upper bound of the degrees of freedom: nights have heavier tails than a normal distribution.
FALSE_NAMES = 0.1  #: Probability that an alarm names at least one unchanged job.


class Compared(NamedTuple):
    """The nights of a comparison."""

    before: slice  #: The reference nights.
    after: slice  #: Later nights, whose mean is compared with that of the reference nights.
    is_slow: bool = False  #: Whether the reference nights are the first nights of the level.

    @property
    def share(self) -> float:
        """Fraction of the false-alarm rate of a night that is assigned to the comparison."""
        return SLOW_SHARE if self.is_slow else (1.0 - SLOW_SHARE) / len(WINDOWS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """A shift of a figure, on its scale."""

    nights: Compared  #: The nights that revealed the shift.
    jobs: tuple[int, ...]  #: Shifted jobs.
    of: int  #: Number of jobs with values before and after.
    before: float  #: Mean over the shifted jobs before the shift.
    after: float
    half_width: float  #: Half-width of the 95 % prediction interval of `after` from the reference nights.
    night: int  #: First night after the shift; for a slow shift, the first of the nights of the compared mean.
    last_before: int  #: Last night before the shift in which a shifted job has a value.


def find_shifts(x: FloatArray, scale: Scale, false_alarm_rate: float) -> list[Shift]:
    """Return the shifts of values `(D, T)` of jobs and nights, NaN if missing, in the order of their detection.

    If the figure returns to its level before a shift within `MIN_REFERENCE` nights, the return is a second shift.
    Otherwise the level after the shift becomes the reference.
    """
    found: list[Shift] = []
    level_from = 0  # first night of the present level
    last: Shift | None = None  # the last shift, until the figure returns or its new level becomes the reference
    for night in range(1, x.shape[1]):
        if last is not None and night - last.night >= MIN_REFERENCE:
            level_from, last = last.night, None
        if last is None:
            shift = last = _shift_at(night, x, level_from, scale, false_alarm_rate)
        else:
            shift = _return_at(night, x, last, scale, false_alarm_rate)
            last = last if shift is None else None
        if shift is not None:
            found.append(shift)
    return found


def is_last_night_tested(x: FloatArray, scale: Scale) -> bool:
    """Return whether the scatter of values `(D, T)` of jobs and nights is known, so that the last night is tested."""
    jobs = JobShifts.of(x[:, :-1], x[:, -1:], scale)
    return bool(len(jobs.indices)) and bool(np.isfinite(jobs.scatter_of_mean(scale)[0]))


# ---- the comparisons of a night


def _shift_at(night: int, x: FloatArray, level_from: int, scale: Scale, false_alarm_rate: float) -> Shift | None:
    """Return the shift that the nights up to `night` reveal; None without a shift."""
    shifts = (compare(x, nights, scale, false_alarm_rate) for nights in _comparisons_at(night, level_from))
    return next((shift for shift in shifts if shift is not None), None)


def _comparisons_at(night: int, level_from: int) -> Iterator[Compared]:
    """Yield the comparisons of a night with earlier nights of its level."""
    for window in WINDOWS:
        first = night + 1 - window
        if first > level_from:
            yield Compared(slice(max(level_from, first - REFERENCE), first), slice(first, night + 1))
    end, first = level_from + FIRST_NIGHTS, night + 1 - max(WINDOWS)
    if first > end:
        yield Compared(slice(level_from, end), slice(first, night + 1), is_slow=True)


def _return_at(night: int, x: FloatArray, shift: Shift, scale: Scale, false_alarm_rate: float) -> Shift | None:
    """Return the return of a figure to its level before a shift; None without a return.

    After a return, the last nights do not differ significantly from the level before the shift, and their mean over
    the shifted jobs is closer to this level than to the level after the shift. The first condition alone is also met
    by a small shift that persists. A night without a value of the shifted jobs is not evidence of a return.
    """
    shifted = x[list(shift.jobs)]
    if not np.isfinite(shifted[:, night]).any():
        return None
    before, after = shift.nights.before, shift.nights.after
    first = max(shift.night, night + 1 - (after.stop - after.start))
    last_nights = Compared(before, slice(first, night + 1))
    if compare(x, last_nights, scale, false_alarm_rate) is not None:
        return None
    distances = known_mean(shifted[:, last_nights.after].T) - known_mean(shifted[:, before].T)
    if np.nanmean(distances) / (shift.after - shift.before) >= 0.5:
        return None
    return Shift(
        nights=Compared(after, slice(night, night + 1)),
        jobs=shift.jobs,
        of=shift.of,
        before=shift.after,
        after=float(known_mean(shifted[:, night])),
        half_width=shift.half_width,
        night=night,
        last_before=_last_with_value(shifted[:, :night]),
    )


# ---- one comparison


def compare(x: FloatArray, nights: Compared, scale: Scale, false_alarm_rate: float) -> Shift | None:
    """Return the shift of values `(D, T)` from reference nights to later nights; None without a significant shift.

    Half of the false-alarm rate of the comparison is assigned to the mean over the jobs, the other half to the single
    jobs. A shift is that of the jobs whose own shift is significant. If more than half of the jobs are, or none of
    them, the shift is that of all jobs.
    """
    before, after = x[:, nights.before], x[:, nights.after]
    jobs = JobShifts.of(before, after, scale)
    count = len(jobs.indices)
    if not count:
        return None
    sigma, freedom = jobs.scatter_of_mean(scale)
    rate = 0.5 * nights.share * false_alarm_rate
    has_mean_shifted = abs(float(jobs.shifts.mean())) > sigma * float(_quantile(rate, freedom))
    if not has_mean_shifted and not jobs.exceeding(rate).any():
        return None
    named = jobs.exceeding(FALSE_NAMES)
    number_named = int(named.sum())
    if 0 < number_named <= count / 2:
        sigma = float(np.sqrt(np.mean(np.square(jobs.sigmas[named])) / number_named))
        freedom = float(jobs.nights.max() - 1)
    else:
        named = np.ones(count, np.bool_)
        sigma = sigma if np.isfinite(sigma) else scale.floor / np.sqrt(count)
    rows = jobs.indices[named]
    if nights.is_slow:  # a slow shift has no first night
        night, end_before = nights.after.start, nights.before.stop
    else:
        night = end_before = nights.after.start + _start_of_shift(before[rows], after[rows])
    return Shift(
        nights=nights,
        jobs=tuple(rows.tolist()),
        of=count,
        before=float(jobs.usual[named].mean()),
        after=float(jobs.present[named].mean()),
        half_width=sigma * float(_quantile(0.05, freedom)),
        night=night,
        last_before=_last_with_value(x[rows, :end_before]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JobShifts:
    """Shifts of the jobs that have values in the reference nights and in the compared nights."""

    indices: NDArray[np.intp]
    usual: FloatArray  #: Mean of each job over the reference nights.
    present: FloatArray  #: Mean of each job over the compared nights.
    deviations: FloatArray  #: Values of the reference nights minus their mean, `(job, night)`.
    nights: FloatArray  #: Number of reference nights of each job.
    per_compared_night: FloatArray  #: Inverse of the number of compared nights in which a job has a value.
    sigmas: FloatArray  #: Standard deviation of each shift.

    @classmethod
    def of(cls, before: FloatArray, after: FloatArray, scale: Scale) -> JobShifts:
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
        )

    @property
    def shifts(self) -> FloatArray:
        """Shift of each job."""
        return self.present - self.usual

    def exceeding(self, false_alarm_rate: float) -> NDArray[np.bool_]:
        """Return which jobs shifted, with the given rate of false alarms over all jobs together."""
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


def _start_of_shift(before: FloatArray, after: FloatArray) -> int:
    """Return the night of `after` `(D, W)` from which the shift from the reference nights `(D, N)` is most significant.

    The shift of a night is relative to the level of each job, so that a night without the result of a job is not
    shifted. A shift cannot start in a night without a value.
    """
    levels = known_mean(before.T)
    shifts = known_mean(after - levels[:, None])
    sizes = np.full(len(shifts), -np.inf)
    for night in np.flatnonzero(np.isfinite(shifts)):
        later = shifts[night:][np.isfinite(shifts[night:])]
        sizes[night] = abs(later.mean()) / np.sqrt(1.0 / len(later) + 1.0 / before.shape[1])
    return int(np.argmax(sizes))


def _last_with_value(x: FloatArray) -> int:
    """Return the last night in which a job has a value."""
    return int(np.flatnonzero(np.isfinite(x).any(axis=0))[-1])


def _quantile(two_sided: float, freedom: FloatArray | float) -> FloatArray:
    """Return the two-sided quantile of Student's t for a probability of exceedance."""
    return np.asarray(-stdtrit(np.clip(freedom, 1.0, MAX_FREEDOM), 0.5 * two_sided))


def known_mean(values: FloatArray) -> FloatArray:
    """Return the mean `(N,)` of the known values of each column of `(K, N)`; NaN if a column has no known value."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return np.asarray(np.nanmean(values, axis=0))

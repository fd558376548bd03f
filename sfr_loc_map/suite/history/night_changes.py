"""Changes of one figure from night to night, slow changes over many nights, and returns to the level before a change.

The nights since the last change form one level, at which the figure is assumed to be constant. The last nights are
compared with the nights just before them, which reveals steps. A slow change is hidden from this comparison, because it
moves these nights, too, and increases their scatter. The last nights are therefore also compared with the first nights
of the level.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.suite.history.night_comparison import MIN_REFERENCE, Scale, Shift, compare_nights, known_mean

WINDOWS = (1, 4)
"""Numbers of last nights over which the mean is taken: 1 detects large changes immediately, 4 small changes later."""
REFERENCE = 30  #: Maximum number of reference nights.
FIRST_NIGHTS = 10  #: Number of nights at the beginning of a level that are the reference for slow changes.
SLOW_SHARE = 0.1
"""Fraction of the false-alarm rate of a night that is assigned to the comparison for slow changes.

The windows share the rest. A small fraction delays the detection of slow changes by some nights, but leaves the
detection of steps almost unchanged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundChange(Shift):
    """A change of values `(job, night)` with its nights."""

    night: int  #: First night after the change; for a slow change, the first of the nights of the compared mean.
    last_before: int  #: Last night before the change in which a changed job has a value.
    detected: int  #: Night at which the change was detected.
    nights_before: tuple[int, int]  #: First night of the values before the change, and the night after their last.
    nights_after: tuple[int, int]  #: The same for the values after the change.
    is_slow: bool = False  #: Whether only the comparison with the first nights of the level reveals the change.
    is_return: bool = False  #: Whether the figure returned to the level that it had before the previous change.


def changes_of(x: FloatArray, scale: Scale, false_alarm_rate: float) -> list[FoundChange]:
    """Return the changes of values `(D, T)` of jobs and nights, NaN if missing, in the order of their detection.

    Each night is compared with the reference nights of the present level, and with its first nights. After a change,
    the following nights are compared with the same reference. If the figure returns to its level before the change
    within `MIN_REFERENCE` nights, the return is a second change. Otherwise the level after the change becomes the
    reference.
    """
    rate, slow_rate = (1.0 - SLOW_SHARE) * false_alarm_rate / len(WINDOWS), SLOW_SHARE * false_alarm_rate
    found: list[FoundChange] = []
    level_from = 0  # first night of the present level
    last: FoundChange | None = None  # the last change, until the figure returns or its new level becomes the reference
    for night in range(1, x.shape[1]):
        if last is not None and night - last.night >= MIN_REFERENCE:
            level_from, last = last.night, None
        if last is not None:
            change = _return_at(night, x, last, scale, rate)
            last = last if change is None else None
        else:
            change = _change_at(night, x, level_from, scale, rate)
            change = last = change or _slow_change_at(night, x, level_from, scale, slow_rate)
        if change is not None:
            found.append(change)
    return found


def _change_at(night: int, x: FloatArray, level_from: int, scale: Scale, false_alarm_rate: float) -> FoundChange | None:
    """Return the change of values `(D, T)` that the mean of the nights up to `night` reveals; None without a change.

    The reference nights are those since `level_from`, at most `REFERENCE`.
    """
    for window in WINDOWS:
        first = night + 1 - window
        if first <= level_from:
            return None
        begin = max(level_from, first - REFERENCE)
        before, after = x[:, begin:first], x[:, first : night + 1]
        shift = compare_nights(before, after, scale, false_alarm_rate)
        if shift is None:
            continue
        jobs = list(shift.jobs)
        changed_at = first + _start_of_change(before[jobs], after[jobs])
        return FoundChange(
            **asdict(shift),
            night=changed_at,
            last_before=_last_with_value(x[jobs, :changed_at]),
            detected=night,
            nights_before=(begin, first),
            nights_after=(first, night + 1),
        )
    return None


def _slow_change_at(
    night: int, x: FloatArray, level_from: int, scale: Scale, false_alarm_rate: float
) -> FoundChange | None:
    """Return the change of values `(D, T)` from the first nights of a level to `night`; None without a change.

    A slow change has no first night. Its range begins with the first nights of the level and ends with the nights of
    the compared mean.
    """
    end, first = level_from + FIRST_NIGHTS, night + 1 - max(WINDOWS)
    if first <= end:
        return None
    shift = compare_nights(x[:, level_from:end], x[:, first : night + 1], scale, false_alarm_rate)
    if shift is None:
        return None
    return FoundChange(
        **asdict(shift),
        night=first,
        last_before=_last_with_value(x[list(shift.jobs), :end]),
        detected=night,
        nights_before=(level_from, end),
        nights_after=(first, night + 1),
        is_slow=True,
    )


def _return_at(
    night: int, x: FloatArray, change: FoundChange, scale: Scale, false_alarm_rate: float
) -> FoundChange | None:
    """Return the return of values `(D, T)` to their level before a change; None without a return.

    After a return, the last nights do not differ significantly from the level before the change, and their mean over
    the changed jobs is closer to this level than to the level after the change. The first condition alone is also met
    by a small change that persists. A night without a value of the changed jobs is not evidence of a return.
    """
    changed = x[list(change.jobs)]
    if not np.isfinite(changed[:, night]).any():
        return None
    begin, end = change.nights_before
    first = max(change.night, night + 1 - change.window)
    if compare_nights(x[:, begin:end], x[:, first : night + 1], scale, false_alarm_rate) is not None:
        return None
    shifts = known_mean(changed[:, first : night + 1].T) - known_mean(changed[:, begin:end].T)
    if np.nanmean(shifts) / (change.after - change.before) >= 0.5:
        return None
    return replace(
        change,
        night=night,
        detected=night,
        last_before=_last_with_value(changed[:, :night]),
        before=change.after,
        after=float(known_mean(changed[:, night])),
        nights_before=change.nights_after,
        nights_after=(night, night + 1),
        is_slow=False,
        is_return=True,
    )


def _start_of_change(before: FloatArray, after: FloatArray) -> int:
    """Return the night of `after` `(D, W)` from which the shift from the reference nights `(D, N)` is most significant.

    The shift of a night is relative to the level of each job, so that a night without the result of a job is not
    shifted. A change cannot start in a night without a value.
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

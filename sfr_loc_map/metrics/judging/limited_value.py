"""The limited number of a score: a row and a column of the table of figures, and the effect of the truth's error."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from sfr_loc_map.metrics.config import Reading
from sfr_loc_map.metrics.figures.catalogue import KINDS, TOTAL
from sfr_loc_map.metrics.figures.row_part import ANY, ATTITUDE, TURN, RowPart
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.formulas import QUANTILES, STATISTICS
from sfr_loc_map.metrics.score.limits import Limit
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.statistics.intervals import Interval, normal_quantile

EXPANSION = {"mean": 1.0, "sigma": 1.0, "rmse": 1.0, TOTAL: math.sqrt(1.0 + 3.0**2), "max": 3.0} | {
    name: float(math.ceil(NormalDist().inv_cdf(0.5 + percent / 200.0))) for name, percent in QUANTILES.items()
}
"""Change of each statistic by the error of the truth, in multiples of the root mean square e of this error.

Errors of the truth with the mean b and the standard deviation c have `b^2 + c^2 = e^2`. They change the mean by at most
b, sigma by at most c, and the rmse by at most e. They change mean + 3 sigma by at most `b + 3 c`, which is at most
`sqrt(10) e` (Cauchy-Schwarz). The n - 1 of sigma, which matters for few values, is neglected in c.

A quantile and the largest size have no such bound. The factor of a quantile is the same quantile of a normal error,
rounded up to an integer, and that of the largest size is 3. The standard library is used because scipy is slow to
import.
"""


class LimitedValue(NamedTuple):
    """A limited number, its number of values and its 95 % interval; None where undefined."""

    value: float | None = None
    n: int | None = None  #: Number of values of the statistic.
    interval: Interval | None = None
    row: Figure | None = None
    row_index: int | None = None  #: Index of the row in the table of figures.
    independent: float | None = None  #: Number of independent values.
    truth_error: float = 0.0  #: Change of the number that the error of the truth can cause (`EXPANSION`).


def value_of(limit: Limit, score: Score, reading: Reading | None = None) -> LimitedValue:
    """Return the limited number by the judged reading of the specification, or by another reading if it is given."""
    limited = limit.limited
    row = limited_row(limit, score, limited.part if reading is None else RowPart(reading))
    if row is None:
        return LimitedValue()
    is_counted = limited.statistic in STATISTICS and not limit.is_on_one_call
    interval = row.interval if limited.statistic == TOTAL else None
    count = row.n if is_counted else None
    return LimitedValue(
        value=row.statistic(limited.statistic),
        n=count,
        interval=interval,
        row=row,
        row_index=score.index_of(row),
        independent=row.independent,
        truth_error=truth_error_of(limit, score, row.part),
    )


def limited_row(limit: Limit, score: Score, part: RowPart | None) -> Figure | None:
    """Return the limited row, which is the judged row if `part` is None; None if there is no such row."""
    limited = limit.limited
    if limited.is_of_worst_call:
        rows = score.rows(limited.figure, subject=limited.subject)
        return max(rows, key=_rank_of_fraction, default=None)
    condition = ANY if limit.condition is None else limit.condition
    if part is None:
        return score.judged_row(limited.figure, subject=limited.subject, condition=condition)
    return score.figure(limited.figure, subject=limited.subject, condition=condition, part=part)


def _rank_of_fraction(row: Figure) -> float:
    """Return the rank of a fraction, largest for the worst row: unknown, then by value, then a fraction of 0 items."""
    if row.n == 0:
        return -1.0
    return math.inf if row.value is None else row.value


def truth_error_of(limit: Limit, score: Score, reading: str | None = None) -> float:
    """Return the change of a limited number that errors of the truth at both ends of a sub-trajectory can cause.

    The reading `pose` rotates the estimate by the true attitude at the start, whose error also moves the end.
    """
    if limit.section is not LimitSection.TRAJECTORY:
        return 0.0
    kind = KINDS[limit.limited.figure]
    is_length = kind.unit == "m"
    part = None if is_length else ATTITUDE
    of_ends = float(np.sqrt(2.0)) * (score.number("truth_error", condition=None, part=part) or 0.0)
    is_turned = is_length and not kind.is_of_all_readings and reading == Reading.POSE
    of_turn = score.number("truth_error", condition=limit.condition, part=TURN) if is_turned else None
    return expansion_of(limit) * float(np.hypot(of_ends, of_turn or 0.0))


def expansion_of(limit: Limit) -> float:
    """Return the change of a limited statistic by the error of the truth, in multiples of the latter (`EXPANSION`)."""
    if limit.terms is None:
        return EXPANSION[limit.limited.statistic]
    return normal_quantile(0.5 * (1.0 + limit.terms.prob))

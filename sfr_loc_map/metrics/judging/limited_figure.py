"""The number that a limit is on: a row of the table of figures, and a column of it."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from sfr_loc_map.metrics.catalogue import ANY, KINDS
from sfr_loc_map.metrics.config import Rebase
from sfr_loc_map.metrics.formulas import QUANTILES, STATISTICS
from sfr_loc_map.metrics.intervals import Interval, normal_quantile
from sfr_loc_map.metrics.limits import Limit, LimitSection
from sfr_loc_map.metrics.row_part import RowPart
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.metrics.truth_error import ATTITUDE, TURN

EXPANSION = {
    **{"mean": 1.0, "sigma": 1.0, "rmse": 1.0, "mean_plus_3sigma": 3.0, "max": 3.0},
    **{name: float(math.ceil(NormalDist().inv_cdf(0.5 + percent / 200.0))) for name, percent in QUANTILES.items()},
}
"""Standard deviations of the truth's error that each statistic may be off by; of a quantile those of a normal error,
rounded up to 1, 2 or 3. The normal distribution is that of the standard library, because scipy loads slowly."""


class LimitedFigure(NamedTuple):
    """The number that a limit is on, how many values it is made of and its 95 % interval, where it has them."""

    value: float | None = None
    n: int | None = None
    interval: Interval | None = None
    row: Figure | None = None
    place: int | None = None  #: Of the row in the table of figures.
    independent: float | None = None  #: How many of the values are independent, None where that is not defined.
    truth_error: float = 0.0  #: What the error of the truth may change the number by.


def figure_of(limit: Limit, score: Score, reading: Rebase | None = None) -> LimitedFigure:
    """Return the number that a limit is on, by the reading that is judged or, of a trajectory, by another reading."""
    limited = limit.limited
    row = limited_row(limit, score, limited.part if reading is None else RowPart(reading))
    if row is None:
        return LimitedFigure()
    is_counted = limited.statistic in STATISTICS and not limit.is_on_one_call
    interval = row.interval if limited.statistic == "mean_plus_3sigma" else None
    count = row.n if is_counted else None
    return LimitedFigure(
        value=row.statistic(limited.statistic),
        n=count,
        interval=interval,
        row=row,
        place=score.place_of(row),
        independent=row.independent,
        truth_error=truth_error_of(limit, score, row.part),
    )


def limited_row(limit: Limit, score: Score, part: RowPart | None) -> Figure | None:
    """Return the row that a limit is on, None without one; without a part, the row that is judged."""
    limited = limit.limited
    if limited.is_of_worst_call:
        rows = score.rows(limited.figure, subject=limited.subject)
        return max(rows, key=lambda item: math.inf if item.value is None else item.value, default=None)
    condition = ANY if limit.condition is None else limit.condition
    if part is None:
        return score.judged_row(limited.figure, subject=limited.subject, condition=condition)
    return score.figure(limited.figure, subject=limited.subject, condition=condition, part=part)


def truth_error_of(limit: Limit, score: Score, reading: str | None = None) -> float:
    """Return what the error of the truth may change a limited number by: that of both ends of a sub-trajectory.

    The reading `pose` turns the estimate by the true attitude at the start, whose error moves the end as well.
    """
    limited = limit.limited
    if limit.section is not LimitSection.TRAJECTORY:
        return 0.0
    part = None if KINDS[limited.figure].unit == "m" else ATTITUDE
    of_ends = float(np.sqrt(2.0)) * (score.number("truth_error", condition=None, part=part) or 0.0)
    turned = limited.figure in ("position", "horizontal") and reading == Rebase.POSE
    of_turn = score.number("truth_error", condition=limit.condition, part=TURN) if turned else None
    return expansion_of(limit) * float(np.hypot(of_ends, of_turn or 0.0))


def expansion_of(limit: Limit) -> float:
    """Return how many standard deviations of the truth's error a limited statistic may be off by."""
    if limit.terms is None:
        return EXPANSION[limit.limited.statistic]
    return normal_quantile(0.5 * (1.0 + limit.terms.prob))

"""The number that a limit is on: a row of the table of figures, and a column of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sfr_loc_map.metrics.catalogue import ANY
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.limits import WORST, Limit, LimitPart
from sfr_loc_map.metrics.score import Figure, Score
from sfr_loc_map.metrics.statistics import Interval
from sfr_loc_map.metrics.truth_error import ATTITUDE

COVERAGE_FACTORS = {"mean_plus_3sigma": 3.0, "max": 3.0, "p99": 3.0, "p95": 2.0}
"""Standard deviations of the truth's error that a statistic may be off by, 1 for others."""


class LimitedFigure(NamedTuple):
    """The number that a limit is on, how many values it is made of and its 95 % interval, where it has them."""

    value: float | None = None
    n: int | None = None
    interval: Interval | None = None
    row: Figure | None = None
    independent: float | None = None  #: How many of the values are independent, None where that is not defined.
    truth_error: float = 0.0  #: What the error of the truth may change the number by.


def figure_of(limit: Limit, score: Score, part: str | None = ANY) -> LimitedFigure:
    """Return the number that a limit is on, by the reading that is judged or, of a trajectory, by another part."""
    limited = limit.limited
    place = limited.part if part == ANY else part
    condition = ANY if limit.condition is None else limit.condition
    if place == WORST:
        rows = score.rows(limited.figure, subject=limited.subject)
        row = max(rows, key=lambda item: math.inf if item.value is None else item.value, default=None)
    elif place == ANY:
        row = score.judged_row(limited.figure, subject=limited.subject, condition=condition)
    else:
        row = score.figure(limited.figure, subject=limited.subject, condition=condition, part=place)
    if row is None:
        return LimitedFigure()
    is_counted = limited.statistic in STATISTICS and not limit.is_on_one_call
    interval = row.interval if limited.statistic == "mean_plus_3sigma" else None
    count = row.n if is_counted else None
    error = truth_error_of(limit, score)
    return LimitedFigure(row.statistic(limited.statistic), count, interval, row, row.independent, error)


def truth_error_of(limit: Limit, score: Score) -> float:
    """Return what the error of the truth may change a limited number by: that of both ends of a sub-trajectory."""
    limited = limit.limited
    if limit.part is not LimitPart.TRAJECTORY:
        return 0.0
    part = None if limited.figure in ("position", "horizontal", "chord") else ATTITUDE
    sigma = score.number("truth_error", part=part) or 0.0
    return COVERAGE_FACTORS.get(limited.statistic, 1.0) * float(np.sqrt(2.0)) * sigma

"""What a limit is about: its number in the table of figures, its task, and the data that must be complete.

1. `value_of` returns the limited number, a row and a column of the table, with the effect of the truth's error.
2. `task_of` and `tasks_of` return the task of a limit, and the tasks of a score.
3. `required_scope` and `required_scopes` return the scopes that must be complete for a pass (`figures.subjects`).
4. `fault_of_data_set` compares the data with the hashes that the limits name (`data_set_sha256`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.config import Reading
from sfr_loc_map.metrics.figures.catalogue import JUDGED, KINDS, TOTAL
from sfr_loc_map.metrics.figures.records import InputFile
from sfr_loc_map.metrics.figures.row_part import ANY, ATTITUDE, TURN, Place, RowPart, calls_part
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import SCOPE_OF, SUBJECT_OF, LimitSection, Scope, Subject
from sfr_loc_map.metrics.formulas import QUANTILES, STATISTICS
from sfr_loc_map.metrics.score.limits import OF_MAP, Limit, Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.statistics.intervals import Interval, normal_quantile
from sfr_loc_map.suite_names import Task

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

DATA_SET_ROLES = {
    "truth": "the ground truth of the drive",
    "truth_file": "the file of truth.source",
    "images": "the stamps and the rig of the images",
    "map_truth": "the source of the map",
}
"""Inputs that belong to the data set, by role in the provenance, and their words in a message.

The hash of a bag covers its images. The hash of the ground truth in a folder covers only the file of the true poses.
"""
SCOPES_OF_ALL_LIMITS = (RowPart(Scope.LIVE), RowPart(Scope.INPUTS))
"""Scopes that every limit requires, if the score has them."""


# ---- the limited number


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


# ---- the task, and what must be complete


def task_of(limit: Limit) -> Task:
    """Return the task that a limit is about."""
    limited = limit.limited
    if limited.call is not None:
        return limited.call.task
    is_of_map = limited.subject is Subject.MAP or limited.figure in OF_MAP
    return Task.MAPPING if is_of_map else Task.LOCALISATION


def tasks_of(score: Score) -> list[Task]:
    """Return the tasks that a score is about."""
    return [
        task
        for task, each in SUBJECT_OF.items()
        if score.has(each.subject) or score.figure(JUDGED, part=each.scope) is not None
    ]


def has_task(score: Score, task: Task) -> bool:
    """Return whether a score has results of a task, or calls of the task whose results are missing."""
    calls = [row.part.call for row in score.rows(JUDGED) if row.part is not None and row.part.call is not None]
    return task in tasks_of(score) or any(call.task is task for call in calls)


def limits_about(limits: Limits | None, tasks: Collection[Task]) -> Limits | None:
    """Return the limits about the given tasks; None if there is no such limit."""
    chosen = () if limits is None else tuple(limit for limit in limits.limits if task_of(limit) in tasks)
    return struct_replace(limits, limits=chosen) if limits is not None and chosen else None


def required_scope(limit: Limit) -> RowPart | None:
    """Return the scope that must be complete for a pass of a limit, as the part of its row `judged`.

    None for a limit on completeness.
    """
    scope = SCOPE_OF[limit.limited.subject]
    if scope is None:
        return None
    return calls_part(scope, limit.limited.call, Place.TARGET if limit.section is LimitSection.TARGET else Place.HOST)


def scopes_of_tasks(score: Score) -> list[RowPart]:
    """Return the scopes that must be complete in a score without limits, each as the part of its row of `judged`."""
    scopes = [SUBJECT_OF[task].scope for task in tasks_of(score)]
    return [RowPart(scope) for scope in scopes if scope is not None]


def required_scopes(limits: Limits, score: Score) -> list[RowPart]:
    """Return the scopes that must be complete in a score with limits, each as the part of its row of `judged`."""
    found = scopes_of_tasks(score)
    found += [scope for scope in SCOPES_OF_ALL_LIMITS if score.figure(JUDGED, part=scope)]
    for limit in limits.limits:
        scope = required_scope(limit)
        if scope is None or scope in found:
            continue
        if value_of(limit, score).value is not None or lacks_calls(limit, scope, score):
            found.append(scope)
    return found


def lacks_calls(limit: Limit, scope: RowPart, score: Score) -> bool:
    """Return whether a limit is on time or memory of calls, but the score has no such call."""
    if limit.limited.subject not in (Subject.TIMING, Subject.MEMORY) or task_of(limit) not in tasks_of(score):
        return False
    return score.figure(JUDGED, part=calls_part(Scope.CALLS, scope.call, scope.place)) is None


# ---- the data set


def fault_of_data_set(score: Score) -> str | None:
    """Return why a score was not made with the data set of its rules; None if it was, or if they name no data set.

    Each input of the data set must have one of the hashes. At least one of these inputs is required.
    """
    accepted = score.active_rules.data_set_sha256
    if not accepted:
        return None
    return fault_of_inputs(accepted, {} if score.provenance is None else score.provenance.inputs)


def fault_of_inputs(accepted: Sequence[str], inputs: Mapping[str, InputFile]) -> str | None:
    """Return why inputs, by role, are not those of a data set with the `accepted` hashes; None if they are."""
    required = f"the limits require one of {', '.join(accepted)} (data_set_sha256)"
    present = [role for role in DATA_SET_ROLES if role in inputs]
    if not present:
        return f"the data set is unknown, because the score states no hash of a ground truth or of images: {required}"
    for role in present:
        file = inputs[role]
        if file.data_set_sha256 not in accepted:
            declared = "" if file.declared_sha256 is None else ", with the settings truth of its configuration,"
            found = f"the SHA-256 of {DATA_SET_ROLES[role]} ('{file.path}'){declared} is {file.data_set_sha256}"
            return f"another data set: {found}, but {required}"
    return None

"""Verdicts over the drives of a group: on findings, on missing results, and on each limit.

A limit is judged by the pooled value if its figure can be pooled, otherwise by the worst drive. A limit with a
probability and a confidence is judged by a proof over all drives.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec.structs import asdict, replace

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.judging.judge import (
    finding_verdicts,
    judged_share_verdict,
    of_incomplete,
    plain_verdict,
    proof_verdict,
    verdict_on,
)
from sfr_loc_map.metrics.judging.limited import LimitedValue, has_task, task_of, tasks_of, truth_error_of, value_of
from sfr_loc_map.metrics.judging.proof import prove, sample_of
from sfr_loc_map.metrics.judging.several_scores import items_under_test
from sfr_loc_map.metrics.score.limits import Limit, Limits, Population, Terms, meets
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.metrics.statistics.tolerance import Sample
from sfr_loc_map.suite.jobs.job import DriveOrder
from sfr_loc_map.suite.statistics.scored_job import ScoredJob

WORST_DRIVE = "worst drive"
ALL_DRIVES = "all drives"


class GroupVerdict(Verdict, frozen=True, kw_only=True):
    """The verdict on a limit over all drives of a group; `n` counts sub-trajectories or drives."""

    over: str  #: `pooled` values, the `worst drive` for figures that cannot be pooled, or `all drives` of a proof.
    missed_by: int  #: Number of drives that miss the limit; repeats and copies of a drive count once.


def verdicts_over(
    limits: Limits | None,
    results: Sequence[ScoredJob],
    pooled: tuple[Figure, ...],
    next_drive: DriveOrder | None = None,
    suite_items: int = 0,
) -> Iterator[GroupVerdict]:
    """Yield the verdicts over drives with equal settings: first those without a limit, then one for each limit.

    `next_drive` is the place of the first drive without a result. `suite_items` is the number of items under test of
    the suite if the suite does not declare all of them; otherwise 0.
    """
    yield from _verdicts_without_limit(results, suite_items)
    if limits is None:
        return
    for limit in limits.limits:
        if limit.terms is not None:
            yield proof_over_drives(limit, limit.terms, results, next_drive)
        else:
            yield verdict_over_drives(limit, limits, results, pooled)


def _verdicts_without_limit(results: Sequence[ScoredJob], suite_items: int) -> Iterator[GroupVerdict]:
    """Yield the verdicts on findings, contradictions and incomplete scores."""
    scores = [result.score for result in results]
    wrong = [(result.drive_key, item) for result in results for item in finding_verdicts(result.score)]
    for name in dict.fromkeys(item.name for _, item in wrong):
        found = [item for _, item in wrong if item.name == name]
        worst = replace(max(found, key=lambda item: item.value or 0.0), n=len(scores))
        yield _group_verdict(worst, WORST_DRIVE, len({drive_key for drive_key, item in wrong if item.name == name}))
    if contradicted := len({result.drive_key for result in results if result.score.contradiction is not None}):
        value, state = float(contradicted), VerdictState.NOT_JUDGED
        plain = plain_verdict("convention_mismatch_drives", 0.0, value, state)
        yield _group_verdict(replace(plain, n=len(scores)), WORST_DRIVE, contradicted)
    if (several := max(suite_items, items_under_test(scores))) > 1:
        plain = plain_verdict("items_under_test_max", 1.0, float(several), VerdictState.NOT_JUDGED)
        yield _group_verdict(replace(plain, n=len(scores)), ALL_DRIVES, several)
    if incomplete := [result for result in results if result.score.incomplete is not None]:
        rows = [row for result in incomplete for row in result.score.rows("judged", subject=Subject.COMPLETENESS)[:1]]
        fractions = [row.value for row in rows if row.value is not None]
        # an incomplete drive prevents a pass, whatever the figures of the other drives
        smallest = replace(judged_share_verdict(min(fractions, default=None)), n=len(scores))
        yield _group_verdict(smallest, WORST_DRIVE, len({result.drive_key for result in incomplete}))


def verdict_over_drives(
    limit: Limit, limits: Limits, results: Sequence[ScoredJob], pooled: tuple[Figure, ...]
) -> GroupVerdict:
    """Return the verdict over drives on a limit without a probability.

    A drive without a value of the figure makes the verdict incomplete. Only results of the limited task, or with calls
    of this task, count.
    """
    of_task = [result for result in results if has_task(result.score, task_of(limit))]
    figures = [value_of(limit, result.score) for result in of_task]
    if limit.condition is None:
        verdict = _verdict_on_worst_drive(limit, limits, figures)
    else:
        independent = independent_of_drives(limit, results)
        verdict = _verdict_on_pooled_value(limit, limits, figures, value_of(limit, Score(figures=pooled)), independent)
    of_drives = zip((result.drive_key for result in of_task), figures, strict=True)
    missing = {key for key, figure in of_drives if figure.value is not None and not meets(limit, figure.value)}
    return replace(verdict, missed_by=len(missing))


def _verdict_on_worst_drive(limit: Limit, limits: Limits, figures: Sequence[LimitedValue]) -> GroupVerdict:
    """Return the verdict on a limit without a condition; no minimum number of drives is required."""
    known = [figure for figure in figures if figure.value is not None]
    verdict = replace(verdict_on(limit, LimitedValue(_worst_value(limit, figures)), limits), n=len(known))
    if len(known) < len(figures):
        verdict = of_incomplete(verdict)
    return _group_verdict(verdict, WORST_DRIVE, 0)


def _verdict_on_pooled_value(
    limit: Limit, limits: Limits, figures: Sequence[LimitedValue], pooled: LimitedValue, independent: float
) -> GroupVerdict:
    """Return the verdict on a limit with a condition: by the pooled value, or by the worst drive for a quantile.

    `independent` is the number of independent values over all drives.
    """
    over = "pooled"
    value = pooled
    worst_value = _worst_value(limit, figures)
    if pooled.value is None and worst_value is not None:  # quantiles cannot be pooled
        over = WORST_DRIVE
        value = pooled._replace(value=worst_value, interval=None, row_index=None)
    truth_error = max((figure.truth_error for figure in figures), default=0.0)
    judged = value._replace(independent=independent, truth_error=truth_error)
    verdict = replace(verdict_on(limit, judged, limits), n=pooled.n or 0)
    if not all(_has_all_values(figure) for figure in figures):
        verdict = of_incomplete(verdict)
    return _group_verdict(verdict, over, 0)


def _worst_value(limit: Limit, figures: Sequence[LimitedValue]) -> float | None:
    values = [figure.value for figure in figures if figure.value is not None]
    return min(values, default=None) if limit.is_lower_bound else max(values, key=abs, default=None)


def _has_all_values(figure: LimitedValue) -> bool:
    """Return whether a figure over sub-trajectories has values, and none of them is unknown."""
    if figure.row is None:
        return figure.value is not None
    return not figure.row.unknown and bool(figure.row.n)


def independent_of_drives(limit: Limit, results: Sequence[ScoredJob]) -> float:
    """Return the number of independent values of a limited figure; the repeats of a drive count once."""
    by_drive: dict[str, float] = {}
    for result in results:
        if task_of(limit) in tasks_of(result.score):
            independent = value_of(limit, result.score).independent or 0.0
            by_drive[result.drive_key] = max(by_drive.get(result.drive_key, 0.0), independent)
    return sum(by_drive.values())


def samples_by_drive(limit: Limit, results: Sequence[ScoredJob]) -> tuple[dict[str, list[Sample]], set[str]]:
    """Return, for each drive, the errors to which a limit applies. Also return the drives for which errors are missing.

    Errors are missing if a result has no sub-trajectory, has an unknown error, or contains only a part of its errors.
    Only results of the limited task, or with calls of this task, count.
    """
    samples: dict[str, list[Sample]] = {}
    without_errors: set[str] = set()
    for result in results:
        if not has_task(result.score, task_of(limit)):
            continue
        sample = sample_of(result.score, limit.limited.figure, limit.condition)
        if sample is None or not len(sample.errors):
            without_errors.add(result.drive_key)
        else:
            samples.setdefault(result.drive_key, []).append(sample)
    return samples, without_errors


def proof_over_drives(
    limit: Limit, terms: Terms, results: Sequence[ScoredJob], next_drive: DriveOrder | None = None
) -> GroupVerdict:
    """Return the verdict over drives on a limit with a probability and a confidence.

    A sequential test uses the drives before the first drive without a result or with missing errors, so that the
    verdict does not depend on the order in which drives finish. If drives lack errors, the verdict is incomplete
    in two cases: a sequential test is undecided, or a proof without a sequential test would pass.
    """
    samples, without_errors = samples_by_drive(limit, results)
    used = samples
    is_sequential = terms.good is not None
    order = {result.drive_key: result.drive_order for result in results}
    ends = [order[drive_key] for drive_key in without_errors]
    if next_drive is not None:
        ends.append(next_drive)
    if is_sequential and ends:
        used = {drive_key: of_drive for drive_key, of_drive in samples.items() if order[drive_key] < min(ends)}
    scores = [result.score for result in results]
    truth_error = max((truth_error_of(limit, score, score.reading) for score in scores), default=0.0)
    verdict = proof_verdict(limit, prove(terms, limit.limit, used, truth_error), None, truth_error)
    requires_all = VerdictState.NOT_ENOUGH_DATA if is_sequential else VerdictState.PASS
    if without_errors and verdict.state is requires_all:
        verdict = replace(verdict, state=VerdictState.INCOMPLETE)
    exceeding = sum(
        any(not (sample.sizes <= limit.limit).all() for sample in of_drive) for of_drive in samples.values()
    )
    over = WORST_DRIVE if terms.interpretation is Population.TEMPORAL else ALL_DRIVES
    return _group_verdict(verdict, over, exceeding)


def _group_verdict(verdict: Verdict, over: str, missed_by: int) -> GroupVerdict:
    return GroupVerdict(**asdict(verdict), over=over, missed_by=missed_by)

"""Verdicts over the drives of a group: on findings, on missing results, and on each limit.

A limit is judged by the pooled value if its figure can be pooled, otherwise by the worst drive. A limit with a
probability and a confidence is judged by a proof over all drives.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from msgspec.structs import asdict, replace

from sfr_loc_map.metrics.catalogue import Subject
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.judge import (
    finding_verdicts,
    incomplete_verdict,
    of_incomplete,
    plain_verdict,
    proof_verdict,
    verdict_on,
)
from sfr_loc_map.metrics.judging.limit_scope import task_of, tasks_of
from sfr_loc_map.metrics.judging.limited_figure import LimitedFigure, figure_of, truth_error_of
from sfr_loc_map.metrics.judging.proof import prove, sample_of
from sfr_loc_map.metrics.judging.several_scores import items_under_test
from sfr_loc_map.metrics.limits import Interpretation, Limit, Limits, Terms, meets
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.metrics.tolerance import Sample
from sfr_loc_map.metrics.verdict import Verdict

WORST_DRIVE = "worst drive"
ALL_DRIVES = "all drives"


class GroupVerdict(Verdict, frozen=True, kw_only=True):
    """The verdict on a limit over all drives of a group; `n` counts sub-trajectories or drives."""

    over: str  #: `pooled` values, the `worst drive` for figures that cannot be pooled, or `all drives` of a proof.
    missed_by: int  #: Number of drives that miss the limit.


def verdicts_over(
    limits: Limits | None,
    results: Sequence[tuple[str, Score]],
    pooled: tuple[Figure, ...],
    of_suite: Collection[str] = (),
    next_drive: str | None = None,
) -> Iterator[GroupVerdict]:
    """Yield the verdicts over drives with equal settings: first those without a limit, then one for each limit.

    `of_suite` are the subjects of all results of the suite. A limit on none of them has not enough data in each group.
    `next_drive` is the first drive without a result, in the order of the hashes.
    """
    scores = [score for _, score in results]
    yield from _verdicts_without_limit(scores)
    parts_judged = {part for score in scores for part in tasks_of(score)}
    for limit in () if limits is None else limits.limits:
        if task_of(limit) not in parts_judged and task_of(limit) in of_suite:
            continue  # a limit on another subject of the suite
        if limit.terms is not None:
            yield proof_over_drives(limit, limit.terms, results, next_drive)
        else:
            yield verdict_over_drives(limit, limits or Limits(), results, pooled)


def _verdicts_without_limit(scores: Sequence[Score]) -> Iterator[GroupVerdict]:
    """Yield the verdicts on findings, contradictions and incomplete scores."""
    wrong = [item for score in scores for item in finding_verdicts(score)]
    for name in dict.fromkeys(item.name for item in wrong):
        found = [item for item in wrong if item.name == name]
        worst = replace(max(found, key=lambda item: item.value or 0.0), n=len(scores))
        yield _of_group(worst, WORST_DRIVE, len(found))
    if contradicted := sum(score.contradiction is not None for score in scores):
        value, state = float(contradicted), VerdictState.NOT_JUDGED
        plain = plain_verdict("convention_mismatch_drives", 0.0, value, state)
        yield _of_group(replace(plain, n=len(scores)), WORST_DRIVE, contradicted)
    if (several := items_under_test(scores)) > 1:
        plain = plain_verdict("items_under_test_max", 1.0, float(several), VerdictState.NOT_JUDGED)
        yield _of_group(replace(plain, n=len(scores)), ALL_DRIVES, several)
    if incomplete := [score for score in scores if score.incomplete is not None]:
        rows = [row for score in incomplete for row in score.rows("judged", subject=Subject.COMPLETENESS)[:1]]
        fractions = [row.value for row in rows if row.value is not None]
        # an incomplete drive prevents a pass, whatever the figures of the other drives
        smallest = replace(incomplete_verdict(min(fractions, default=None)), n=len(scores))
        yield _of_group(smallest, WORST_DRIVE, len(incomplete))


def verdict_over_drives(
    limit: Limit, limits: Limits, results: Sequence[tuple[str, Score]], pooled: tuple[Figure, ...]
) -> GroupVerdict:
    """Return the verdict over drives on a limit, by the pooled value if the figure can be pooled, else by the worst.

    A drive without a value of the figure makes the verdict incomplete.
    """
    scores = [score for _, score in results if task_of(limit) in tasks_of(score)]
    of_each = [figure_of(limit, score) for score in scores]
    values = [each.value for each in of_each if each.value is not None]
    worst_value = min(values, default=None) if limit.is_lower_bound else max(values, key=abs, default=None)
    if limit.condition is None:
        over, count = WORST_DRIVE, len(values)
        figure = LimitedFigure(worst_value)  # no minimum number of drives is required
    else:
        of_all = figure_of(limit, Score(figures=pooled))
        over, count = "pooled", of_all.n or 0
        if of_all.value is None and worst_value is not None:  # quantiles cannot be pooled
            over = WORST_DRIVE
            of_all = of_all._replace(value=worst_value, interval=None, place=None)
        figure = of_all._replace(
            independent=independent_of_drives(limit, results),
            truth_error=max((each.truth_error for each in of_each), default=0.0),
        )
    verdict = replace(verdict_on(limit, figure, limits), n=count)
    if not all(_count_of(limit, score) for score in scores):
        verdict = of_incomplete(verdict)
    return _of_group(verdict, over, sum(not meets(limit, value) for value in values))


def independent_of_drives(limit: Limit, results: Sequence[tuple[str, Score]]) -> float:
    """Return the number of independent values of a limited figure; the repeats of a drive count once."""
    of_drives: dict[str, float] = {}
    for drive, score in results:
        if task_of(limit) in tasks_of(score):
            of_drives[drive] = max(of_drives.get(drive, 0.0), figure_of(limit, score).independent or 0.0)
    return sum(of_drives.values())


def samples_by_drive(limit: Limit, results: Sequence[tuple[str, Score]]) -> dict[str, list[Sample]]:
    """Return the errors to which a limit applies, for each run by drive."""
    samples: dict[str, list[Sample]] = {}
    for drive, score in results:
        sample = sample_of(score, limit.limited.figure, limit.condition)
        if sample is not None:
            samples.setdefault(drive, []).append(sample)
    return samples


def proof_over_drives(
    limit: Limit, terms: Terms, results: Sequence[tuple[str, Score]], next_drive: str | None = None
) -> GroupVerdict:
    """Return the verdict over drives on a limit with a probability and a confidence.

    A sequential test uses the drives before the first drive without a result, so that the verdict does not depend on
    the order in which drives finish.
    """
    samples = samples_by_drive(limit, results)
    is_sequential = terms.good is not None and next_drive is not None
    taken = {drive: runs for drive, runs in samples.items() if not is_sequential or drive < (next_drive or "")}
    truth_error = max((truth_error_of(limit, score, score.reading) for _, score in results), default=0.0)
    verdict = proof_verdict(limit, prove(terms, limit.limit, taken), None, truth_error)
    exceeding = sum(any(not (run.sizes <= limit.limit).all() for run in runs) for runs in samples.values())
    over = WORST_DRIVE if terms.interpretation is Interpretation.TEMPORAL else ALL_DRIVES
    return _of_group(verdict, over, exceeding)


def _count_of(limit: Limit, score: Score) -> float:
    """Return the number of values of a drive's limited figure; 0 if the figure is unknown."""
    found = figure_of(limit, score)
    if limit.condition is not None and found.row is not None:
        return 0.0 if found.row.unknown else float(found.row.n or 0)
    return 0.0 if found.value is None else 1.0


def _of_group(verdict: Verdict, over: str, missed_by: int) -> GroupVerdict:
    return GroupVerdict(**asdict(verdict), over=over, missed_by=missed_by)

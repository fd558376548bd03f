"""The groups of a suite's results, with pooled errors and verdicts, and whether sequential tests have decided them.

The results with the same task, configuration and faults form a group.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from msgspec import Struct, field

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.judging.limited import limits_about, tasks_of
from sfr_loc_map.metrics.judging.proof import SEQUENTIAL
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.suite.jobs.job import GroupKey, Job, JobTask
from sfr_loc_map.suite.statistics.group_verdicts import GroupVerdict, verdicts_over
from sfr_loc_map.suite.statistics.pooling import pool
from sfr_loc_map.suite.statistics.scored_job import ScoredJob, undeclared_items_in
from sfr_loc_map.suite_names import Task


class Group(Struct, frozen=True, kw_only=True):
    """The results with the same task, configuration and alteration of the source: counts, pooled errors, verdicts."""

    task: str
    configuration: str
    alteration: str = field(name="faults")  #: Change of the source (`GroupKey`).
    results: int  #: Number of results, each repeat counted.
    lost: int  #: Number of lost frames of all results.
    matched: int  #: Number of frames of all results that have an estimate and a true pose.
    figures: tuple[Figure, ...]  #: Errors over the sub-trajectories of all drives, by condition.
    verdicts: tuple[GroupVerdict, ...]

    @property
    def key(self) -> GroupKey:
        """What the jobs of the group have in common."""
        return GroupKey(self.task, self.configuration, self.alteration)


def groups_of(results: Sequence[ScoredJob], limits: Limits | None, unfinished: Sequence[Job] = ()) -> Iterator[Group]:
    """Yield the groups of results in the order of their first occurrence.

    Within a group, results are sorted by the order of their drives and by the hashes of their jobs, so that figures and
    verdicts do not depend on the order of the suite's file. `unfinished` are the jobs without a result. A limit applies
    to the groups that have its task, or to all groups if no group has its task.
    """
    suite_tasks = {task for result in results for task in tasks_of(result.score)}
    several = len(undeclared_items_in(results))
    for key, in_group in by_group(results).items():
        next_drive = min((job.drive_order for job in unfinished if job.group == key), default=None)
        scores = [result.score for result in in_group]
        trajectories = [score.association for score in scores if score.association is not None]
        conditions = list(dict.fromkeys(condition for score in scores for condition in score.conditions))
        tasks_elsewhere = suite_tasks.difference(*map(tasks_of, scores))
        group_limits = limits_about(limits, set(Task) - tasks_elsewhere)
        suite_items = several if key.task == JobTask.SCORE else 0
        pooled = tuple(row for condition in conditions for row in pool(in_group, condition))
        yield Group(
            task=key.task,
            configuration=key.configuration,
            alteration=key.alteration,
            results=len(scores),
            lost=sum(item.lost or 0 for item in trajectories),
            matched=sum(item.matched for item in trajectories),
            figures=pooled,
            verdicts=tuple(verdicts_over(group_limits, in_group, pooled, next_drive, suite_items)),
        )


def by_group(results: Sequence[ScoredJob]) -> dict[GroupKey, list[ScoredJob]]:
    """Return the results of each group by its key: groups in the order of their first occurrence, results in order."""
    members: dict[GroupKey, list[ScoredJob]] = {}
    for result in results:
        members.setdefault(result.job.group, []).append(result)
    for of_group in members.values():
        of_group.sort(key=lambda item: (item.drive_order, item.job.key))
    return members


def are_decided(groups: Collection[Group], jobs: Sequence[Job]) -> bool:
    """Return whether sequential tests have decided all limits of the planned jobs, so that no more drives are required.

    A planned group without a result is undecided.
    """
    has_all_groups = {group.key for group in groups}.issuperset(job.group for job in jobs)
    items = [item for group in groups for item in group.verdicts]
    return bool(has_all_groups and items) and all(
        item.proof is not None
        and item.proof.method == SEQUENTIAL
        and item.state in (VerdictState.PASS, VerdictState.FAIL)
        for item in items
    )

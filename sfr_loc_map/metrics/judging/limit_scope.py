"""The task that a limit is about, and the scope that must be complete for a pass of the limit (`figures.subjects`)."""

from __future__ import annotations

from collections.abc import Collection

from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.figures.catalogue import JUDGED
from sfr_loc_map.metrics.figures.row_part import Place, RowPart, calls_part
from sfr_loc_map.metrics.figures.subjects import SCOPE_OF, SUBJECT_OF, LimitSection, Scope, Subject
from sfr_loc_map.metrics.judging.limited_value import value_of
from sfr_loc_map.metrics.score.limits import OF_MAP, Limit, Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite_names import Task


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
    """Return whether a score is about a task, or has calls of it, whose results are then missing."""
    calls = [row.part.call for row in score.rows(JUDGED) if row.part is not None and row.part.call is not None]
    return task in tasks_of(score) or any(call.task is task for call in calls)


def limits_about(limits: Limits | None, tasks: Collection[Task]) -> Limits | None:
    """Return the limits about the given tasks; None if there is no such limit."""
    chosen = () if limits is None else tuple(limit for limit in limits.limits if task_of(limit) in tasks)
    return struct_replace(limits, limits=chosen) if limits is not None and chosen else None


def required_scope(limit: Limit) -> RowPart | None:
    """Return the scope that must be complete for a pass, the part of its row of `judged`; None for completeness."""
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
    found += [RowPart(Scope.LIVE)] if score.figure(JUDGED, part=Scope.LIVE) else []
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

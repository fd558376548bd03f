"""The scope that each limit requires to be complete, and the tasks that limits and scores are about."""

from __future__ import annotations

from collections.abc import Collection

from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import JUDGED, Subject
from sfr_loc_map.metrics.figures.row_part import Place, RowPart, Scope, calls_part
from sfr_loc_map.metrics.judging.limited_value import value_of
from sfr_loc_map.metrics.score.limits import OF_MAP, Limit, Limits, LimitSection
from sfr_loc_map.metrics.score.score import Score


def task_of(limit: Limit) -> Scope:
    """Return the task that a limit is about: `drive` (localisation) or `map`."""
    limited = limit.limited
    if limited.call is not None:
        return Scope.DRIVE if limited.call is CallKind.LOCALISATION else Scope.MAP
    return Scope.MAP if limited.subject is Subject.MAP or limited.figure in OF_MAP else Scope.DRIVE


def tasks_of(score: Score) -> list[Scope]:
    """Return the tasks that a score is about: `drive`, `map`, or both."""
    found = []
    for scope, subject in ((Scope.DRIVE, Subject.TRAJECTORY), (Scope.MAP, Subject.MAP)):
        if score.has(subject) or score.figure(JUDGED, part=scope) is not None:
            found.append(scope)
    return found


def limits_about(limits: Limits | None, tasks: Collection[str]) -> Limits | None:
    """Return the limits about the given tasks (`drive`, `map`); None if there is no such limit."""
    chosen = () if limits is None else tuple(limit for limit in limits.limits if task_of(limit) in tasks)
    return struct_replace(limits, limits=chosen) if limits is not None and chosen else None


def needed_part(limit: Limit) -> RowPart | None:
    """Return the scope that must be complete for a pass, as in a row `judged`; None for limits on completeness."""
    if limit.section is LimitSection.TRAJECTORY:
        return RowPart(Scope.DRIVE)
    if limit.section is LimitSection.MAP:
        return RowPart(Scope.MAP)
    if limit.section is LimitSection.COMPLETENESS:
        return None
    limited = limit.limited
    measured = Scope.CALLS if limited.subject is Subject.TIMING else Scope.MEMORY
    place = Place.TARGET if limit.section is LimitSection.TARGET else Place.HOST
    return calls_part(measured, limited.call, place)


def judged_parts(limits: Limits, score: Score) -> list[RowPart]:
    """Return the scopes of a score that limits judge, as in the rows `judged`."""
    found = [RowPart(task) for task in tasks_of(score)]
    found += [RowPart(Scope.LIVE)] if score.figure(JUDGED, part=Scope.LIVE) else []
    for limit in limits.limits:
        part = needed_part(limit)
        if part is None or part in found:
            continue
        if value_of(limit, score).value is not None or lacks_calls(limit, part, score):
            found.append(part)
    return found


def lacks_calls(limit: Limit, part: RowPart, score: Score) -> bool:
    """Return whether a limit is on time or memory of calls, but the score has no such call."""
    is_on_calls = limit.section in (LimitSection.TIMING, LimitSection.MEMORY, LimitSection.TARGET)
    if not is_on_calls or task_of(limit) not in tasks_of(score):
        return False
    return score.figure(JUDGED, part=calls_part(Scope.CALLS, part.call, part.place)) is None

"""The rules of a score: its limits, what they are about, and which part of the score they need."""

from __future__ import annotations

from collections.abc import Collection

from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.catalogue import CALLS, DRIVE, LIVE, MAP, MEMORY, Subject
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.judging.limited_figure import figure_of
from sfr_loc_map.metrics.limits import OF_MAP, Limit, Limits, LimitSection, Rules
from sfr_loc_map.metrics.row_part import Place, RowPart
from sfr_loc_map.metrics.score import Score


def limits_of(score: Score) -> Rules | None:
    """Return the limits that a score was judged by, None without limits."""
    return score.rules if score.rules is not None and score.rules.limits else None


def task_of(limit: Limit) -> str:
    """Return whether a limit is about a drive or a map."""
    limited = limit.limited
    if limited.call is not None:
        return DRIVE if limited.call is CallKind.LOCALISATION else MAP
    return MAP if limited.subject is Subject.MAP or limited.figure in OF_MAP else DRIVE


def tasks_of(score: Score) -> list[str]:
    """Return whether a score is about a drive, a map, or both."""
    found = []
    for part, subject in ((DRIVE, Subject.TRAJECTORY), (MAP, Subject.MAP)):
        if score.has(subject) or score.figure("judged", part=part) is not None:
            found.append(part)
    return found


def limits_about(limits: Limits | None, parts: Collection[str]) -> Limits | None:
    """Return the limits that are about a drive or a map; None if there is no such limit."""
    chosen = () if limits is None else tuple(limit for limit in limits.limits if task_of(limit) in parts)
    return struct_replace(limits, limits=chosen) if limits is not None and chosen else None


def needed_part(limit: Limit) -> RowPart | None:
    """Return the part whose completeness a limit needs; None for limits on completeness itself."""
    if limit.section is LimitSection.TRAJECTORY:
        return RowPart(DRIVE)
    if limit.section is LimitSection.MAP:
        return RowPart(MAP)
    if limit.section is LimitSection.COMPLETENESS:
        return None
    limited = limit.limited
    measured = CALLS if limited.subject is Subject.TIMING else MEMORY
    place = Place.TARGET if limit.section is LimitSection.TARGET else Place.HOST
    return RowPart(measured, limited.call, place)


def judged_parts(limits: Limits, score: Score) -> list[RowPart]:
    """Return the parts of a score that limits judge, as the rows `judged` name them."""
    found = [RowPart(task) for task in tasks_of(score)]
    found += [RowPart(LIVE)] if score.figure("judged", part=LIVE) else []
    for limit in limits.limits:
        part = needed_part(limit)
        if part is None or part in found:
            continue
        if figure_of(limit, score).value is not None or lacks_calls(limit, part, score):
            found.append(part)
    return found


def lacks_calls(limit: Limit, part: RowPart, score: Score) -> bool:
    """Return whether a limit is on time or memory of calls that are required and of which none is known."""
    is_on_calls = limit.section in (LimitSection.TIMING, LimitSection.MEMORY, LimitSection.TARGET)
    if not is_on_calls or task_of(limit) not in tasks_of(score):
        return False
    return score.figure("judged", part=part._replace(what=CALLS)) is None

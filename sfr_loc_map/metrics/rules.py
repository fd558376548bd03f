"""The rules of a score: its limits, what they are about, and which part of the score they need."""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import replace
from typing import Any

import msgspec
from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.catalogue import Subject
from sfr_loc_map.metrics.completeness import CALLS, DRIVE, LIVE, MAP, MEMORY
from sfr_loc_map.metrics.config import CallKind, Condition
from sfr_loc_map.metrics.limited import figure_of
from sfr_loc_map.metrics.limits import OF_MAP, Limit, LimitPart, Limits
from sfr_loc_map.metrics.proof import Interpretation, Terms
from sfr_loc_map.metrics.score import LimitRecord, Rules, Score
from sfr_loc_map.metrics.tolerance import CONFIDENCE


def rules_of(limits: Limits | None, *, partial: bool) -> Rules | None:
    """Return limits as a score keeps them; None where there is no limit and no part was asked for."""
    if limits is None and not partial:
        return None
    records = () if limits is None else tuple(_record_of(limit) for limit in limits.limits)
    rules = Rules(limits=records, partial=partial)
    if limits is not None:
        least = {"minimum_count": limits.minimum_count, "minimum_independent": limits.minimum_independent}
        rules = struct_replace(rules, **least)
    return struct_replace(rules, sha256=hash_of(rules))


def hash_of(rules: Rules) -> str:
    """Return the hash of rules."""
    return hashlib.sha256(msgspec.json.encode(struct_replace(rules, sha256=""))).hexdigest()


def limits_of(score: Score) -> Limits | None:
    """Return the limits that a score was judged by, None without limits."""
    rules = score.rules
    if rules is None or not rules.limits:
        return None
    limits = []
    for item in rules.limits:
        condition = None if item.condition is None else Condition.parse(item.condition)
        terms = None
        if item.prob is not None and item.confidence is not None:
            interpretation = Interpretation(item.interpretation or Interpretation.TEMPORAL)
            power = CONFIDENCE if item.power is None else item.power
            terms = Terms(item.prob, item.confidence, interpretation, bool(item.normal), power, item.good)
        limits.append(
            Limit(
                part=LimitPart(item.part),
                key=item.name,
                limit=item.limit,
                condition=condition,
                id=item.id,
                text=item.text,
                certain=item.certain,
                terms=terms,
            )
        )
    return Limits(tuple(limits), rules.minimum_count, rules.minimum_independent)


def _record_of(limit: Limit) -> LimitRecord:
    given = {} if limit.terms is None else limit.terms._asdict()
    # a whole number of a limits file is hashed as the float that it is read back as
    terms: dict[str, Any] = {name: float(value) if type(value) is int else value for name, value in given.items()}
    return LimitRecord(
        **terms,
        part=limit.part.value,
        name=limit.key,
        limit=float(limit.limit),
        condition=None if limit.condition is None else limit.condition.setting,
        id=limit.id,
        text=limit.text,
        certain=limit.certain,
    )


def about(limit: Limit) -> str:
    """Return whether a limit is about a drive or a map."""
    limited = limit.limited
    names = (limited.figure, limited.part or "") if limited.subject is Subject.MEMORY else (limited.figure,)
    if limited.subject in (Subject.TIMING, Subject.MEMORY):
        return DRIVE if any(CallKind.LOCALISATION in name for name in names) else MAP
    return MAP if limited.subject is Subject.MAP or limited.figure in OF_MAP else DRIVE


def what_of(score: Score) -> list[str]:
    """Return whether a score is about a drive, a map, or both."""
    found = []
    for part, subject in ((DRIVE, Subject.TRAJECTORY), (MAP, Subject.MAP)):
        if score.has(subject) or score.figure("judged", part=part) is not None:
            found.append(part)
    return found


def limits_about(limits: Limits | None, parts: Collection[str]) -> Limits | None:
    """Return the limits that are about a drive or a map; None if there is no such limit."""
    chosen = () if limits is None else tuple(limit for limit in limits.limits if about(limit) in parts)
    return replace(limits, limits=chosen) if limits is not None and chosen else None


def part_of(limit: Limit) -> str | None:
    """Return the part whose completeness a limit needs; None for limits on completeness itself."""
    if limit.part is LimitPart.TRAJECTORY:
        return DRIVE
    if limit.part is LimitPart.MAP:
        return MAP
    if limit.part is LimitPart.COMPLETENESS:
        return None
    limited = limit.limited
    place = "target " if limit.part is LimitPart.TARGET else ""
    if limited.subject is Subject.TIMING:
        return f"{place}{CALLS} {limited.figure}"
    return f"{place}{MEMORY} {(limited.part or '').removeprefix('target ')}"


def parts_of(limits: Limits, score: Score) -> list[str]:
    """Return the parts of a score that limits judge, as the rows `judged` name them."""
    found = [DRIVE] if score.has(Subject.TRAJECTORY) or score.figure("judged", part=DRIVE) else []
    found += [MAP] if score.has(Subject.MAP) or score.figure("judged", part=MAP) else []
    found += [LIVE] if score.figure("judged", part=LIVE) else []
    for limit in limits.limits:
        if (part := part_of(limit)) not in found and part is not None and figure_of(limit, score).value is not None:
            found.append(part)
    return found

"""What to look at first in a report: what is wrong, else what is nearest to being wrong, each with the reason."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.score import Score, Verdict
from sfr_loc_map.report.score_tables import limit_name, limit_unit
from sfr_loc_map.report.sub_trajectories import Part, error_sizes, parts_of
from sfr_loc_map.tables.numbers import METRE, PERCENT, SHARE, fitting, number

MOST = 5
"""More than this is not first."""


@dataclass(frozen=True, slots=True)
class LookFirst:
    """One thing to look at.

    Attributes:
        what: What it is, in a phrase.
        why: Why it matters, in a sentence.
        place: Anchor of the table or figure that shows it.
    """

    what: str
    why: str
    place: str


def look_first(score: Score) -> tuple[LookFirst, ...]:
    """Return what to look at, the worst first; without a finding, what would go wrong first."""
    everything = (
        *_contradiction(score),
        *_findings(score),
        *_missed(score),
        *_lost(score),
        *_undecided(score),
        *_inconsistent(score),
        *_nearest_to_limit(score),
        *_worst_part(score),
    )
    return tuple(islice(everything, MOST))


def _findings(score: Score) -> Iterator[LookFirst]:
    for item in score.findings:
        yield LookFirst(str(item.kind), f"The method under test did something wrong: {item}.", "table-method")


def _contradiction(score: Score) -> Iterator[LookFirst]:
    if score.contradiction is not None:
        why = f"Estimate and truth contradict each other, so that no figure of them judges: {score.contradiction}"
        yield LookFirst("the convention of the poses", why, "table-headline")


def _lost(score: Score) -> Iterator[LookFirst]:
    part = score.trajectory
    if part is None:
        return
    for count, word in ((part.lost, "lost"), (part.degraded, "degraded")):
        if count:
            share = number(100.0 * count / max(part.matched, 1))
            why = f"{count} of {part.matched} frames ({share} %) are {word}, and count in every figure like the others."
            place = "localisation-timeline" if _has_calls(score) else "accumulated"
            yield LookFirst(f"{word} frames", why, f"figure-{place}")


def _has_calls(score: Score) -> bool:
    calls = None if score.details is None else score.details.calls
    return calls is not None and calls.localisation is not None


def _missed(score: Score) -> Iterator[LookFirst]:
    for item in sorted(score.failed, key=_use_of_limit, reverse=True):
        yield LookFirst(_name(item), f"It misses its limit: {_beside_limit(item)}.{_doubt(item)}", _place_of(item))


def _nearest_to_limit(score: Score) -> Iterator[LookFirst]:
    met = [item for item in score.verdicts if item.state is VerdictState.PASS]
    if met:
        item = max(met, key=_use_of_limit)
        why = f"Of the limits that are met it is the nearest to being missed: {_beside_limit(item)}.{_doubt(item)}"
        yield LookFirst(_name(item), why, _place_of(item))


def _undecided(score: Score) -> Iterator[LookFirst]:
    for item in score.verdicts:
        if item.state is VerdictState.NOT_ENOUGH_DATA:
            count = "" if item.count is None else f" ({item.count} values)"
            yield LookFirst(_name(item), f"There is not enough data to judge it by its limit{count}.", _place_of(item))


def _inconsistent(score: Score) -> Iterator[LookFirst]:
    conditions = () if score.trajectory is None else score.trajectory.conditions
    for part in conditions:
        pose = None if part.nees is None else part.nees.pose
        if pose is None or pose.mean is None or pose.interval95 is None:
            continue
        if pose.mean > pose.interval95[1]:
            times = number(pose.mean / pose.expected)
            why = f"Over {part.condition} the squared error is {times} times what the covariance of the odometry says."
            yield LookFirst("the covariance is too small", why, "table-consistency")


def _worst_part(score: Score) -> Iterator[LookFirst]:
    for part in parts_of(score)[:1]:
        sizes = error_sizes(part.rows)
        worst = max(range(len(sizes)), key=sizes.__getitem__)
        yield LookFirst("the worst sub-trajectory", _worst_text(part, worst, sizes[worst]), "figure-position")


def _worst_text(part: Part, worst: int, size: float) -> str:
    unit = fitting(METRE, size)
    frames = f"frames {part.rows.start_frame[worst]} to {part.rows.end_frame[worst]}"
    largest = f"{number(size, unit=unit)} {unit.symbol}"
    return f"Over {part.score.condition} the largest position error is {largest}, at {frames}."


def _use_of_limit(item: Verdict) -> float:
    """Return which part of its limit a figure takes up; above 1 it misses it."""
    value = abs(item.value or 0.0)
    if item.metric.endswith("_min"):
        return item.limit / value if value else float("inf")
    return value / item.limit if item.limit else float("inf") if value else 0.0


def _name(item: Verdict) -> str:
    over = f" over {item.condition}" if item.condition is not None else ""
    return limit_name(item.metric) + over


def _beside_limit(item: Verdict) -> str:
    unit = limit_unit(item.metric)
    unit = PERCENT if unit is SHARE else fitting(unit, item.limit, item.value)
    use = _use_of_limit(item)
    share = f", {number(100.0 * use)} % of it" if use < float("inf") and not item.metric.endswith("_min") else ""
    value, limit = (number(figure, unit=unit) for figure in (item.value, item.limit))
    return f"{value} {unit.symbol} against {limit} {unit.symbol}{share}"


def _doubt(item: Verdict) -> str:
    return " Its 95 % interval spans the limit: more data may change the verdict." if item.certain is False else ""


def _place_of(item: Verdict) -> str:
    """Return the anchor of what shows a limited figure best."""
    metric = item.metric
    if metric.startswith(("target ", "fusion")):
        return "table-verdicts"
    if metric.endswith("_bytes"):
        return "table-memory"
    if metric.endswith("_s"):
        return f"figure-{metric.partition('_')[0]}-histogram"
    if metric.startswith(("point_error", "coverage")):
        return "table-map"
    return "figure-position" if metric.startswith("position") else "figure-angles"

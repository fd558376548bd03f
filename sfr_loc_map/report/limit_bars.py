"""Every limit as a bar: how much of it the judged value uses, its interval, the margin that is left."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfr_loc_map.metrics.config import VerdictState, label_of
from sfr_loc_map.metrics.score import Score, Verdict
from sfr_loc_map.report.score_tables import name_of, sign_of, unit_of
from sfr_loc_map.report.tables import NOT_ENOUGH, OPEN, VERDICTS, Cell, number

MOST_SHOWN = 10.0  #: Largest fraction of a limit that is shown.


@dataclass(frozen=True, slots=True)
class LimitBar:
    """One limit with its verdict, in words and as shares of the limit: at 1 it is met, beyond it is missed."""

    place: int  #: Of the verdict in the score.
    metric: str
    name: str  #: In words, with the condition.
    over: str  #: Condition of the sub-trajectories, empty outside the trajectory.
    state: str
    style: str
    icon: str
    value: str
    limit: str
    margin: str
    interval: str
    bound: float  #: The limit in the unit of its name.
    share: float | None
    low: float | None
    high: float | None
    text: str  #: All of it in one phrase.


def share_of(item: Verdict, value: float | None) -> float | None:
    """Return how much of a limit a value uses; of a lower bound the limit over the value."""
    if value is None:
        return None
    use, limit = (item.limit, abs(value)) if item.is_lower_bound else (abs(value), item.limit)
    return min(use / limit if limit else MOST_SHOWN if use else 0.0, MOST_SHOWN)


def limit_bars(score: Score) -> list[LimitBar]:
    """Return all limits of a score: those that are missed first, then those with the smallest share left."""
    bars = [_bar(place, item) for place, item in enumerate(score.verdicts)]
    return sorted(bars, key=lambda bar: (bar.state != VerdictState.FAIL, -1.0 * (bar.share or -1.0), bar.place))


def _bar(place: int, item: Verdict) -> LimitBar:
    unit = unit_of(item)
    known = item.value is not None and math.isfinite(item.value)
    value = f"{number(item.value, unit=unit)} {unit.symbol}" if known else NOT_ENOUGH
    limit = f"{sign_of(item)} {number(item.limit, unit=unit)} {unit.symbol}"
    margin = "" if item.margin is None else f"{number(item.margin, unit=unit, signed=True)} {unit.symbol}"
    over = label_of(item.condition)
    ends = sorted(share for bound in item.interval or () if (share := share_of(item, bound)) is not None)
    style, name = VERDICTS.get(item.state, OPEN), name_of(item)
    return LimitBar(
        place=place,
        metric=item.name,
        name=name,
        over=over,
        state=item.state.value,
        style=style.css,
        icon=style.icon,
        value=value,
        limit=limit,
        margin=margin,
        interval=Cell.interval(item.interval, unit=unit).text if item.interval else "",
        bound=item.limit,
        share=share_of(item, item.value if known else None),
        low=ends[0] if len(ends) == 2 else None,
        high=ends[1] if len(ends) == 2 else None,
        text=f"{name}: {value}, limit {limit}" + (f", margin {margin}" if margin else ""),
    )

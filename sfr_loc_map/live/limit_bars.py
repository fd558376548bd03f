"""Every limit as a bar of the live page: fraction of the limit that the judged value uses, interval and margin.

A bar is a view of a verdict (`VerdictView`) as plain values, which the server sends as JSON.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.verdict_view import VerdictView, share_of_limit, verdict_views

MOST_DRAWN = 10.0  #: Largest drawn fraction of a limit. JSON has no infinite numbers.


@dataclass(frozen=True, slots=True)
class LimitBar:
    """One limit with its verdict, in words and as fractions of the limit. A fraction above 1 misses the limit."""

    place: int  #: Index of the verdict in the score.
    metric: str  #: Name of the limit in the limits file.
    subject: str | None  #: Subject of the limited figure.
    figure: str | None  #: Limited figure.
    statistic: str | None  #: Statistic of the figure.
    condition: str | None  #: Condition of the sub-trajectories, as in the score.
    is_of_target: bool  #: Whether the limit is on calls on a target.
    name: str  #: Name in words, with the condition.
    over: str  #: Condition of the sub-trajectories; empty if there is none.
    state: str
    style: str
    icon: str
    value: str
    limit: str
    margin: str
    interval: str
    bound: float  #: The limit, in the unit that its name states.
    share: float | None  #: Drawn fraction of the limit. This fraction, `low` and `high` are at most `MOST_DRAWN`.
    low: float | None
    high: float | None
    text: str  #: The whole comparison in one phrase.


def limit_bars(score: Score) -> list[LimitBar]:
    """Return all limits of a score: missed limits first, then the others by decreasing fraction of the limit."""
    views = sorted(enumerate(verdict_views(score)), key=_order)
    return [_bar(place, view) for place, view in views]


def _order(placed: tuple[int, VerdictView]) -> tuple[bool, float, int]:
    """Return the sort key of a limit: missed limits first, then by decreasing fraction of the limit.

    Within both groups an unknown fraction is last.
    """
    place, view = placed
    unused = math.inf if view.use is None else -view.use
    return view.item.state is not VerdictState.FAIL, unused, place


def _bar(place: int, view: VerdictView) -> LimitBar:
    item = view.item
    ends = sorted(_drawn(share_of_limit(item, bound)) for bound in item.interval or ())
    margin = f", margin {view.margin_text}" if view.margin_text else ""
    return LimitBar(
        place=place,
        metric=item.name,
        subject=None if item.subject is None else item.subject.value,
        figure=item.figure,
        statistic=item.statistic,
        condition=item.condition,
        is_of_target=item.is_of_target,
        name=view.name,
        over=label_of(item.condition),
        state=item.state.value,
        style=view.style.css,
        icon=view.style.icon,
        value=view.value_text,
        limit=view.limit_text,
        margin=view.margin_text,
        interval=view.interval.text if item.interval else "",
        bound=item.limit,
        share=None if view.use is None else _drawn(view.use),
        low=ends[0] if ends else None,
        high=ends[1] if ends else None,
        text=f"{view.name}: {view.comparison}{margin}",
    )


def _drawn(share: float) -> float:
    return min(share, MOST_DRAWN)

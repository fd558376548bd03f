"""The verdict on each limit."""

from __future__ import annotations

from sfr_loc_map.metrics.modes import VerdictState
from sfr_loc_map.metrics.score import MemoryScore, Score, TimingScore, Verdict
from sfr_loc_map.metrics.verdicts.limited_figures import (
    COVERAGE_MIN,
    MAP_FIGURES,
    MEMORY_FIGURES,
    TIMING_FIGURES,
    TRAJECTORY_FIGURES,
    Figure,
    LimitPart,
)
from sfr_loc_map.metrics.verdicts.limits import Limit, Limits


def verdicts(limits: Limits, score: Score) -> tuple[Verdict, ...]:
    """Return the verdict on each limit: pass, fail, or not enough data.

    A figure passes at its limit; a mean of a signed figure (heading) is taken without its sign. `certain` tells
    whether the 95 % interval lies on one side of the limit, None where there is no interval.
    """
    return tuple(_verdict(limit, limits.minimum_count, figure_of(limit, score)) for limit in limits.limits)


def figure_of(limit: Limit, score: Score) -> Figure:
    """Return the figure that a limit is on."""
    if limit.part is LimitPart.TRAJECTORY:
        assert limit.condition is not None
        part = None if score.trajectory is None else score.trajectory.of(limit.condition)
        return Figure() if part is None else TRAJECTORY_FIGURES[limit.key](part)
    if limit.part is LimitPart.MAP:
        return Figure() if score.map is None else MAP_FIGURES[limit.key](score.map)
    timing, memory = score.timing, score.memory
    if limit.part is LimitPart.TARGET:
        timing, memory = (None, None) if score.target is None else (score.target.timing, score.target.memory)
    if limit.key in TIMING_FIGURES:
        return TIMING_FIGURES[limit.key](timing or TimingScore())
    return MEMORY_FIGURES[limit.key](memory or MemoryScore())


def _verdict(limit: Limit, minimum: int, figure: Figure) -> Verdict:
    value, count, interval = figure.value, figure.count, figure.interval
    lower_bound, certain = limit.key == COVERAGE_MIN, None
    if value is None or (count is not None and count < minimum):
        state = VerdictState.NOT_ENOUGH_DATA
    else:
        met = value >= limit.limit if lower_bound else abs(value) <= limit.limit
        state = VerdictState.PASS if met else VerdictState.FAIL
        certain = None if interval is None else not interval[0] <= limit.limit < interval[1]
    return Verdict(
        metric=f"target {limit.key}" if limit.part is LimitPart.TARGET else limit.key,
        limit=limit.limit,
        value=value,
        ci95=interval,
        condition=limit.condition,
        count=count,
        state=state,
        certain=certain,
    )

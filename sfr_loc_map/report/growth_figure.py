"""The figure of the position error against the length of the sub-trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from sfr_loc_map.metrics.config import ConditionKind
from sfr_loc_map.metrics.score import ConditionScore, Score
from sfr_loc_map.report.plots import Plot, Trace, axis, error_scale, largest, line, log_axis, marks, scaled


class _Bounded(NamedTuple):
    """Mean + 3 sigma of one distance with its interval; metres."""

    distance: float
    value: float
    low: float
    high: float


def growth_figure(score: Score, parts: Sequence[ConditionScore]) -> list[Plot]:
    """Return the figure, with intervals where they are known; nothing for fewer than two lengths."""
    by_distance = score.trajectory.by_distance if score.trajectory is not None else ()
    steps = [item for item in by_distance if item.position_m.sigma is not None]
    if len(steps) < 2:
        return []
    over = [item.distance_m for item in steps]
    mean = [item.position_m.mean for item in steps]
    total = [item.position_m.mean_plus_3sigma for item in steps]
    factor, unit = error_scale(largest(total))
    filled = {"fill": "tonexty", "fillcolor": "@one-soft"}
    data = [
        line("norm of the mean", (over, scaled(mean, factor)), "@one", dash="dash", mode="lines+markers"),
        line("mean + 3 sigma", (over, scaled(total, factor)), "@one", mode="lines+markers", **filled),
        *_intervals(parts, factor),
    ]
    layout = {
        "xaxis": log_axis("length of the sub-trajectory, m", over[0], over[-1]),
        "yaxis": axis(f"position error, {unit}", rangemode="tozero"),
    }
    caption = "Error re-based at each start, over sub-trajectories of growing length."
    return [Plot("growth", "Position error against path length", caption, data, layout, width="full")]


def _intervals(parts: Sequence[ConditionScore], factor: float) -> list[Trace]:
    known = [item for part in parts if (item := _bounded(part)) is not None]
    if not known:
        return []
    above = scaled([item.high - item.value for item in known], factor)
    below = scaled([item.value - item.low for item in known], factor)
    bars = {"type": "data", "symmetric": False, "array": above, "arrayminus": below}
    places = [item.distance for item in known], scaled([item.value for item in known], factor)
    return [marks("95 % interval of it", places, "@two", symbol="diamond", size=9, error_y=bars)]


def _bounded(part: ConditionScore) -> _Bounded | None:
    value, bounds = part.position_m.mean_plus_3sigma, part.position_m.mean_plus_3sigma_ci95
    if part.condition.kind is not ConditionKind.DISTANCE or value is None or bounds is None:
        return None
    return _Bounded(part.condition.value, value, *bounds)

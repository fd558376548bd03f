"""Why a score leaves something that was asked for without a judgement."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.condition import Condition, ConditionKind
from sfr_loc_map.metrics.modes import VerdictState
from sfr_loc_map.metrics.score import Score, TrajectoryScore, Verdict


class _Extent(NamedTuple):
    """How long a drive is."""

    frames: int
    path_length_m: float
    duration_s: float


def reasons_not_judged(score: Score, asked: Collection[Condition] = ()) -> tuple[str, ...]:
    """Return why something could not be judged, one phrase for each reason; empty if all was judged.

    Args:
        score: The score.
        asked: Conditions that the user named, in options or limits; those of the default settings count only where
            the user named none.
    """
    if score.contradiction is not None:
        return (score.contradiction,)
    unmet = _unmet(score.trajectory, asked) if score.trajectory is not None else {}
    errors = None if score.map is None else score.map.errors
    no_truth = errors is not None and not errors.point_error_m.count
    limits = [item for item in score.verdicts if item.state is VerdictState.NOT_ENOUGH_DATA]
    return (
        *unmet.values(),
        *(["map: no point of the cloud has a true point"] if no_truth else []),
        *(_no_data(item) for item in limits if item.condition not in unmet),
    )


def _unmet(trajectory: TrajectoryScore, asked: Collection[Condition]) -> dict[Condition | None, str]:
    """Return the reasons of the conditions that the drive never meets."""
    return {
        part.condition: _reason(
            part.condition, _Extent(trajectory.matched, trajectory.path_length_m, trajectory.duration_s or 0.0)
        )
        for part in trajectory.conditions
        if not part.count and (not asked or part.condition in asked)
    }


def conditions_beyond(truth: Trajectory, conditions: Collection[Condition]) -> tuple[str, ...]:
    """Return why a drive with this truth never meets some conditions, to be said before the work is done."""
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    duration_s = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) / NS_PER_S if len(truth) else 0.0
    extent = _Extent(len(truth), float(steps.sum()), duration_s)
    longest = {
        ConditionKind.DISTANCE: extent.path_length_m,
        ConditionKind.TIME: extent.duration_s,
        ConditionKind.FRAMES: float(extent.frames - 1),
    }
    return tuple(_reason(item, extent) for item in conditions if item.value > longest[item.kind])


def _reason(condition: Condition, extent: _Extent) -> str:
    """Return how long the drive is in the unit of a condition that it never meets."""
    texts = {
        ConditionKind.DISTANCE: f"the drive is {extent.path_length_m:.1f} m long",
        ConditionKind.TIME: f"the drive lasts {extent.duration_s:.1f} s",
        ConditionKind.FRAMES: f"the drive has {extent.frames} frames",
    }
    one = "one pose of the estimate has a true pose, at least two are needed"
    return f"condition {condition.kind}={condition.value:g}: {texts[condition.kind] if extent.frames > 1 else one}"


def _no_data(item: Verdict) -> str:
    condition = "" if item.condition is None else f" over {item.condition.label}"
    return f"limit {item.metric}{condition}: " + (f"only {item.count} values" if item.count else "no data")

"""Sub-trajectories of the score as the figures need them, each with what leads back to its frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.metrics.score import ConditionScore, PathRows, Score, SubTrajectoryRows

TRACE_BACK = (
    "sub-trajectory over %{customdata[0]}<br>frames %{customdata[1]} to %{customdata[2]}<br>"
    "stamps %{customdata[3]} to %{customdata[4]} ns"
)
"""What a mark says when pointed at; `customdata` is a row of `traces_to`."""


@dataclass(frozen=True, slots=True)
class Part:
    """What figures show of one condition.

    Attributes:
        score: Its figures.
        rows: Its sub-trajectories.
        travelled_m: Distance travelled at the end of each, m.
    """

    score: ConditionScore
    rows: SubTrajectoryRows
    travelled_m: list[float]


def parts_of(score: Score) -> list[Part]:
    """Return figures and sub-trajectories of each condition that has any."""
    details = None if score.details is None else score.details.trajectory
    if details is None or score.trajectory is None:
        return []
    return [
        Part(part, rows, _travelled_at(details.path, rows.end_frame))
        for part, rows in zip(score.trajectory.conditions, details.sub_trajectories, strict=False)
        if rows.start_frame
    ]


def _travelled_at(path: PathRows, frames: tuple[int, ...]) -> list[float]:
    """Return the distance travelled at frames, in a straight line between the rows of a thinned path."""
    known = np.array(path.travelled_m, np.float64)
    return [round(value, 4) for value in np.interp(frames, np.arange(len(known)) * path.every, known).tolist()]


def traces_to(rows: SubTrajectoryRows) -> list[list[str | int]]:
    """Return what leads back to the frames of each sub-trajectory; stamps as text, since they need all 64 bits."""
    frames = zip(rows.start_frame, rows.end_frame, rows.start_stamp_ns, rows.end_stamp_ns, strict=True)
    return [[str(rows.condition), first, last, str(start), str(end)] for first, last, start, end in frames]


def error_sizes(rows: SubTrajectoryRows) -> list[float]:
    """Return the size of each position error, m."""
    return sizes(rows.x_m, rows.y_m, rows.z_m)


def sizes(*columns: Sequence[float | None]) -> list[float]:
    """Return the norm of each row; what is undefined counts as zero."""
    return [math.hypot(*(value or 0.0 for value in row)) for row in zip(*columns, strict=True)]

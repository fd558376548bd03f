"""Sub-trajectories of the score as the figures need them, each with what leads back to its frames."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from sfr_loc_map.report.cells import condition_text, conditions_of, dig

Part: TypeAlias = tuple[Mapping[str, Any], Mapping[str, Any]]
"""Figures of a condition, and columns of its sub-trajectories."""
TRACE_BACK = (
    "sub-trajectory over %{customdata[0]}<br>frames %{customdata[1]} to %{customdata[2]}<br>"
    "stamps %{customdata[3]} to %{customdata[4]} ns"
)
"""What a mark says when pointed at; `customdata` is a row of `traces_to`."""


def parts_of(score: Mapping[str, Any]) -> list[Part]:
    """Return figures and sub-trajectories of each condition that has any; `way_m` is the way to each end."""
    details = dig(score, "details.trajectory.sub_trajectories") or []
    scores = [part for _, part in conditions_of(score)]
    path = dig(score, "details.trajectory.path") or {}
    return [
        (part, {**rows, "way_m": _way_at(path, rows["end_frame"])})
        for part, rows in zip(scores, details, strict=False)
        if rows.get("start_frame")
    ]


def _way_at(path: Mapping[str, Any], frames: list[int]) -> list[float]:
    """Return the distance travelled at frames, in a straight line between the rows of a thinned path."""
    way = path["travelled_m"]
    rows = np.arange(len(way)) * path["every"]
    return [round(value, 4) for value in np.interp(frames, rows, way).tolist()]


def traces_to(rows: Mapping[str, Any]) -> list[list[Any]]:
    """Return what leads back to the frames of each sub-trajectory; stamps as text, since they need all 64 bits."""
    over = condition_text(rows["condition"])
    names = ("start_frame", "end_frame", "start_stamp_ns", "end_stamp_ns")
    return [
        [over, first, last, str(start), str(end)]
        for first, last, start, end in zip(*(rows[name] for name in names), strict=True)
    ]


def error_sizes(rows: Mapping[str, Any]) -> list[float]:
    """Return the size of each position error, m."""
    return [math.hypot(*vector) for vector in zip(rows["x_m"], rows["y_m"], rows["z_m"], strict=True)]

"""Data of a score that is plotted: path, sub-trajectories, map, errors by range, and limits.

The plots of a page and of a printed report, the summary and the live page use the same data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.figures.details import MapDetails, PathRows, SubTrajectoryRows
from sfr_loc_map.metrics.figures.row_part import range_of
from sfr_loc_map.metrics.figures.rows import NUMBERS, Figure
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.verdict_view import limited_statistic_title

Errors = list[float | None]
"""Errors, None if unknown."""


class PlottedCondition(NamedTuple):
    """The sub-trajectories of one condition, and the distance travelled from the first frame of the drive to each end.

    In contrast, `rows.travelled_m` is the length of each sub-trajectory.
    """

    rows: SubTrajectoryRows
    at_end_m: list[float]

    @property
    def over(self) -> str:
        """The condition in words."""
        return label_of(self.rows.condition)

    @property
    def extent_m(self) -> list[float]:
        """The smallest and the largest distance travelled at an end."""
        return [min(self.at_end_m), max(self.at_end_m)]


class PlottedLimit(NamedTuple):
    """A limit on a statistic of plotted values."""

    title: str  #: `limit of mean + 3 sigma`.
    value: float  #: Value in the unit of the figure.


class RangeErrors(NamedTuple):
    """Errors of map points within bounds of their range, m."""

    nearest_m: float
    farthest_m: float
    row: Figure


def path_of(score: Score) -> PathRows | None:
    """Return the frames of the trajectory; None if they are unknown."""
    details = score.details
    return None if details is None or details.trajectory is None else details.trajectory.path


def map_of(score: Score) -> MapDetails | None:
    """Return the data for plots of the map; None if it is unknown."""
    return None if score.details is None else score.details.map


def plotted_conditions(score: Score) -> list[PlottedCondition]:
    """Return the sub-trajectories of each condition, first the conditions that a limit names.

    Conditions without sub-trajectories are omitted.
    """
    details = None if score.details is None else score.details.trajectory
    if details is None or details.path is None:
        return []
    known, every = np.array(details.path.travelled_m, np.float64), details.path.every
    conditions = []
    for rows in details.sub_trajectories:
        if rows.start_frame:  # linear between the rows of a decimated path
            travelled = np.interp(rows.end_frame, np.arange(len(known)) * every, known)
            conditions.append(PlottedCondition(rows, [round(value, 4) for value in travelled.tolist()]))
    limited = {item.condition for item in score.verdicts}
    return sorted(conditions, key=lambda plotted: plotted.rows.condition not in limited)


def limits_on(score: Score, figure: str, condition: str | None = None, part: str | None = None) -> list[PlottedLimit]:
    """Return the limits on a figure, each once, although two requirements can have the same limit."""
    found = [
        PlottedLimit(f"limit of {limited_statistic_title(item.statistic)}", item.limit)
        for item in score.verdicts
        if item.figure == figure
        and item.condition == condition
        and item.statistic is not None
        and (part is None or item.part == part)
        and not item.is_of_target
    ]
    return list(dict.fromkeys(found))


def drawn_statistics(score: Score, row: Figure | None) -> dict[str, float]:
    """Return the defined statistics of a row that plots of its errors draw as lines, by name.

    These are the statistics that every view shows, and those with a limit. A sigma is not drawn, because it is a spread
    and not a level.
    """
    if row is None:
        return {}
    shown = KINDS[row.figure].shown if row.figure in KINDS else ()
    limited = {item.statistic for item in score.verdicts if score.is_about(item, row)}
    wanted = limited.union(shown) - {"sigma", "value"}
    return {name: value for name in NUMBERS if name in wanted and (value := row.statistic(name)) is not None}


def error_sizes(rows: SubTrajectoryRows) -> Errors:
    """Return the norm of each position error, m; None if a component is unknown."""
    return _sizes(rows.x_m, rows.y_m, rows.z_m)


def path_errors(path: PathRows) -> list[Errors]:
    """Return the errors x, y and z of each frame of a path, m, and their norm."""
    truth = path.truth_x_m, path.truth_y_m, path.truth_z_m
    estimate = path.estimate_x_m, path.estimate_y_m, path.estimate_z_m
    errors = [
        [None if e is None or t is None else e - t for t, e in zip(*columns, strict=True)]
        for columns in zip(truth, estimate, strict=True)
    ]
    return [*errors, _sizes(*errors)]


def errors_by_range(score: Score) -> list[RangeErrors]:
    """Return the point errors by range."""
    bounded = [(range_of(row.part), row) for row in score.rows("point_error")]
    return [RangeErrors(*bounds, row) for bounds, row in bounded if bounds is not None]


def _sizes(*columns: Sequence[float | None]) -> Errors:
    return [_norm(row) for row in zip(*columns, strict=True)]


def _norm(components: Sequence[float | None]) -> float | None:
    known = [value for value in components if value is not None]
    return math.hypot(*known) if len(known) == len(components) else None

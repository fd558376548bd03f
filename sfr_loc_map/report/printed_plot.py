"""Plots of errors of sub-trajectories and map points for a printed page: values here, SVG in the template."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.report.plots import error_scale, largest
from sfr_loc_map.report.score_plots import error_sizes, limits_on, map_of, plotted_conditions
from sfr_loc_map.report.tables import UNKNOWN, number

WIDTH, HEIGHT = 640.0, 220.0  #: Size of the drawing, px.
LEFT, BOTTOM, TOP, RIGHT = 64.0, 46.0, 12.0, 12.0  #: Margins of the axes, px.
TICKS = 5  #: Maximum number of ticks of an axis.
POINTS = 1000  #: Maximum number of marks of map points.


class Tick(NamedTuple):
    """A labelled position on an axis."""

    at: float  #: px.
    text: str


class Level(NamedTuple):
    """A horizontal line at a statistic or a limit."""

    at: float  #: px.
    text: str
    dash: str


@dataclass(frozen=True, slots=True)
class PrintedPlot:
    """Marks and axes of one condition, in px of the drawing."""

    title: str
    x_title: str
    y_title: str  #: With the unit.
    unit: str
    count: int
    points: list[tuple[float, float]]
    x_ticks: list[Tick]
    y_ticks: list[Tick]
    levels: list[Level]
    beyond: str  #: Limits above the drawing, in words.


class Series(NamedTuple):
    """Data of one plot: a mark for each error, and lines at the statistics and the limits of the errors."""

    title: str
    x_title: str
    y_title: str  #: Without the unit.
    x: Sequence[float | None]
    sizes: Sequence[float | None]  #: Sizes of the errors, before scaling.
    row: Figure | None
    limits: list[tuple[str, float]]  #: Statistic and limit.
    scale: tuple[float, str]  #: Factor and unit of the drawing.
    mean: str = "mean"  #: Label of the mean of the row.


def printed_plots(score: Score) -> list[PrintedPlot]:
    """Return the errors of position and attitude over the distance travelled, and of map points over their range."""
    return [_drawn(series) for series in (*_of_drive(score), *_of_map(score))]


def _of_drive(score: Score) -> Iterator[Series]:
    at_the_end = "distance travelled at the end, m"
    for part in plotted_conditions(score):
        condition = part.rows.condition
        sizes = error_sizes(part.rows)
        scale = error_scale(largest(sizes))
        title = f"Position error over {part.over}, at the end of each sub-trajectory"
        row, limits = score.figure("position", condition=condition), limits_on(score, "position", condition)
        yield Series(
            title, at_the_end, "position error", part.travelled_m, sizes, row, limits, scale, "norm of the mean"
        )
        if any(value is not None for value in part.rows.attitude_deg):
            title = f"Attitude error over {part.over}, at the end of each sub-trajectory"
            row, limits = score.figure("attitude", condition=condition), limits_on(score, "attitude", condition)
            angles = part.rows.attitude_deg
            yield Series(title, at_the_end, "attitude error", part.travelled_m, angles, row, limits, (1.0, "deg"))


def _of_map(score: Score) -> Iterator[Series]:
    details = map_of(score)
    if details is None or not details.cloud.error_m:
        return
    every = -(-len(details.cloud.error_m) // POINTS)
    sizes, ranges = details.cloud.error_m[::every], details.cloud.range_m[::every]
    row, limits = score.figure("point_error", part=None), limits_on(score, "point_error")
    title = f"Error of map points over their range, {len(sizes)} of {UNKNOWN if row is None else row.n} points"
    scale = error_scale(largest(list(sizes)))
    yield Series(title, "range of the true point, m", "point error", ranges, sizes, row, limits, scale)


def _drawn(series: Series) -> PrintedPlot:
    row, (factor, unit) = series.row, series.scale
    statistics = () if row is None else ((series.mean, row.mean, "2 3"), ("mean + 3 sigma", row.mean_plus_3sigma, ""))
    known = [(name, value * factor, dash) for name, value, dash in statistics if value is not None]
    both = zip(series.x, series.sizes, strict=True)
    pairs = [(x, size * factor) for x, size in both if x is not None and size is not None]
    x_most, x_step = _end_of(max((x for x, _ in pairs), default=0.0))
    y_most, y_step = _end_of(max([y for _, y in pairs] + [value for _, value, _ in known], default=0.0))
    interval = None if row is None or row.interval is None else [number(bound * factor) for bound in row.interval]
    certain = "" if interval is None else f" (95 % interval {' to '.join(interval)} {unit})"
    lines = [
        (f"{name} {number(value)} {unit}{certain if not dash else ''}", value, dash) for name, value, dash in known
    ]
    lines += [(f"limit {number(limit * factor)} {unit}", limit * factor, "8 4") for _, limit in series.limits]
    return PrintedPlot(
        title=series.title,
        x_title=series.x_title,
        y_title=f"{series.y_title}, {unit}",
        unit=unit,
        count=len(pairs),
        points=[(_x(x, x_most), _y(y, y_most)) for x, y in pairs],
        x_ticks=[Tick(_x(value, x_most), f"{value:g}") for value in _ticks(x_most, x_step)],
        y_ticks=[Tick(_y(value, y_most), f"{value:g}") for value in _ticks(y_most, y_step)],
        levels=[Level(_y(value, y_most), text, dash) for text, value, dash in lines if value <= y_most],
        beyond=", ".join(text for text, value, _ in lines if value > y_most),
    )


def _end_of(most: float) -> tuple[float, float]:
    """Return the end of an axis from 0 and the step of its ticks, 1, 2 or 5 times a power of ten."""
    rough = (most or 1.0) / TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough * (1.0 - 1e-9))
    return step * math.ceil((most or 1.0) / step * (1.0 - 1e-9)), step


def _ticks(most: float, step: float) -> list[float]:
    return [round(step * k, 12) for k in range(round(most / step) + 1)]


def _x(value: float, most: float) -> float:
    return round(LEFT + (WIDTH - LEFT - RIGHT) * value / most, 2)


def _y(value: float, most: float) -> float:
    return round(HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * value / most, 2)

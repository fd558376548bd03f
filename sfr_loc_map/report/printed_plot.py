"""Plots of errors of sub-trajectories and map points for a printed page: values here, SVG in the template."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.metrics.figures.catalogue import TOTAL, statistic_title
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.plots import error_scale, largest
from sfr_loc_map.report.plotted_data import (
    PlottedLimit,
    drawn_statistics,
    error_sizes,
    limits_on,
    map_of,
    plotted_conditions,
)
from sfr_loc_map.tables.model import Unit, exact_number, number


class Drawing(NamedTuple):
    """Size of a drawing and margins of its axes, px."""

    width: float
    height: float
    left: float
    right: float
    top: float
    bottom: float


class LineStyle(NamedTuple):
    """A style of lines: its word in the caption, and its dashes in SVG."""

    word: str
    dashes: str


DRAWING = Drawing(width=640.0, height=220.0, left=64.0, right=12.0, top=12.0, bottom=46.0)
STYLES = {"mean": LineStyle("Dotted", "2 3"), TOTAL: LineStyle("Solid", "none")}
"""Styles of the statistics of errors."""
OTHER_STYLE = LineStyle("Dash-dotted", "8 3 2 3")  #: Style of other statistics.
LIMIT_STYLE = LineStyle("Dashed", "8 4")
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
    style: LineStyle


@dataclass(frozen=True, slots=True)
class PrintedPlot:
    """Marks and axes of one plot, in px of the drawing."""

    title: str
    x_title: str
    y_title: str  #: With the unit.
    count: int  #: Number of errors of the figure, of which the plot may show a part.
    points: list[tuple[float, float]]
    x_ticks: list[Tick]
    y_ticks: list[Tick]
    levels: list[Level]
    beyond: str  #: Limits above the drawing, in words.

    @property
    def count_text(self) -> str:
        """The number of errors, and the number of marks if it is smaller."""
        drawn = len(self.points)
        return f"n = {self.count}" if drawn == self.count else f"n = {self.count}, of which {drawn} are drawn"


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Data of one plot: a mark for each error, and lines at the statistics and the limits of the errors."""

    title: str
    x_title: str
    y_title: str  #: Without the unit.
    x: Sequence[float | None]
    sizes: Sequence[float | None]  #: Sizes of the errors, before scaling.
    row: Figure | None
    statistics: Mapping[str, float]  #: Drawn statistics of the row, by name.
    limits: list[PlottedLimit]
    factor: float  #: Factor from the unit of the errors to the unit of the drawing.
    unit: str  #: Unit of the drawing.
    mean: str = "mean"  #: Label of the mean of the row.


def printed_plots(score: Score) -> list[PrintedPlot]:
    """Return plots of the position and attitude errors over the distance, and of the point errors over the range."""
    return [_drawn(series) for series in (*_of_drive(score), *_of_map(score))]


def _of_drive(score: Score) -> Iterator[Series]:
    for plotted in plotted_conditions(score):
        condition = plotted.rows.condition
        at_the_end = f"over {plotted.over}, at the end of each sub-trajectory"
        travelled = "distance travelled at the end, m"
        sizes = error_sizes(plotted.rows)
        factor, unit = error_scale(largest(sizes))
        position = score.figure("position", condition=condition)
        yield Series(
            title=f"Position error {at_the_end}",
            x_title=travelled,
            y_title="position error",
            x=plotted.at_end_m,
            sizes=sizes,
            row=position,
            statistics=drawn_statistics(score, position),
            limits=limits_on(score, "position", condition),
            factor=factor,
            unit=unit,
            mean="norm of the mean",
        )
        attitude = score.figure("attitude", condition=condition)
        if any(value is not None for value in plotted.rows.attitude_deg):
            yield Series(
                title=f"Attitude error {at_the_end}",
                x_title=travelled,
                y_title="attitude error",
                x=plotted.at_end_m,
                sizes=plotted.rows.attitude_deg,
                row=attitude,
                statistics=drawn_statistics(score, attitude),
                limits=limits_on(score, "attitude", condition),
                factor=1.0,
                unit="deg",
            )


def _of_map(score: Score) -> Iterator[Series]:
    details = map_of(score)
    if details is None or not details.cloud.error_m:
        return
    every = -(-len(details.cloud.error_m) // POINTS)
    sizes, ranges = details.cloud.error_m[::every], details.cloud.range_m[::every]
    row = score.figure("point_error", part=None)
    factor, unit = error_scale(largest(list(sizes)))
    yield Series(
        title="Error of map points over their range",
        x_title="range of the true point, m",
        y_title="point error",
        x=ranges,
        sizes=sizes,
        row=row,
        statistics=drawn_statistics(score, row),
        limits=limits_on(score, "point_error"),
        factor=factor,
        unit=unit,
    )


class _Line(NamedTuple):
    value: float  #: Value in the unit of the drawing.
    text: str
    style: LineStyle


def _statistics_of(series: Series) -> Iterator[_Line]:
    """Yield the lines at the statistics of the errors; mean + 3 sigma has its interval."""
    factor, unit = series.factor, series.unit
    interval = None if series.row is None else series.row.interval
    for statistic, value in series.statistics.items():
        title = series.mean if statistic == "mean" else statistic_title(statistic)
        text = f"{title} {number(value * factor)} {unit}"
        if statistic == TOTAL and interval is not None:
            low, high = (number(bound * factor) for bound in interval)
            text += f" (95 % interval {low} to {high} {unit})"
        yield _Line(value * factor, text, STYLES.get(statistic, OTHER_STYLE))


def _drawn(series: Series) -> PrintedPlot:
    """Return a plot whose axes cover all marks and statistics, but not the limits."""
    factor, unit = series.factor, series.unit
    both = zip(series.x, series.sizes, strict=True)
    pairs = [(x, size * factor) for x, size in both if x is not None and size is not None]
    lines = list(_statistics_of(series))
    x_most, x_step = _end_of(max((x for x, _ in pairs), default=0.0))
    y_most, y_step = _end_of(max([y for _, y in pairs] + [line.value for line in lines], default=0.0))
    for limit in series.limits:
        level = limit.value * factor
        lines.append(_Line(level, f"{limit.title} {exact_number(limit.value, Unit(unit))} {unit}", LIMIT_STYLE))
    return PrintedPlot(
        title=series.title,
        x_title=series.x_title,
        y_title=f"{series.y_title}, {unit}",
        count=len(pairs) if series.row is None or series.row.n is None else series.row.n,
        points=[(_x(x, x_most), _y(y, y_most)) for x, y in pairs],
        x_ticks=[Tick(_x(value, x_most), f"{value:g}") for value in _ticks(x_most, x_step)],
        y_ticks=[Tick(_y(value, y_most), f"{value:g}") for value in _ticks(y_most, y_step)],
        levels=[Level(_y(line.value, y_most), line.text, line.style) for line in lines if line.value <= y_most],
        beyond=", ".join(line.text for line in lines if line.value > y_most),
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
    left, right = DRAWING.left, DRAWING.width - DRAWING.right
    return round(left + (right - left) * value / most, 2)


def _y(value: float, most: float) -> float:
    base, top = DRAWING.height - DRAWING.bottom, DRAWING.top
    return round(base - (base - top) * value / most, 2)

"""The position errors of sub-trajectories as a figure of a printed page: values here, drawn as SVG by the template."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.metrics.score import Figure, Score
from sfr_loc_map.report.plots import error_scale, largest
from sfr_loc_map.report.score_figures import error_sizes, parts_of
from sfr_loc_map.report.score_tables import limits_on
from sfr_loc_map.report.tables import number

WIDTH, HEIGHT = 640.0, 220.0  #: Size of the drawing, px.
LEFT, BOTTOM, TOP, RIGHT = 64.0, 46.0, 12.0, 12.0  #: Margins of the axes, px.
TICKS = 5  #: Most ticks of an axis.


class Tick(NamedTuple):
    """A labelled place on an axis."""

    at: float  #: px.
    text: str


class Level(NamedTuple):
    """A horizontal line at a statistic or a limit."""

    at: float  #: px.
    text: str
    dash: str


@dataclass(frozen=True, slots=True)
class PrintedFigure:
    """Marks and axes of one condition, in px of the drawing."""

    title: str
    unit: str
    count: int
    points: list[tuple[float, float]]
    x_ticks: list[Tick]
    y_ticks: list[Tick]
    levels: list[Level]
    beyond: str  #: Limits that are above the drawing, in words.


def printed_figures(score: Score) -> list[PrintedFigure]:
    """Return the position errors over the distance travelled, of each condition that has sub-trajectories."""
    found = []
    for part in parts_of(score):
        condition = part.rows.condition
        row = score.figure("position", condition=condition)
        limits = limits_on(score, "position", condition)
        found.append(_drawn(part.over, part.travelled_m, error_sizes(part.rows), row, limits))
    return found


def _drawn(
    over: str, travelled_m: list[float], sizes_m: list[float | None], row: Figure | None, limits: dict[str, float]
) -> PrintedFigure:
    factor, unit = error_scale(largest(sizes_m))
    statistics = (
        () if row is None else (("norm of the mean", row.mean, "2 3"), ("mean + 3 sigma", row.mean_plus_3sigma, ""))
    )
    known = [(name, value * factor, dash) for name, value, dash in statistics if value is not None]
    pairs = [(x, size * factor) for x, size in zip(travelled_m, sizes_m, strict=True) if size is not None]
    x_most, x_step = _end_of(max((x for x, _ in pairs), default=0.0))
    y_most, y_step = _end_of(max([y for _, y in pairs] + [value for _, value, _ in known], default=0.0))
    interval = None if row is None or row.interval is None else [number(bound * factor) for bound in row.interval]
    certain = "" if interval is None else f" (95 % interval {' to '.join(interval)} {unit})"
    lines = [
        (f"{name} {number(value)} {unit}{certain if not dash else ''}", value, dash) for name, value, dash in known
    ]
    lines += [(f"limit {number(limit * factor)} {unit}", limit * factor, "8 4") for limit in limits.values()]
    return PrintedFigure(
        title=f"Position error over {over}, at the end of each sub-trajectory",
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

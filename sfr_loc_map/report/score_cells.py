"""Cells of statistics, each with its place in the JSON of the score."""

from __future__ import annotations

from collections.abc import Iterator

from sfr_loc_map.metrics.score import ConditionScore, IntervalStatistic, SampleStatistic, Score, Statistic
from sfr_loc_map.tables.numbers import ABSENT, NONE, NOT_ENOUGH, Unit, fitting
from sfr_loc_map.tables.table import Cell, Column, Row


def figure(value: float | int | None, key: str, unit: Unit = NONE) -> Cell:
    """Return a figure that is undefined where there is not enough data."""
    return Cell.number(value, key, unit, NOT_ENOUGH)


def statistic_columns(unit: Unit = NONE) -> tuple[Column, ...]:
    """Return the columns of `statistic_cells`."""
    return tuple(Column(title, unit) for title in ("mean", "sigma", "mean + 3 sigma"))


def statistic_values(value: Statistic | SampleStatistic) -> tuple[float | None, ...]:
    """Return mean, sigma and mean + 3 sigma."""
    return value.mean, value.sigma, value.mean_plus_3sigma


def statistic_cells(value: Statistic | SampleStatistic, key: str, unit: Unit = NONE) -> Row:
    """Return mean, sigma and mean + 3 sigma in a unit."""
    names = ("mean", "sigma", "mean_plus_3sigma")
    values = zip(names, statistic_values(value), strict=True)
    return tuple(figure(item, f"{key}.{name}", unit) for name, item in values)


def statistic_row(title: str, unit: Unit, value: Statistic | SampleStatistic, key: str, count: Cell) -> Row:
    """Return a row in the unit that suits it: title, unit, statistic, interval of mean + 3 sigma, count."""
    bounds = value.mean_plus_3sigma_ci95 if isinstance(value, IntervalStatistic) else None
    unit = fitting(unit, *statistic_values(value), *(bounds or ()))
    interval = Cell(ABSENT)
    if isinstance(value, IntervalStatistic):
        interval = Cell.interval(bounds, f"{key}.mean_plus_3sigma_ci95", unit, NOT_ENOUGH)
    return (Cell.head(title), Cell(unit.symbol), *statistic_cells(value, key, unit), interval, count)


def keyed_conditions(score: Score) -> Iterator[tuple[str, ConditionScore]]:
    """Yield the score of each condition with the key that leads to it."""
    if score.trajectory is None:
        return
    if not score.trajectory.several:
        yield "trajectory", score.trajectory.first
    for number, part in enumerate(score.trajectory.several):
        yield f"trajectory.conditions.{number}", part

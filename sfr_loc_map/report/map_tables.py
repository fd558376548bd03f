"""The table of the map: error and coverage over all, by range, by pair."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.metrics.score import DisparityStatistic, MapScore, SampleStatistic, Score
from sfr_loc_map.report.score_cells import figure, statistic_cells, statistic_columns
from sfr_loc_map.report.terms import terms
from sfr_loc_map.tables.numbers import ABSENT, METRE, PIXEL, Unit, fitting, number
from sfr_loc_map.tables.table import Cell, Column, Row, Table


@dataclass(frozen=True, slots=True)
class MapError:
    """The error of a map: by pixel, or only to the nearest true point.

    Attributes:
        value: The error, m.
        key: Its place in the JSON.
        title: Its name.
    """

    value: SampleStatistic
    key: str
    title: str


def map_error(part: MapScore) -> MapError | None:
    """Return the error of a map."""
    if part.errors is not None:
        return MapError(part.errors.point_error_m, "map.point_error_m", "map: point error")
    if part.nearest_distance_m is not None:
        return MapError(part.nearest_distance_m, "map.nearest_distance_m", "map: distance to the nearest true point")
    return None


def map_table(score: Score) -> Table | None:
    """Return the error and the coverage of the map: all, by range, by pair."""
    part = score.map
    error = None if part is None else map_error(part)
    if part is None or error is None:
        return None
    errors, without_truth = part.errors, 0
    disparity = None if errors is None else errors.disparity_error_px
    unit = fitting(METRE, error.value.mean_plus_3sigma, error.value.p95)
    cells = _disparity(disparity, "map"), _coverage(part.coverage, "map")
    rows = [_row("all points", (error.value, error.key, unit), *cells)]
    if errors is not None:
        without_truth = errors.points_without_truth
        for k, item in enumerate(errors.by_range):
            key = f"map.by_range.{k}"
            title = f"{item.from_m:g} to {item.to_m:g} m"
            cells = _disparity(item.disparity_error_px, key), _coverage(item.coverage, key)
            rows.append(_row(title, (item.point_error_m, key, unit), *cells))
        for k, pair in enumerate(errors.by_pair):
            key = f"map.by_pair.{k}"
            cells = Cell(ABSENT), _coverage(pair.coverage, key)
            rows.append(_row(f"pair {pair.pair}", (pair.point_error_m, f"{key}.point_error_m", unit), *cells))
    columns = (
        Column("points", words=True),
        *statistic_columns(unit),
        Column("p50", unit),
        Column("p95", unit),
        Column("|disparity error| p50", PIXEL),
        Column("n"),
        Column("coverage"),
    )
    low, high = (number(bound) for bound in part.coverage_range_m)
    note = f"{part.points} points of {part.pairs} pairs, {without_truth} of them without truth (not scored). "
    note += f"Coverage: share of the true points from {low} to {high} m, or of the range named."
    name = error.title.removeprefix("map: ")
    words = terms(name, "mean + 3 sigma", "p50, p95, p99", "disparity error", "coverage", "LM")
    return Table("map", error.title.capitalize(), columns, tuple(rows), note, words)


def _row(title: str, place: tuple[SampleStatistic, str, Unit], disparity: Cell, coverage: Cell) -> Row:
    """Return a row; the error comes with its key and its unit."""
    error, key, unit = place
    quantiles = figure(error.p50, f"{key}.p50", unit), figure(error.p95, f"{key}.p95", unit)
    count = Cell.number(error.count, f"{key}.count")
    return (Cell.head(title), *statistic_cells(error, key, unit), *quantiles, disparity, count, coverage)


def _disparity(value: DisparityStatistic | None, key: str) -> Cell:
    if value is None:
        return Cell(ABSENT)
    return Cell.number(value.p50_abs, f"{key}.disparity_error_px.p50_abs", undefined=ABSENT)


def _coverage(value: float | None, key: str) -> Cell:
    return Cell.number(value, f"{key}.coverage", undefined="no true points")

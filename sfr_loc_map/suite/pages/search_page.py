"""Tables and page of a search for the worst case."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.report.page import render_overview
from sfr_loc_map.report.plots import Plot, axis, colour_bar, log_axis, marks, plain, span
from sfr_loc_map.report.summary import Banner
from sfr_loc_map.suite.search.record import CoverageRecord, Parameter, PointRecord, SearchRecord, badness_of
from sfr_loc_map.tables.model import UNKNOWN, Cell, Column, Table
from sfr_loc_map.tables.typed import RowColumn, heads, numbers, table_of, words

WORST_SHOWN = 20  #: Maximum number of points in the table of the worst points.
CELLS_SHOWN = 30  #: Maximum number of untested cells in the table.
WITHOUT = "no figure"  #: Text in place of the ratio of a drive that lacks the figure.


def search_tables(record: SearchRecord) -> list[Table]:
    """Return the tables: the worst case, the worst points, and untested cells."""
    return [case_table(record), _points_table(record), *_coverage_tables(record.coverage)]


class CaseRow(NamedTuple):
    """A parameter, or the ratio of figure and limit, at the compared points."""

    title: str
    parameter: Parameter | None  #: None for the ratio.
    usual: float | None
    worst: float | None
    reduced: float | None

    @property
    def without(self) -> str:
        """Text in place of a missing value."""
        return WITHOUT if self.parameter is None else UNKNOWN


CASE: tuple[RowColumn[CaseRow], ...] = (
    heads("parameter", lambda row: row.title),
    numbers("low", lambda row: None if row.parameter is None else row.parameter.low),
    numbers("high", lambda row: None if row.parameter is None else row.parameter.high),
    RowColumn(Column("usual"), lambda row: Cell.number(row.usual, undefined=row.without)),
    RowColumn(Column("worst point"), lambda row: Cell.number(row.worst, undefined=row.without)),
    RowColumn(Column("reduced case"), lambda row: Cell.number(row.reduced, undefined=row.without)),
)


def case_table(record: SearchRecord) -> Table:
    """Return the ranges of the parameters, and their values in the usual scenario, the worst point and the case."""
    points = (record.usual, record.found, record.case)
    rows = []
    for parameter in record.parameters:
        values = (point.point.get(parameter.name) for point in points)
        rows.append(CaseRow(parameter.name, parameter, *values))
    rows.append(CaseRow("figure over limit", None, *(point.ratio for point in points)))
    note = (
        f"{record.title}: limit {record.limit:g}. {len(record.points)} points were searched. The reduced case is "
        "the worst point with those changes removed or made smaller without which the limit is still missed. Further "
        "points were run to reduce the case and to compute the slices. A drive without the figure counts as worse than "
        "any drive with the figure."
    )
    return table_of("case", "Worst case", CASE, rows, note)


def _points_table(record: SearchRecord) -> Table:
    columns: list[RowColumn[tuple[int, PointRecord]]] = [
        numbers("point", lambda row: row[0]),
        numbers("figure over limit", lambda row: row[1].ratio, undefined=WITHOUT),
        *(_values_of(parameter.name) for parameter in record.parameters),
    ]
    numbered = sorted(enumerate(record.points, 1), key=lambda row: badness_of(row[1].ratio), reverse=True)
    return table_of("points", "Points with the smallest margin", columns, numbered[:WORST_SHOWN])


def _values_of(name: str) -> RowColumn[tuple[int, PointRecord]]:
    return numbers(name, lambda row: row[1].point[name])


def _coverage_tables(coverage: Sequence[CoverageRecord]) -> list[Table]:
    tables = []
    for number, combination in enumerate(coverage, 1):
        columns = [_ranges_of(name, index) for index, name in enumerate(combination.parameters)]
        tested = combination.cells - len(combination.missing)
        note = f"{tested} of {combination.cells} cells were tested. The table lists untested cells."
        title = f"Coverage: {', '.join(combination.parameters)}"
        tables.append(table_of(f"coverage-{number}", title, columns, combination.missing[:CELLS_SHOWN], note))
    return tables


def _ranges_of(name: str, index: int) -> RowColumn[Sequence[tuple[float, float]]]:
    def text_of(cell: Sequence[tuple[float, float]]) -> str:
        low, high = cell[index]
        return f"{low:.4g} to {high:.4g}"

    return words(name, text_of)


def render_search(record: SearchRecord) -> str:
    """Return the page of a search as HTML."""
    text = f"{record.title}: limit {record.limit:g}, missed at {record.missed} of {len(record.points)} points"
    if record.until_first_miss is not None:
        text += f", first at point {record.until_first_miss}"
    if record.usual.fails:
        text += ", and by the unchanged scenario"
    if record.left_out:
        text += f"; {len(record.left_out)} scenarios cannot be run and are skipped"
    state = VerdictState.FAIL if record.found.fails else None
    plots = [_course(record), *(_slice_plot(record, number) for number in range(len(record.slices)))]
    banner = Banner.of(state, f"{text}.")
    return render_overview("Search for the worst case", banner, search_tables(record), [("Search", plots)])


def _shown(record: SearchRecord, ratio: float | None) -> float:
    return record.lost_ratio if ratio is None else ratio


def _course(record: SearchRecord) -> Plot:
    numbered = list(enumerate(record.points, 1))
    ratios = [_shown(record, item.ratio) for item in record.points]
    traces = []
    for name, colour, lost in (("point", "@one", False), (f"{WITHOUT}, shown at the top", "@bad", True)):
        chosen = [
            (float(number), _shown(record, item.ratio)) for number, item in numbered if (item.ratio is None) is lost
        ]
        if chosen:
            traces.append(marks(name, [[x for x, _ in chosen], [y for _, y in chosen]], colour))
    layout = {"xaxis": axis("point"), "yaxis": log_axis("figure over limit", *span(ratios))}
    return Plot("search-course", "Course of the search", "A point above 1 misses the limit.", traces, layout)


def _slice_plot(record: SearchRecord, number: int) -> Plot:
    cut = record.slices[number]
    first, second = (record.parameters[index].name for index in (cut.first, cut.second))
    grid = {"type": "contour", "x": cut.x, "y": cut.y, "z": cut.ratios}
    levels = {
        **grid,
        "colorscale": "@sequential",
        "contours": {"coloring": "heatmap", "type": "levels"},
        "colorbar": colour_bar("figure over limit"),
    }
    border = {
        **grid,
        "contours": {"coloring": "none", "start": 1.0, "end": 1.0, "size": 1.0},
        "line": {"color": "@bad", "width": 3},
        "showscale": False,
        "name": "limit",
    }
    layout = {"xaxis": axis(plain(first)), "yaxis": axis(plain(second))}
    caption = "All other parameters are as in the reduced case. The line is the border where the limit is reached."
    return Plot(f"search-slice-{number}", f"{first} and {second}", caption, [levels, border], layout)

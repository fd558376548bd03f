"""Tables and page of a search for the worst case."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.metrics.catalogue import statistic_title, title_of
from sfr_loc_map.metrics.config import VerdictState, label_of
from sfr_loc_map.report.page import render_overview
from sfr_loc_map.report.plots import Plot, axis, colour_bar, log_axis, marks, plain, span
from sfr_loc_map.report.summary import Banner
from sfr_loc_map.report.tables import ABSENT, Cell, Column, Table
from sfr_loc_map.suite.search.run import SearchResult
from sfr_loc_map.suite.search.worst_case import Coverage, Slice

WORST_SHOWN = 20  #: Maximum number of points in the table of the worst points.
CELLS_SHOWN = 30  #: Maximum number of untested cells in the table.


def search_tables(result: SearchResult) -> list[Table]:
    """Return the tables: the worst case, the worst points, and untested cells."""
    return [_case_table(result), _points_table(result), *_coverage_tables(result.coverage)]


def _case_table(result: SearchResult) -> Table:
    columns = ("parameter", "low", "high", "usual", "worst point", "reduced case", "rank correlation")
    heads = tuple(Column(title, words=title == "parameter") for title in columns)
    rows = []
    for index, parameter in enumerate(result.specification.parameters):
        found, case = result.found.point[index], result.case.point[index]
        values = (parameter.low, parameter.high, parameter.usual, found, case, result.correlations[index])
        rows.append((Cell.head(parameter.name), *map(Cell.number, values)))
    ratios = (result.usual.ratio, result.found.ratio, result.case.ratio)
    rows.append((Cell.head("figure over limit"), *[Cell(ABSENT)] * 2, *map(Cell.number, ratios), Cell(ABSENT)))
    note = (
        "The reduced case is the smallest change of the usual scenario that misses the limit. A drive without the "
        "figure counts as 2. Rank correlation: between the parameter and the ratio over all points of the search."
    )
    return Table("case", "Worst case", heads, tuple(rows), note)


def _points_table(result: SearchResult) -> Table:
    parameters = result.specification.parameters
    heads = (Column("point"), Column("figure over limit"), *(Column(parameter.name) for parameter in parameters))
    numbered = sorted(enumerate(result.tried, 1), key=lambda item: -item[1].ratio)[:WORST_SHOWN]
    rows = tuple(
        (Cell.number(number), Cell.number(item.ratio), *map(Cell.number, item.point)) for number, item in numbered
    )
    return Table("points", "Points with the smallest margin", heads, rows, f"{len(result.tried)} points were searched.")


def _coverage_tables(coverage: Sequence[Coverage]) -> list[Table]:
    tables = []
    for number, combination in enumerate(coverage, 1):
        heads = tuple(Column(name, words=True) for name in combination.parameters)
        rows = tuple(
            tuple(Cell(f"{low:.4g} to {high:.4g}") for low, high in cell) for cell in combination.missing[:CELLS_SHOWN]
        )
        tested = combination.cells - len(combination.missing)
        note = f"{tested} of {combination.cells} cells were tested. The table lists untested cells."
        tables.append(Table(f"coverage-{number}", f"Coverage: {', '.join(combination.parameters)}", heads, rows, note))
    return tables


def render_search(result: SearchResult) -> str:
    """Return the page of a search as HTML."""
    chosen = result.specification.settings
    figure = f"{title_of(chosen.figure)}, {statistic_title(chosen.statistic)}, over {label_of(chosen.condition)}"
    missed = sum(item.fails for item in result.tried)
    text = f"{figure}: limit {chosen.limit:g}, missed at {missed} of {len(result.tried)} points"
    if result.until_first_miss is not None:
        text += f", first at point {result.until_first_miss}"
    if result.left_out:
        text += f"; {len(result.left_out)} scenarios cannot be run and are skipped"
    state = VerdictState.FAIL if missed else None
    plots = [_course(result), *(_slice_plot(result, number) for number in range(len(result.slices)))]
    banner = Banner.of(state, f"{text}.")
    return render_overview("Search for the worst case", banner, search_tables(result), [("Search", plots)])


def _course(result: SearchResult) -> Plot:
    numbers = [float(number) for number in range(1, len(result.tried) + 1)]
    ratios = [item.ratio for item in result.tried]
    trace = marks("point", [numbers, ratios], "@one")
    layout = {"xaxis": axis("point"), "yaxis": log_axis("figure over limit", *span(ratios))}
    return Plot("search-course", "Course of the search", "A point above 1 misses the limit.", [trace], layout)


def _slice_plot(result: SearchResult, number: int) -> Plot:
    cut: Slice = result.slices[number]
    first, second = (result.specification.parameters[index].name for index in (cut.first, cut.second))
    grid = {"type": "contour", "x": list(cut.x), "y": list(cut.y), "z": [list(row) for row in cut.ratios]}
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

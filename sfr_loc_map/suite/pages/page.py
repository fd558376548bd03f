"""The pages and files of a suite."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter

from sfr_loc_map.atomic import write_text
from sfr_loc_map.metrics.figures.rows import Figure, find_rows
from sfr_loc_map.metrics.score.verdict import counts_of
from sfr_loc_map.metrics.stored.score_json import json_line
from sfr_loc_map.report.page import render_overview, render_page
from sfr_loc_map.report.plots import Plot, Values, axis, error_scale, largest, log_axis, marks, plain, scaled, span
from sfr_loc_map.report.summary import Banner
from sfr_loc_map.suite.pages.export import write_parquet
from sfr_loc_map.suite.pages.tables import FIRST_TABLES, PAGES, linked, suite_tables
from sfr_loc_map.suite.statistics.budget import Budget
from sfr_loc_map.suite.statistics.summary import Summary
from sfr_loc_map.suite.store import Store

GROUPS = "groups, by their number in the table"


def write_summary(summary: Summary, store: Store) -> None:
    """Write `suite.json`, `report.html`, the pages of the worst results and, with pyarrow, `results.parquet`."""
    folder = store.folder
    (folder / PAGES).mkdir(exist_ok=True)
    texts = {"suite.json": json_line(summary.to_dict()), "report.html": render_summary(summary)}
    texts |= {f"{PAGES}/{result.job.key}.html": render_page(result.score, plots=False) for result in linked(summary)}
    for name, text in texts.items():
        write_text(text, folder / name)
    write_parquet(summary, folder / "results.parquet")


def render_summary(summary: Summary) -> str:
    """Return the page of a suite as HTML."""
    text = f"{counts_of(summary.on_limits).text}; " if summary.on_limits else ""
    text += summary.counts.text
    text += f", {len(summary.refusals)} sources refused." if summary.refusals else "."
    sections = [("Error budget", [budget_plot(budget)]) for budget in summary.budgets[:1]]
    if plots := _error_plots(summary):
        sections.append(("Errors", plots))
    banner = Banner.of(summary.verdict, text)
    return render_overview("Suite", banner, suite_tables(summary), sections, FIRST_TABLES)


def _error_plots(summary: Summary) -> list[Plot]:
    # groups are labelled by their number in the table `groups`, so that no user text is in the plot
    numbers = {group.key: n for n, group in enumerate(summary.groups, 1)}
    each = [(numbers[result.job.group], result.position_m) for result in summary.results if result.position_m]
    each.sort(key=itemgetter(0))
    if not each:
        return []
    firsts = ((number, first_position(group.figures)) for number, group in enumerate(summary.groups, 1))
    pooled = [(number, row.mean_plus_3sigma) for number, row in firsts if row is not None]
    factor, unit = error_scale(largest([value for _, value in each]))
    traces = [
        marks("one result", _columns(each, factor), "@one", size=6),
        marks("all drives, pooled", _columns(pooled, factor), "@two", symbol="line-ew-open", size=22),
    ]
    sizes = span([value * factor for _, value in each + pooled if value is not None])
    layout = {"xaxis": axis(GROUPS, dtick=1), "yaxis": log_axis(f"position, mean + 3 sigma, {unit}", *sizes)}
    caption = (
        "Errors of each result, and of the pooled sub-trajectories of all drives, for the first condition. The pooled "
        "value contains the differences between the drives and may therefore exceed the values of all results."
    )
    return [Plot("suite-errors", "Position error by group", caption, traces, layout, width="full")]


def budget_plot(budget: Budget) -> Plot:
    """Return the fractions of an error budget as bars, the largest source first."""
    rows = sorted(budget.rows, key=lambda row: -(row.alone.value or 0.0))
    names = [plain(row.source) for row in rows]
    traces = []
    for name, color, figures in (
        ("alone", "@one", [row.alone for row in rows]),
        ("removed", "@two", [row.removed for row in rows]),
    ):
        values = scaled([figure.value for figure in figures], 100.0)
        above = [None if figure.ci95 is None else 50.0 * (figure.ci95[1] - figure.ci95[0]) for figure in figures]
        bars = {"type": "data", "array": above, "visible": None not in above}
        bar = {"type": "bar", "name": name, "x": names, "y": values, "error_y": bars, "marker": {"color": color}}
        traces.append(bar)
    layout = {"xaxis": axis("", type="category"), "yaxis": axis("fraction of the mean square, %")}
    caption = "Fraction caused by each source of error alone, and fraction that vanishes without it; 95 % intervals."
    return Plot("budget", "Error budget", caption, traces, layout, height=460, width="full")


def first_position(figures: tuple[Figure, ...]) -> Figure | None:
    """Return the position error of the first condition; None if there is none."""
    return next(find_rows(figures, "position"), None)


def _columns(rows: Sequence[tuple[int, float | None]], factor: float = 1.0) -> list[Values]:
    return [[x for x, _ in rows], scaled([y for _, y in rows], factor)]

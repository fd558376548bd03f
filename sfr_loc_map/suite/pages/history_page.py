"""Table and page of a history."""

from __future__ import annotations

from sfr_loc_map.report.page import render_overview
from sfr_loc_map.report.plots import Plot, axis, marks
from sfr_loc_map.report.summary import Banner
from sfr_loc_map.suite.history.history import Change, History
from sfr_loc_map.suite.history.shifts import MIN_REFERENCE
from sfr_loc_map.tables.model import Table
from sfr_loc_map.tables.typed import RowColumn, heads, intervals, numbers, table_of, words

NAMED = 5  #: Maximum number of jobs that are named for a change.


def _changed_jobs(change: Change) -> str:
    count = f"{len(change.jobs)} of {change.of}"
    if len(change.jobs) == change.of:
        return count
    more = ", ..." if len(change.jobs) > NAMED else ""
    return f"{count}: {', '.join(change.jobs[:NAMED])}{more}"


HISTORY: tuple[RowColumn[Change], ...] = (
    heads("since", lambda row: row.since),
    words("commits", lambda row: row.range),
    words("figure", lambda row: row.figure),
    words("is", lambda row: row.kind_of_change),
    words("jobs", _changed_jobs),
    numbers("before", lambda row: row.before),
    numbers("after", lambda row: row.after),
    numbers("ratio", lambda row: row.ratio),
    intervals("95 % interval", lambda row: row.ci95),
    words("see", lambda row: row.command),
)


def history_table(history: History) -> Table:
    """Return the table of a history: every change of a figure."""
    note = (
        f"Nights (runs of the suite): {len(history.nights)}. Before and after: means over the named jobs. Without "
        f"changes, at most one night in {1.0 / history.false_alarm_rate:g} gives an alarm."
    )
    if len(history.nights) <= MIN_REFERENCE:
        note += f" With fewer than {MIN_REFERENCE + 1} nights, only changes of most jobs are detected."
    if history.without_result:
        note += f" Jobs of the last night without a result: {', '.join(history.without_result)}."
    if history.shortage:
        note += f" Not judged: {history.shortage}."
    title = "No figure changed" if history.tested and not history.changes else "Changes"
    return table_of("history", title, HISTORY, history.changes, note)


def render_history(history: History) -> str:
    """Return the page of a history as HTML."""
    worse = [change.text for change in history.worse]
    worse += [f"{label} has no result in the last night" for label in history.without_result]
    heading, text = "worse", "; ".join(worse)  # not a verdict, because no limit is judged
    if not worse and history.shortage:
        heading, text = "not judged", history.shortage
    elif not worse:
        heading, text = "not worse", "No figure is certainly worse than before."
    plots, caption = [], "Geometric mean over the jobs; arithmetic mean for counts."
    for number, (figure, values) in enumerate(history.figures.items()):
        trace = marks("all jobs", [[*range(1, len(values) + 1)], [*values]], "@one")
        layout = {"xaxis": axis("night"), "yaxis": axis(figure)}
        plots.append(Plot(f"history-{number}", figure, caption, [trace], layout))
    banner = Banner.without_verdict(heading, text)
    return render_overview("History of suites", banner, [history_table(history)], [("Figures", plots)])

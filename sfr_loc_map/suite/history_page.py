"""The page of a history: a figure of each kind over the runs, with intervals, and the table."""

from __future__ import annotations

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.report.page import render_overview
from sfr_loc_map.report.plots import Plot, axis, marks
from sfr_loc_map.suite.comparison_tables import history_tables
from sfr_loc_map.suite.history import History, HistoryPoint


def render_history(history: History) -> str:
    """Return the page as HTML."""
    worse = "; ".join(f"{kind}: {run}" for kind, run in history.first_worse.items())
    state = VerdictState.FAIL if worse else VerdictState.PASS
    text = f"First that is certainly worse: {worse}." if worse else "No run is certainly worse than its baseline."
    figures = list(dict.fromkeys(point.figure for point in history.points))
    plots = [_plot(number, name, history) for number, name in enumerate(figures)]
    return render_overview("History of suites", state, text, history_tables(history), [("Figures", plots)])


def _plot(number: int, figure: str, history: History) -> Plot:
    points = [point for point in history.points if point.figure == figure]
    order = {name: float(position) for position, name in enumerate(history.runs)}
    rows = ([order[point.run] for point in points], [_short(point.ratio) for point in points])
    trace = marks("over baseline", rows, "@one")
    low, high = ([_short(abs(bound - point.ratio)) for point, bound in _bounds(points, side)] for side in (0, 1))
    trace["error_y"] = {"type": "data", "symmetric": False, "array": high, "arrayminus": low}
    layout = {"xaxis": axis("run, in the order of the table", dtick=1), "yaxis": axis("over baseline")}
    return Plot(f"history-{number}", figure, "Geometric mean over the drives, 95 % interval.", [trace], layout)


def _bounds(points: list[HistoryPoint], side: int) -> list[tuple[HistoryPoint, float]]:
    return [(point, point.ratio if point.ci95 is None else point.ci95[side]) for point in points]


def _short(value: float) -> float:
    return float(f"{value:.6g}")

"""Several methods on one page: a row per method, the provenance of their scores, and common plots."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import KINDS, OF_CALLS, TOTAL, FigureKind, statistic_title, title_of
from sfr_loc_map.metrics.figures.row_part import ANY
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import Statistics
from sfr_loc_map.metrics.judging.incomplete import strictly_missing
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report import plots
from sfr_loc_map.report.comparison import optional_cell
from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.report.drive_plots import growth
from sfr_loc_map.report.plotted_data import errors_by_range, path_errors, path_of
from sfr_loc_map.report.score_tables import UNNAMED, convention_text
from sfr_loc_map.report.summary import banner_of
from sfr_loc_map.report.verdict_view import verdict_cell
from sfr_loc_map.suite_names import Task
from sfr_loc_map.tables.model import (
    ABSENT,
    MARKS,
    MIB,
    MILLISECOND,
    PERCENT,
    Cell,
    Column,
    Row,
    Table,
    Unit,
    fitting,
    number,
)

MAX_LETTERS = 60  #: Maximum length of a name in a legend.
Named = Sequence[tuple[str, Score]]
"""Scores with the names of their methods."""


CALL_OF = {Task.LOCALISATION: CallKind.LOCALISATION, Task.MAPPING: CallKind.MAPPING_CALL}
"""The call of each task whose time and memory the specification defines [4.2.1, 4.3.1]. Stages are not compared."""
SUBJECT_OF = {Task.LOCALISATION: Subject.TRAJECTORY, Task.MAPPING: Subject.MAP}
"""Subject of the errors of each task."""


class MethodColumn(NamedTuple):
    """A column of the table of methods."""

    column: Column
    cell_of: Callable[[Score], Cell]
    is_marked: bool = True  #: Whether the best and the worst value are marked; columns of words have no marks.
    is_better_if_larger: bool = False


# ---- tables of methods


def methods_tables(scores: Sequence[Score], names: Sequence[str]) -> list[Table]:
    """Return the tables of several methods: a row per method, and the provenance of each score."""
    named = list(zip(names, scores, strict=True))
    return [_methods(named), _deviations(named), _provenance(named)]


def _cells_of(shown: MethodColumn, scores: Sequence[Score]) -> list[Cell]:
    """Return the cells of a column with marks on the best and the worst value of the ranked methods."""
    cells = [shown.cell_of(score) for score in scores]
    if not shown.is_marked:
        return cells
    return _marked(cells, [is_ranked(score) for score in scores], larger_is_better=shown.is_better_if_larger)


def _marked(cells: list[Cell], is_ranked: list[bool], *, larger_is_better: bool) -> list[Cell]:
    shown = [
        float(f"{cell.value:.4g}") if ranked and isinstance(cell.value, (int, float)) else None
        for cell, ranked in zip(cells, is_ranked, strict=True)
    ]
    known = [value for value in shown if value is not None]
    if len(set(known)) < 2:  # values that are equal in all displayed digits are not marked
        return cells
    best, worst = (max(known), min(known)) if larger_is_better else (min(known), max(known))
    marks: dict[object, str] = {best: "best", worst: "worst"}
    return [replace(cell, mark=marks.get(value, "")) for cell, value in zip(cells, shown, strict=True)]


def _methods(named: Named) -> Table:
    """Return a table with a row per method: verdict, kind, errors, frames, coverage, times, memory and findings."""
    condition = compared_condition([score for _, score in named])
    ordered = sorted(named, key=lambda item: rank_of(item[1], condition))
    scores = [score for _, score in ordered]
    shown = [
        MethodColumn(Column("verdict", words=True), _verdict, is_marked=False),
        MethodColumn(Column("kind", words=True), _kind, is_marked=False),
        *_error_columns([score for _, score in named], condition),
        *_frame_columns(scores),
        *_coverage_columns(scores),
        *_time_columns(scores),
        *_memory_columns(scores),
        MethodColumn(Column("findings"), _finding_count),
    ]
    columns = [_cells_of(column, scores) for column in shown]
    rows = tuple((Cell.head(name), *cells) for (name, _), *cells in zip(ordered, *columns, strict=True))
    note = (
        "Errors: mean + 3 sigma, with its 95 % interval. Time: per call of the task. A latency is "
        "marked: it includes transport and queueing, unlike a time per call. Memory: largest peak. "
        f"{MARKS['best']} best, {MARKS['worst']} worst of the column, among the methods that have not failed, have no "
        "missing results and agree with the convention of the truth. The other methods follow them."
    )
    heads = (Column("method", words=True), *(item.column for item in shown))
    return Table("methods", "Methods", heads, rows, note)


def _deviations(named: Named) -> Table:
    """Return a table with a row per deviation of judged scores, and the methods that have this deviation."""
    names: dict[str, list[str]] = {}
    for name, score in named:
        for text in deviations_of(score) if score.is_judged else ():
            names.setdefault(text, []).append(name)
    rows = tuple((Cell.head(printable(text)), Cell(", ".join(of))) for text, of in names.items())
    columns = (Column("deviation", words=True), Column("methods", words=True))
    return Table("deviations", "Deviations of the judged scores", columns, rows)


def _error_columns(scores: Sequence[Score], condition: str) -> Iterator[MethodColumn]:
    """Yield the compared statistics of the figures whose mean + 3 sigma is compared, each in one unit."""
    firsts = {row.figure: row for score in scores for row in compared_rows(score, condition)}
    for figure, first in firsts.items():
        kind = KINDS[figure]
        over = f" over {label_of(first.condition)}" if first.condition else ""
        title = f"{title_of(figure)}{over}"
        rows = [row for score in scores if (row := compared_row(score, kind, condition)) is not None]
        for statistic in kind.compared:
            unit = fitting(Unit(first.unit), *(row.statistic(statistic) for row in rows))
            words = title if statistic == TOTAL else f"{title}, {statistic_title(statistic)}"
            cell_of = partial(_figure_cell, kind=kind, condition=condition, statistic=statistic, unit=unit)
            yield MethodColumn(Column(words, unit), cell_of, is_better_if_larger=kind.is_better_if_larger)


def _frame_columns(scores: Sequence[Score]) -> Iterator[MethodColumn]:
    if any(score.association is not None for score in scores):
        yield MethodColumn(Column("frames"), partial(_frames, name="matched"), is_marked=False)
        yield MethodColumn(Column("lost"), partial(_frames, name="lost"))


def _coverage_columns(scores: Sequence[Score]) -> Iterator[MethodColumn]:
    if any(score.has(Subject.MAP) for score in scores):
        larger = KINDS["coverage"].is_better_if_larger
        yield MethodColumn(Column("coverage", PERCENT), _coverage, is_better_if_larger=larger)


def _time_columns(scores: Sequence[Score]) -> Iterator[MethodColumn]:
    for task in Task:
        if any(score.figure(CALL_OF[task], part=None) or _latency(score, task) for score in scores):
            for statistic in OF_CALLS:
                times = partial(_time, task=task, statistic=statistic)
                yield MethodColumn(Column(f"{task} time {statistic}", MILLISECOND), times)


def _memory_columns(scores: Sequence[Score]) -> Iterator[MethodColumn]:
    for task in Task:
        if any(score.number("peak", part=CALL_OF[task]) is not None for score in scores):
            yield MethodColumn(Column(f"{task} memory", MIB), partial(_peak, task=task))


def _verdict(score: Score) -> Cell:
    state = banner_of(score).state
    return verdict_cell(f"{state}, partial" if score.is_judged and score.active_rules.partial else state)


def _kind(score: Score) -> Cell:
    return Cell(ABSENT if score.method is None else score.method.kind.value)


def _coverage(score: Score) -> Cell:
    return optional_cell(score.number("coverage"), PERCENT)


def _finding_count(score: Score) -> Cell:
    return Cell.number(sum(item.count for item in score.findings))


def compared_condition(scores: Sequence[Score]) -> str:
    """Return the condition over which errors are compared: the first condition that all scores of trajectories have.

    Without a common condition, the first condition of the first score is returned; `ANY` if no score has a condition.
    """
    conditions = [score.conditions for score in scores if score.conditions]
    if not conditions:
        return ANY
    first, *others = conditions
    return next((condition for condition in first if all(condition in other for other in others)), first[0])


def compared_rows(score: Score, condition: str) -> list[Figure]:
    """Return the errors by which methods are compared: the judged errors over a condition."""
    kinds = [kind for kind in KINDS.values() if TOTAL in kind.compared]
    rows = (compared_row(score, kind, condition) for kind in kinds)
    return [row for row in rows if row is not None]


def compared_row(score: Score, kind: FigureKind, condition: str) -> Figure | None:
    """Return the judged row of a figure, for the trajectory over a condition."""
    over = condition if kind.subject is Subject.TRAJECTORY else ANY
    return score.judged_row(kind.name, subject=kind.subject, condition=over)


def is_ranked(score: Score) -> bool:
    """Return whether a method has results of its complete task, so that its figures can be marked as the best."""
    return strictly_missing(score) is None and score.contradiction is None and not score.fatal_findings


def rank_of(score: Score, condition: str) -> tuple[bool, bool, float]:
    """Return the sort key of a method: mean + 3 sigma of the position or point error.

    Methods without errors are last, after those that are not ranked.
    """
    error = next((row.mean_plus_3sigma for row in compared_rows(score, condition)), None)
    return error is None, not is_ranked(score), error or 0.0


def _figure_cell(score: Score, kind: FigureKind, condition: str, statistic: str, unit: Unit) -> Cell:
    row = compared_row(score, kind, condition)
    value = None if row is None else row.statistic(statistic)
    if row is None or value is None:
        return Cell(ABSENT)
    has_interval = statistic == TOTAL and row.interval is not None
    interval = f" ({Cell.interval(row.interval, unit=unit).text})" if has_interval else ""
    return Cell(number(value, unit=unit) + interval, value)


def _frames(score: Score, name: str) -> Cell:
    return optional_cell(None if score.association is None else getattr(score.association, name))


def _time(score: Score, task: Task, statistic: str) -> Cell:
    row = score.figure(CALL_OF[task], part=None)
    latency = _latency(score, task)
    if row is None and latency is not None:
        return Cell(f"latency {number(getattr(latency, statistic), unit=MILLISECOND)}")  # not ranked: no time per call
    return optional_cell(None if row is None else row.statistic(statistic), MILLISECOND)


def _latency(score: Score, task: Task) -> Statistics | None:
    """Return the latency of an external node that has the task."""
    node = score.external
    return node.latency_s if node is not None and node.task == task else None


def _peak(score: Score, task: Task) -> Cell:
    return optional_cell(score.number("peak", part=CALL_OF[task]), MIB)


def _provenance(named: Named) -> Table:
    rows: list[Row] = []
    for name, score in named:
        method, origin = score.method, score.provenance
        inputs = {} if origin is None else origin.inputs
        own = inputs.get("estimate") or inputs.get("cloud")
        texts = (
            UNNAMED if method is None else f"{method.name} {method.version or ''}".strip(),
            convention_text(score) or ABSENT,
            ABSENT if own is None else own.path,
            ABSENT if own is None else own.sha256[:16],
            UNNAMED if origin is None else f"sfr_loc_map {origin.version}",
            UNNAMED if origin is None else origin.time or UNNAMED,
        )
        rows.append((Cell.head(name), *map(Cell, texts)))
    titles = ("method", "name and version", "poses converted", "estimate or cloud", "sha256", "scored by", "time")
    columns = tuple(Column(title, words=True) for title in titles)
    return Table("provenance", "Provenance of the scores", columns, tuple(rows))


# ---- plots of methods


def methods_plots(scores: Sequence[Score], names: Sequence[str]) -> list[tuple[str, list[plots.Plot]]]:
    """Return the plots by heading for which the scores have data."""
    named = [(plots.plain(name[:MAX_LETTERS]), score) for name, score in zip(names, scores, strict=True)]
    groups = (
        ("Localisation", [*_paths(named), *growth(named)]),
        ("Cost against accuracy", [plot for task in Task for plot in _cost(named, task)]),
        ("Maps", _over_range(named)),
    )
    return [(title, group) for title, group in groups if group]


def _paths(named: Named) -> list[plots.Plot]:
    paths = [(k, name, path_of(score)) for k, (name, score) in enumerate(named)]
    known = [
        (plots.line_style(k), name, path, path_errors(path)[-1])
        for k, name, path in paths
        if path is not None and path.stamp_ns
    ]
    if not known:
        return []
    longest = max((path for _, _, path, _ in known), key=lambda path: len(path.stamp_ns))
    above: list[plots.Trace] = [plots.line("truth", (longest.truth_x_m, longest.truth_y_m), "@truth", width=3)]
    errors: list[plots.Trace] = []
    factor, unit = plots.error_scale(plots.largest(*(size for *_, size in known)))
    for style, name, path, size in known:
        above.append(plots.line(name, (path.estimate_x_m, path.estimate_y_m), width=1.5, **style))
        errors.append(plots.line(name, (path.travelled_m, plots.scaled(size, factor)), **style))
    upright = plots.axis(f"size of estimate - truth, {unit}", rangemode="tozero")
    over = {"xaxis": plots.axis(plots.TRAVELLED), "yaxis": upright}
    caption = "Since the first frame, without re-basing."
    return [
        plots.Plot(
            "paths", "Trajectories from above", "Equal axes.", above, plots.from_above(), height=560, width="full"
        ),
        plots.Plot("errors", "Accumulated position error", caption, errors, over),
    ]


class _CostPoint(NamedTuple):
    """Median time and error of a method."""

    name: str
    time_ms: float
    error_mm: float
    is_latency: bool  #: Whether the time is a latency, because the times of the calls are unknown.
    number: int  #: Index of the method, which determines colour and mark.


def _cost_points(named: Named, task: Task, condition: str) -> Iterator[_CostPoint]:
    """Yield the methods that have a time and an error for a task."""
    for k, (name, score) in enumerate(named):
        seconds, latency = score.number(CALL_OF[task], "p50", part=None), _latency(score, task)
        is_latency = False
        if seconds is None and latency is not None:
            seconds = latency.p50
            is_latency = True
        rows = [row for row in compared_rows(score, condition) if row.subject is SUBJECT_OF[task]]
        error = rows[0].mean_plus_3sigma if rows else None
        if seconds and error:
            yield _CostPoint(name, 1e3 * seconds, 1e3 * error, is_latency, k)


def _cost(named: Named, task: Task) -> list[plots.Plot]:
    """Return the plot of the error over the median time of a task; empty without data."""
    condition = compared_condition([score for _, score in named])
    points = list(_cost_points(named, task, condition))
    if not points:
        return []
    data = []
    for point in points:
        color = plots.line_style(point.number)["color"]
        symbol = plots.SYMBOLS[point.number // len(plots.COLORS) % len(plots.SYMBOLS)]
        label = point.name
        if point.is_latency:
            label, symbol = f"{label} (latency)", f"{symbol}-open"
        place = ([point.time_ms], [point.error_mm])
        data.append(plots.marks(label, place, color, symbol=symbol, size=13, showlegend=True))
    what = f"position error over {label_of(condition)}" if task is Task.LOCALISATION else "point error"
    times, errors = [point.time_ms for point in points], [point.error_mm for point in points]
    layout = {
        "xaxis": plots.log_axis("median time of a call, ms", *plots.span(times)),
        "yaxis": plots.log_axis(f"{what}, mean + 3 sigma, mm", *plots.span(errors)),
    }
    caption = "Lower left is better. Open marks: latency over topics, which includes transport and queueing."
    title = f"Cost against accuracy: {task}"
    return [plots.Plot(f"cost-{task}", title, caption, data, layout, width="full", height=440)]


def _over_range(named: Named) -> list[plots.Plot]:
    data, values = [], []
    for k, (name, score) in enumerate(named):
        known = [(low, high, 1e3 * row.p50) for low, high, row in errors_by_range(score) if row.p50 is not None]
        values += [value for *_, value in known]
        if known:
            levels = [([low, high], plots.scaled([value] * 2, 1.0)) for low, high, value in known]
            data.append(plots.line(name, plots.segments(levels), width=3, **plots.line_style(k)))
    if not data:
        return []
    layout = {
        "xaxis": plots.axis("range from the left camera, m"),
        "yaxis": plots.log_axis("median point error, mm", *plots.span(values)),
    }
    return [plots.Plot("map-ranges", "Point error over range", "Median of each range.", data, layout, width="full")]


def names_of(paths: Sequence[Path], scores: Sequence[Score]) -> list[str]:
    """Return the names of the methods if they differ, otherwise the names or paths of the files."""
    methods = [score.method.name.rpartition("/")[2] for score in scores if score.method is not None]
    for names in (methods, [path.name for path in paths], [str(path) for path in paths]):
        if len(set(names)) == len(paths):
            return names
    return [f"{position}: {path}" for position, path in enumerate(paths, 1)]

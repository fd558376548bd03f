"""Comparison of several scores of the same data on one page: paired differences, a row per method, common plots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.metrics.catalogue import KINDS, OF_CALLS, TOTAL, Subject, statistic_title, title_of
from sfr_loc_map.metrics.comparison import SIGNIFICANT, Comparison, SideBySide
from sfr_loc_map.metrics.config import CallKind, label_of
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.report import plots
from sfr_loc_map.report.plotted_data import errors_by_range, path_errors, path_of
from sfr_loc_map.report.score_plots import growth
from sfr_loc_map.report.score_tables import UNNAMED, convention_text, row_title
from sfr_loc_map.report.summary import overall_of
from sfr_loc_map.report.tables import ABSENT, MARKS, MIB, NONE, PERCENT, Cell, Column, Row, Table, Unit, fitting, number

MAX_LETTERS = 60  #: Maximum length of a name in a legend.
NEUTRAL = ("frames",)  #: Columns without a best and a worst figure.
FIRST_TABLES = ("pairs", "methods")  #: Tables above the plots of a page.
Named = Sequence[tuple[str, Score]]


class Task(NamedTuple):
    """A task of the document with the kind of its call and the subject of its errors."""

    name: str  #: Name in the options of external nodes.
    call: CallKind
    subject: Subject


TASKS = (
    Task("localisation", CallKind.LOCALISATION, Subject.TRAJECTORY),
    Task("mapping", CallKind.MAPPING_CALL, Subject.MAP),
)
"""Tasks whose time and memory the document defines [4.2.1, 4.3.1]. Stages of a mapping call are not tasks."""


def comparison_tables(result: Comparison) -> list[Table]:
    """Return the tables of a comparison: pairs of sub-trajectories, complete runs side by side."""
    names, tables = result.names, []
    if result.pairs:
        rows: list[Row] = []
        for pair in result.pairs:
            unit = fitting(Unit(pair.unit), pair.first, pair.other)
            row = (
                Cell.head(f"{title_of(pair.figure)}, {unit.symbol}, over {label_of(pair.condition)}"),
                Cell(pair.name),
                _cell(pair.first, unit),
                _cell(pair.other, unit),
                _cell(pair.difference, unit, signed=True),
                Cell.interval(pair.ci95, unit=unit, signed=True),
                Cell.number(pair.count),
                _cell(pair.p_corrected),
                Cell(pair.outcome.value),
            )
            rows.append(row)
        titles = (names[0], "other", "difference", "95 % interval", "n", "p, corrected")
        words = (Column(title, words=True) for title in ("figure", "method", "outcome"))
        columns = (next(words), next(words), *map(Column, titles), next(words))
        title = f"Mean + 3 sigma, compared with {names[0]}, paired by sub-trajectory"
        note = f"A method is better or worse if p is at most {SIGNIFICANT} and the interval excludes zero. "
        note += f"p: p-value of the difference, corrected for {len(result.pairs)} comparisons (Holm)."
        tables.append(Table("pairs", title, columns, tuple(rows), note))
    if result.side_by_side:
        title = "Complete runs side by side (not paired, without an interval)"
        columns = (Column("figure", words=True), Column("unit", words=True), *map(Column, names))
        whole = []
        for item in result.side_by_side:
            unit = _whole_run_unit(item)
            name = Cell.head(item.figure.replace("_plus_3sigma", " + 3 sigma").replace("_", " "))
            whole.append((name, Cell(unit.symbol), *(_cell(value, unit) for value in item.values)))
        tables.append(Table("runs", title, columns, tuple(whole)))
    return tables


def _whole_run_unit(item: SideBySide) -> Unit:
    if item.unit == "bytes":
        return MIB
    if item.unit == "1":
        name = item.figure.partition(" ")[0]
        return NONE if KINDS[name].is_count else PERCENT
    return fitting(Unit(item.unit), *item.values)


def _cell(value: float | int | None, unit: Unit = NONE, *, signed: bool = False) -> Cell:
    return Cell.number(value, unit=unit, undefined=ABSENT, signed=signed)


def summary_of(result: Comparison) -> tuple[str, str]:
    """Return a heading and a text that compare the other scores with the reference, worse scores first."""
    outcomes: dict[str, dict[str, list[str]]] = {}  # figures by name of the score and outcome
    for pair in result.pairs:
        figures = outcomes.setdefault(pair.name, {}).setdefault(pair.outcome.value, [])
        figures.append(f"{pair.figure} over {label_of(pair.condition)}")
    sentences = []
    for name, found in sorted(outcomes.items(), key=lambda item: "worse" not in item[1]):
        differences = [f"{word} in {', '.join(found[word])}" for word in ("worse", "better") if word in found]
        sentences.append(f"{name}: {'; '.join(differences) or 'no difference is certain'}.")
    counts = {word: sum(word in found for found in outcomes.values()) for word in ("worse", "better")}
    heading = ", ".join(f"{count} of {len(outcomes)} {word}" for word, count in counts.items() if count)
    sentences.append(f"{len(result.names)} scores of the same data; the reference is {result.names[0]}.")
    return heading or "no difference", " ".join(sentences)


# ---- tables of methods


def methods_tables(scores: Sequence[Score], names: Sequence[str]) -> list[Table]:
    """Return the tables of several methods: a row per method, and the provenance of each score."""
    named = list(zip(names, scores, strict=True))
    return [_methods(named), _provenance(named)]


def _marked(column: Column, cells: list[Cell]) -> list[Cell]:
    """Mark the best and the worst figure of a column."""
    if column.words or column.title in NEUTRAL:
        return cells
    shown = [float(f"{cell.value:.4g}") if isinstance(cell.value, (int, float)) else None for cell in cells]
    known = [value for value in shown if value is not None]
    if len(set(known)) < 2:  # values that are equal in all displayed digits are not marked
        return cells
    best, worst = (max(known), min(known)) if column.title == "coverage" else (min(known), max(known))
    marks: dict[object, str] = {best: "best", worst: "worst"}
    return [replace(cell, mark=marks.get(value, "")) for cell, value in zip(cells, shown, strict=True)]


def _methods(named: Named) -> Table:
    """Return a table with a row per method; its columns are the compared figures of the catalogue, first condition."""
    shown: list[tuple[Column, Callable[[Score], Cell]]] = [
        (Column("verdict", words=True), lambda score: Cell.verdict(overall_of(score).state)),
        (Column("kind", words=True), lambda score: Cell(ABSENT if score.method is None else score.method.kind.value)),
    ]
    compared = {row.figure: row for _, score in named for row in compared_rows(score)}
    for figure, first in compared.items():
        title = row_title(first).partition(",")[0]
        for statistic in KINDS[figure].compared:
            unit = fitting(Unit(first.unit), *(_compared_number(score, figure, statistic) for _, score in named))
            words = title if statistic == TOTAL else f"{title}, {statistic_title(statistic)}"
            shown.append((Column(words, unit), _figure_cell(figure, statistic, unit)))
    if any(score.association is not None for _, score in named):
        shown.append((Column("frames"), partial(_frames, name="matched")))
        shown.append((Column("lost"), partial(_frames, name="lost")))
    if any(score.has(Subject.MAP) for _, score in named):
        shown.append((Column("coverage", PERCENT), lambda score: _cell(score.number("coverage"), PERCENT)))
    shown += [
        *((Column(f"time {name}", Unit("ms")), partial(_times, statistic=name)) for name in OF_CALLS),
        (Column("memory", Unit("MiB")), _peaks),
        (Column("findings"), lambda score: Cell.number(sum(item.count for item in score.findings))),
    ]
    ordered = sorted(named, key=lambda item: rank_of(item[1]))
    columns = [_marked(column, [cell_of(score) for _, score in ordered]) for column, cell_of in shown]
    rows_of_all = tuple((Cell.head(name), *cells) for (name, _), *cells in zip(ordered, *columns, strict=True))
    note = (
        "Errors: mean + 3 sigma, with its 95 % interval. Time per call: localisation / mapping call. A latency "
        "is marked: it includes transport and queueing, unlike a time per call. Memory: largest peak. "
        f"{MARKS['best']} best, {MARKS['worst']} worst of the column."
    )
    heads = (Column("method", words=True), *(column for column, _ in shown))
    return Table("methods", "Methods", heads, rows_of_all, note)


def compared_rows(score: Score) -> list[Figure]:
    """Return the errors by which methods are compared: the judged errors over the first condition."""
    errors = [kind for kind in KINDS.values() if TOTAL in kind.compared]
    rows = (score.judged_row(kind.name, subject=kind.subject) for kind in errors)
    return [row for row in rows if row is not None]


def rank_of(score: Score) -> tuple[bool, float]:
    """Return the sort key of a method: mean + 3 sigma of the position or point error; methods without errors last."""
    error = next((row.mean_plus_3sigma for row in compared_rows(score)), None)
    return error is None, error or 0.0


def _compared_number(score: Score, figure: str, statistic: str) -> float | None:
    row = score.judged_row(figure)
    return None if row is None else row.statistic(statistic)


def _figure_cell(figure: str, statistic: str, unit: Unit) -> Callable[[Score], Cell]:
    def cell_of(score: Score) -> Cell:
        row, value = score.judged_row(figure), _compared_number(score, figure, statistic)
        if row is None or value is None:
            return Cell(ABSENT)
        has_interval = statistic == TOTAL and row.interval is not None
        interval = f" ({Cell.interval(row.interval, unit=unit).text})" if has_interval else ""
        return Cell(number(value, unit=unit) + interval, value)

    return cell_of


def _frames(score: Score, name: str) -> Cell:
    return _cell(None if score.association is None else getattr(score.association, name))


def _times(score: Score, statistic: str) -> Cell:
    rows = [score.figure(task.call, part=None) for task in TASKS]
    latency = None if score.external is None else score.external.latency_s
    if latency is not None and not any(rows):
        seconds = getattr(latency, statistic)
        return Cell(f"latency {number(seconds, unit=Unit('ms'))}")
    return _joined([None if row is None else row.statistic(statistic) for row in rows], Unit("ms"))


def _peaks(score: Score) -> Cell:
    return _joined([score.number("peak", part=task.call) for task in TASKS], Unit("MiB"))


def _joined(numbers: Sequence[float | None], unit: Unit) -> Cell:
    values = [value for value in numbers if value is not None]
    text = " / ".join(number(value, unit=unit) for value in values)
    return Cell(text or ABSENT, values[0] if len(values) == 1 else None)


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
        ("Cost against accuracy", [plot for task in TASKS for plot in _cost(named, task)]),
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


def _cost(named: Named, task: Task) -> list[plots.Plot]:
    data, times, errors = [], [], []
    for k, (name, score) in enumerate(named):
        seconds, node = score.number(task.call, "p50", part=None), score.external
        is_latency = seconds is None and node is not None and node.task == task.name
        if is_latency and node is not None and node.latency_s is not None:
            seconds = node.latency_s.p50
        error = next((row.mean_plus_3sigma for row in compared_rows(score) if row.subject is task.subject), None)
        if not seconds or not error:
            continue
        color, symbol = plots.line_style(k)["color"], plots.SYMBOLS[k // len(plots.COLORS) % len(plots.SYMBOLS)]
        times.append(1e3 * seconds)
        errors.append(1e3 * error)
        label, symbol = (f"{name} (latency)", f"{symbol}-open") if is_latency else (name, symbol)
        data.append(plots.marks(label, ([times[-1]], [errors[-1]]), color, symbol=symbol, size=13, showlegend=True))
    if not data:
        return []
    what = "position error" if task.subject is Subject.TRAJECTORY else "point error"
    layout = {
        "xaxis": plots.log_axis("median time of a call, ms", *plots.span(times)),
        "yaxis": plots.log_axis(f"{what}, mean + 3 sigma, mm", *plots.span(errors)),
    }
    caption = "Lower left is better. Open marks: latency over topics, which includes transport and queueing."
    title = f"Cost against accuracy: {task.name}"
    return [plots.Plot(f"cost-{task.name}", title, caption, data, layout, width="full", height=440)]


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
    return [f"{number}: {path}" for number, path in enumerate(paths, 1)]

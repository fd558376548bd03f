"""The tables of a suite, of a comparison of suites, and of a history."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any

from msgspec.structs import asdict

from sfr_loc_map.metrics.catalogue import KINDS, TOTAL, Subject, statistic_title
from sfr_loc_map.metrics.config import CallKind, VerdictState, label_of
from sfr_loc_map.metrics.row_part import ANY, Scope
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.metrics.verdict import counts_of
from sfr_loc_map.report.tables import (
    ABSENT,
    MIB,
    MILLIMETRE,
    MILLISECOND,
    NONE,
    PERCENT,
    Cell,
    Column,
    Table,
    Unit,
    fitting,
    number,
)
from sfr_loc_map.report.verdict_view import VerdictView
from sfr_loc_map.suite.running.job import SHORT_KEY
from sfr_loc_map.suite.statistics.budget import Budget
from sfr_loc_map.suite.statistics.comparison import SuiteComparison
from sfr_loc_map.suite.statistics.drive_count import DriveCount
from sfr_loc_map.suite.statistics.figures import map_error_of
from sfr_loc_map.suite.statistics.history import MIN_REFERENCE, History
from sfr_loc_map.suite.statistics.summary import ScoredJob, Summary

PAGES = "pages"  #: Folder of the pages of single results, beside the page of the suite.
MAX_PAGES = 200  #: Maximum number of pages of results. `sfr report` makes pages of the other scores.
HEAD, WORDS, INTERVAL, FILE, SHOWN = "head", "words", "interval", "file", "shown"
"""Kinds of columns without a common unit. For `SHOWN`, each row names its unit."""
Columns = tuple[tuple[str, Unit | str, str], ...]
"""Title, unit or kind, and path of keys to the value in a row, joined by dots."""
GROUPS: Columns = (
    ("number", NONE, "number"),
    ("task", HEAD, "task"),
    ("configuration", WORDS, "configuration"),
    ("faults", WORDS, "faults"),
    ("results", NONE, "drives"),
    ("frames", NONE, "matched"),
    ("lost", NONE, "lost"),
)
VERDICTS = (
    *(Column("verdict", words=True), Column("group", words=True), Column("figure", words=True)),
    *(Column("unit", words=True), Column("value"), Column("limit"), Column("margin"), Column("95 % interval")),
    *(Column("of", words=True), Column("n"), Column("drives that miss it"), Column("shown by", words=True)),
)
POOLED: Columns = (
    ("group", HEAD, "group"),
    ("over", WORDS, "over"),
    ("error", WORDS, "error"),
    ("mean", SHOWN, "mean"),
    ("sigma", SHOWN, "sigma"),
    ("mean + 3 sigma", SHOWN, "mean_plus_3sigma"),
    ("95 % interval", INTERVAL, "ci95"),
    ("unit", WORDS, "unit"),
    ("sub-trajectories", NONE, "n"),
    ("drives", NONE, "independent"),
)
OF_DRIVES: tuple[tuple[str, Unit, str, str, str | None], ...] = (
    ("covered", PERCENT, "judged", "value", Scope.DRIVE),
    ("n", NONE, "position", "n", ANY),
    ("lost", NONE, "lost", "value", "count"),
    ("call p95", MILLISECOND, "localisation", "p95", None),
    ("peak", MIB, "peak", "value", CallKind.LOCALISATION),
)
"""Columns of the table of drives, right of those of the compared errors: title, unit, figure, statistic, part."""
BUDGET: Columns = (
    ("source of error", HEAD, "source"),
    ("fraction alone", PERCENT, "alone.value"),
    ("95 % interval", INTERVAL, "alone.ci95"),
    ("fraction removed", PERCENT, "removed.value"),
    ("95 % interval", INTERVAL, "removed.ci95"),
    ("interaction", PERCENT, "interaction.value"),
    ("95 % interval", INTERVAL, "interaction.ci95"),
    ("mean, x", MILLIMETRE, "mean_x"),
    ("mean, y", MILLIMETRE, "mean_y"),
    ("mean, z", MILLIMETRE, "mean_z"),
    ("sigma, x", MILLIMETRE, "sigma_x"),
    ("sigma, y", MILLIMETRE, "sigma_y"),
    ("sigma, z", MILLIMETRE, "sigma_z"),
)
WORKERS: Columns = (
    ("worker", HEAD, "worker"),
    ("host", WORDS, "host"),
    ("version", WORDS, "version"),
    ("code", WORDS, "code"),
    ("jobs done", NONE, "done"),
    ("set aside", WORDS, "set_aside"),
)
FAILURES: Columns = (
    ("job", HEAD, "label"),
    ("cause", WORDS, "cause"),
    ("message", WORDS, "message"),
    ("result", FILE, "key"),
)
COMPARISON: Columns = (
    ("group", HEAD, "runs"),
    ("figure", WORDS, "figure"),
    ("drives", NONE, "drives"),
    ("ratio", NONE, "ratio"),
    ("95 % interval", INTERVAL, "ci95"),
    ("p", NONE, "p"),
    ("p, corrected", NONE, "p_corrected"),
    ("the other is", WORDS, "outcome"),
    ("largest ratio", NONE, "largest"),
    ("at", WORDS, "worst.label"),
)
HISTORY: Columns = (
    ("since", HEAD, "night"),
    ("commits", WORDS, "range"),
    ("figure", WORDS, "figure"),
    ("is", WORDS, "outcome"),
    ("drives", WORDS, "which"),
    ("before", NONE, "before"),
    ("after", NONE, "after"),
    ("ratio", NONE, "ratio"),
    ("95 % interval", INTERVAL, "ci95"),
    ("see", WORDS, "command"),
)
FIRST_TABLES = ("verdicts", "failures", "counts", "groups")  #: Tables above the plots of the page of a suite.
NAMED = 5  #: Maximum number of named drives of a change.


def _table(name: str, title: str, columns: Columns, rows: Iterable[Mapping[str, Any]], note: str = "") -> Table:
    heads = tuple(
        Column(title, kind if isinstance(kind, Unit) else NONE, kind in (HEAD, WORDS, FILE))
        for title, kind, _ in columns
    )
    cells = tuple(tuple(_cell(row, kind, keys) for _, kind, keys in columns) for row in rows)
    return Table(name, title, heads, cells, note)


def _cell(row: Mapping[str, Any], kind: Unit | str, keys: str) -> Cell:
    value: Any = row
    for key in keys.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    text = ABSENT if value in (None, "") else str(value)
    if isinstance(kind, Unit) or kind == SHOWN:
        return Cell.number(value, keys, kind if isinstance(kind, Unit) else row["shown"], ABSENT)
    if kind == INTERVAL:
        return Cell.interval(value, keys, row.get("shown", NONE))
    if kind == HEAD:
        return replace(Cell.head(text), link=row.get("link", ""))
    if kind == FILE:
        return Cell(text[:SHORT_KEY], link="" if text == ABSENT else f"{row.get('folder', 'results')}/{text}.json")
    return Cell(text)


def verdict_table(summary: Summary) -> Table:
    """Return the verdicts over all drives, worst first."""
    verdicts = []
    for place, group in enumerate(summary.groups):
        for row, item in enumerate(group.verdicts):
            view = VerdictView.of(item, f"groups.{place}.verdicts.{row}")
            name = replace(Cell.head(group.key.text), link="suite.json")
            numbers = (view.value, view.limit, view.margin, view.interval, Cell(item.over), view.count)
            shown_by = Cell(ABSENT if item.proof is None else view.confidence)
            head = (Cell.verdict(item.state.value), name, Cell(view.title), Cell(view.unit.symbol or ABSENT))
            verdicts.append((item.state.severity, (*head, *numbers, Cell.number(item.missed_by), shown_by)))
    rows = tuple(cells for _, cells in sorted(verdicts, key=itemgetter(0)))
    note = "Pooled: the sub-trajectories of all drives are one sample. Worst drive: the figure cannot be pooled."
    return Table("verdicts", "Verdicts over all drives", VERDICTS, rows, note)


DECIDED = "the sequential tests decided all limits before this job"


def suite_tables(summary: Summary) -> list[Table]:
    """Return the tables of a suite: verdicts, failures, budgets, counts, pooled errors, maps and drives, workers."""
    groups, pooled = [], []
    for place, group in enumerate(summary.groups, 1):
        head = {"group": group.key.text, "link": "suite.json"}
        row = {**to_plain(group), **head, "number": place, "faults": group.faults or "none"}
        groups.append(row if group.figures else row | {"matched": None, "lost": None})  # maps have no frames
        for figure in group.figures:
            if figure.figure != "chord":
                shown = fitting(Unit(figure.unit), figure.mean_plus_3sigma)
                named = {"over": label_of(figure.condition), "error": figure.figure, "unit": shown.symbol}
                pooled.append(figure.as_dict() | head | named | {"ci95": figure.interval, "shown": shown})
    failures = [to_plain(item) | {"folder": "failures"} for item in summary.failures]
    failures += [{"label": item.path, "cause": "source refused", "message": item.reason} for item in summary.refusals]
    failures += [{"label": label, "cause": "not run", "message": DECIDED} for label in summary.not_run]
    pages = {result.job.key for result in linked(summary)}
    maps = [result for result in summary.results if result.score.has(Subject.MAP)]
    maps.sort(key=lambda result: -map_error_of(result.score))
    counts = {**asdict(summary.counts), "sources refused": len(summary.refusals)}
    of_pooled = "95 % interval of mean + 3 sigma by resampling whole drives; at least five drives are required."
    of_workers = "Workers with different code were excluded and received no jobs."
    of_drives = "Errors over the sub-trajectories of the first condition."
    tables = (
        verdict_table(summary),
        _table("failures", "Jobs without a result", FAILURES, failures),
        *budget_tables(summary.budgets),
        _table("counts", "Jobs", tuple((name, NONE, name) for name in counts), [counts]),
        _table("groups", "Groups", GROUPS, groups, "The results of a group have the same task, configuration, faults."),
        copies_table(summary.copies),
        _table("pooled", "Errors over the sub-trajectories of all drives", POOLED, pooled, of_pooled),
        result_table("maps", "Maps, the worst first", maps, pages, Subject.MAP),
        result_table("drives", "Drives, the worst first", worst_first(summary), pages, Subject.TRAJECTORY, of_drives),
        _table("workers", "Workers", WORKERS, map(to_plain, summary.workers), of_workers),
    )
    return [table for table in tables if table.rows]


def copies_table(copies: Sequence[Sequence[str]]) -> Table:
    """Return the sources that are copies of one drive."""
    columns = (Column("drive", words=True), Column("sources"), Column("copies", words=True))
    rows = tuple((Cell.head(first), Cell.number(1 + len(others)), Cell(", ".join(others))) for first, *others in copies)
    note = (
        "The ground truths of these sources, and their first images if they have images, show one drive. The sources "
        "count as one drive in intervals, tests and numbers of drives. Of their errors, only the largest are pooled."
    )
    return Table("copies", "Sources that are copies of one drive", columns, rows, note)


def budget_tables(budgets: Sequence[Budget]) -> list[Table]:
    """Return a table for each error budget: sources by decreasing fraction, the rest, and the sum."""
    tables = []
    for place, budget in enumerate(budgets, 1):
        rows: list[dict[str, Any]] = []
        for row in sorted(budget.rows, key=lambda row: -(row.alone.value or 0.0)):
            by_axis = [("mean", row.mean_m), ("sigma", row.sigma_m)]
            axes: dict[str, float] = {}
            for name, values in by_axis:
                axes |= {f"{name}_{axis}": value for axis, value in zip("xyz", values or (), strict=False)}
            rows.append(to_plain(row) | axes | {"shown": PERCENT})
        rows.append({"source": "not named in the budget", "alone": to_plain(budget.rest), "shown": PERCENT})
        rows.append({"source": "sum", "alone": to_plain(budget.total), "shown": PERCENT})
        note = (
            f"Fractions of the mean square position error over {label_of(budget.condition)}; {budget.drives} drives, "
            f"{budget.left_out} skipped because a variant has no result. Mean and sigma: effect of the source alone."
        )
        title = f"Error budget, {budget.configuration}: root mean square " + (
            "unknown" if budget.rms_m is None else number(budget.rms_m, unit=MILLIMETRE) + " mm"
        )
        tables.append(_table(f"budget-{place}", title, BUDGET, rows, note))
    return tables


def worst_first(summary: Summary) -> list[ScoredJob]:
    """Return the drives with a trajectory in the order of decreasing mean + 3 sigma of position."""
    drives = [result for result in summary.results if result.score.association is not None]
    return sorted(drives, key=lambda result: -1.0 if result.position_m is None else result.position_m, reverse=True)


def linked(summary: Summary) -> list[ScoredJob]:
    """Return the results that have their own page: the worst drives, and the maps."""
    maps = [result for result in summary.results if result.score.association is None]
    return (worst_first(summary) + maps)[:MAX_PAGES]


def result_table(
    name: str, title: str, drives: Sequence[ScoredJob], pages: set[str], subject: Subject, note: str = ""
) -> Table:
    """Return a table with a row per result: the compared errors over the first condition, and the resources."""
    errors = [kind for kind in KINDS.values() if TOTAL in kind.compared and kind.subject is subject]
    columns = [Column("drive", words=True), Column("group", words=True)]
    for kind in errors:
        named, unit = kind.name.replace("_", " "), shown_unit(kind.unit)
        columns += [Column(f"{named}, {statistic_title(statistic)}", unit) for statistic in kind.compared]
    if subject is Subject.MAP:
        columns.append(Column("coverage", PERCENT))
    else:
        columns += [Column(title, unit) for title, unit, *_ in OF_DRIVES]
    columns += [Column("limits missed"), Column("result", words=True)]
    rows = []
    for result in drives:
        job, score = result.job, result.score
        group = f"{job.group.text}, repeat {job.repeat}" if job.repeat else job.group.text
        link = f"{PAGES}/{job.key}.html" if job.key in pages else ""
        cells = [replace(Cell.head(job.source.name), link=link), Cell(group)]
        for kind in errors:
            values = [score.number(kind.name, statistic) for statistic in kind.compared]
            cells += [Cell.number(value, kind.name, shown_unit(kind.unit), ABSENT) for value in values]
        if subject is Subject.MAP:
            cells.append(Cell.number(score.number("coverage"), "coverage", PERCENT, ABSENT))
        else:
            for _, unit, figure, statistic, part in OF_DRIVES:
                cells.append(Cell.number(score.number(figure, statistic, part=part), figure, unit, ABSENT))
        cells.append(Cell.number(counts_of(score.on_limits).missed))
        cells.append(Cell(job.key[:SHORT_KEY], link=f"results/{job.key}.json"))
        rows.append(tuple(cells))
    return Table(name, title, tuple(columns), tuple(rows), note)


def shown_unit(unit: str) -> Unit:
    """Return the unit in which errors are displayed: mm for errors in m, otherwise the given unit."""
    return MILLIMETRE if unit == "m" else Unit(unit)


def comparison_tables(result: SuiteComparison) -> list[Table]:
    """Return the table of a comparison of suites."""
    rows = [{**to_plain(item), "largest": item.worst.other / item.worst.first} for item in result.figures]
    note = (
        "Ratio: geometric mean over the drives of mean + 3 sigma, or of the cost; below 1 the second suite is better. "
        f"Corrected for {len(result.figures)} comparisons (Holm). Not in both: {result.left_out[0]} and "
        f"{result.left_out[1]}."
    )
    title = f"{result.names[1]} relative to {result.names[0]}, {result.common} results in both"
    return [_table("comparison", title, COMPARISON, rows, note)]


def history_tables(history: History) -> list[Table]:
    """Return the table of a history with every change of a figure."""
    note = (
        f"Nights: {len(history.nights)}. Before and after: means over the drives named. Without "
        f"changes, at most one night in {1.0 / history.false_alarm_rate:g} gives an alarm."
    )
    if len(history.nights) <= MIN_REFERENCE:
        note += f" With fewer than {MIN_REFERENCE + 1} nights, only changes of most drives are found."
    rows: list[dict[str, Any]] = []
    for change in history.changes:
        named = ", ".join(change.drives[:NAMED]) + (", ..." if len(change.drives) > NAMED else "")
        which = f"{len(change.drives)} of {change.of}" + ("" if len(change.drives) == change.of else f": {named}")
        rows.append(to_plain(change) | {"range": change.range, "which": which, "command": change.command})
    return [_table("history", "Changes" if rows else "No figure changed", HISTORY, rows, note)]


def drive_count_table(counts: Sequence[DriveCount]) -> Table:
    """Return the required numbers of drives as a table."""
    columns = [Column("requirement", words=True), Column("without a failure"), Column("fixed plan"), Column("may fail")]
    columns += [Column("sequential, expected"), Column("sequential, no failure")]
    has_suite = any(count.drives is not None for count in counts)
    if has_suite:
        columns += [Column("drives"), Column("failed"), Column("at the observed rate"), Column("if normal")]
        columns += [Column("sequential test", words=True)]
    rows = []
    for place, count in enumerate(counts):
        terms = f"{100.0 * count.prob:g} % with {100.0 * count.confidence:g} %, power {100.0 * count.power:g} % at "
        terms += f"{100.0 * count.good:g} % failures"
        row = [Cell.head(": ".join(text for text in (count.group, count.limit, terms) if text))]
        names: tuple[str, ...] = ("without_failure", "fixed", "allowed", "sequential", "sequential_at_none")
        if has_suite:
            names = (*names, "drives", "failures", "at_the_rate_seen", "if_normal")
        row += [Cell.number(getattr(count, name), f"{place}.{name}", undefined="no number") for name in names]
        row += [Cell.verdict(count.state or VerdictState.NOT_ENOUGH_DATA)] if has_suite else []
        rows.append(tuple(row))
    note = (
        "Numbers of independent drives. A fixed plan is judged at its end and passes with at most the failures in "
        "'may fail'. The sequential test is judged after each drive and has the same risks."
    )
    return Table("plan", "Number of drives", tuple(columns), tuple(rows), note)

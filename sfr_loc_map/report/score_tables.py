"""The tables of a score: views of the rows of its table of figures. A cell names the key of its number in the JSON.

A predicate selects the rows of each table (`VIEWS`), and `figure_table` lays them out. Rows that no view selects are in
a final table, so that every report contains every row of the score. `tables.formats` writes a table as text,
HTML, Markdown or CSV.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import msgspec

from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import ALIGNED, KINDS, statistic_title, title_of
from sfr_loc_map.metrics.figures.row_part import AFTER_FIRST, DIRECTIONS, FIRST, READING_PARTS, Place
from sfr_loc_map.metrics.figures.rows import NUMBERS, Figure
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report import notes
from sfr_loc_map.report.deviations import deviations_beside_warnings
from sfr_loc_map.report.glossary import glossary
from sfr_loc_map.report.verdict_view import VerdictView, unit_of_numbers, verdict_cell, verdict_views
from sfr_loc_map.tables.formats import to_markdown
from sfr_loc_map.tables.model import (
    ABSENT,
    MIB,
    MILLISECOND,
    NONE,
    NOT_ENOUGH,
    UNKNOWN,
    Cell,
    Column,
    Row,
    Table,
    Unit,
    number,
)

UNNAMED = "not named"
CALL_PARTS = (None, FIRST, AFTER_FIRST)  #: Parts of the times of complete calls on this host.


# ---- which rows a table shows


class View(NamedTuple):
    """A table of figures: name, title, selected rows, note and statistics."""

    name: str
    title: str
    shows: Callable[[Score, Figure], bool]
    note: str | Callable[[Score], str] = ""  #: Text below the table, or the function that returns it.
    #: Shown statistics of a row, without those of the limits, which are always shown; None: all statistics.
    statistics: Callable[[Figure], Sequence[str]] | None = None


def is_headline(score: Score, row: Figure) -> bool:
    """Return whether a row is in the first table: judged rows of figures with `shown` statistics, and limited rows."""
    if is_limited(score, row):
        return True
    if row.figure not in KINDS or not KINDS[row.figure].shown:
        return False
    if row.subject is Subject.MEMORY:  # the part of a peak is the kind of call
        return row.value is not None and row.place is not Place.TARGET
    return score.is_judged_row(row)


def is_limited(score: Score, row: Figure) -> bool:
    """Return whether a limit is on a row. Completeness has a table of its own above the plots."""
    return any(
        score.is_about(item, row) and item.subject is not Subject.COMPLETENESS and item.value is not None
        for item in score.verdicts
    )


def is_of_a_reading(score: Score, row: Figure) -> bool:
    """Return whether a row has the errors of sub-trajectories by one reading of the specification."""
    return row.subject is Subject.TRAJECTORY and row.condition is not None and row.part in READING_PARTS


def is_growth(score: Score, row: Figure) -> bool:
    """Return whether a row has the errors of sub-trajectories of one length."""
    return row.subject is Subject.TRAJECTORY and row.condition is None and row.figure not in ALIGNED


def is_time(score: Score, row: Figure) -> bool:
    """Return whether a row has the times of calls on this host."""
    return row.subject is Subject.TIMING and row.part in CALL_PARTS


def is_stage(score: Score, row: Figure) -> bool:
    """Return whether a row has the times of a stage of calls on this host."""
    is_of_calls = row.subject is Subject.TIMING and row.figure in [*CallKind]
    return is_of_calls and row.part not in CALL_PARTS and row.place is not Place.TARGET


def is_deadline(score: Score, row: Figure) -> bool:
    """Return whether a row compares calls on this host with the period of the pairs."""
    return row.subject is Subject.TIMING and row.figure not in [*CallKind] and row.place is not Place.TARGET


def is_by_direction(score: Score, row: Figure) -> bool:
    """Return whether a row has the position errors along one direction."""
    return row.subject is Subject.TRAJECTORY and row.part in DIRECTIONS


def is_memory(score: Score, row: Figure) -> bool:
    """Return whether a row has the memory of calls on this host."""
    return row.subject is Subject.MEMORY and row.place is not Place.TARGET


def shown_statistics(row: Figure) -> Sequence[str]:
    """Return the statistics of a figure that every view shows, from the catalogue."""
    return KINDS[row.figure].shown if row.figure in KINDS else NUMBERS


def compared_statistics(row: Figure) -> Sequence[str]:
    """Return the statistics by which runs are compared, from the catalogue."""
    return KINDS[row.figure].compared if row.figure in KINDS else NUMBERS


def about(subject: Subject) -> Callable[[Score, Figure], bool]:
    """Return a predicate that is true for rows about a subject."""
    return lambda score, row: row.subject is subject


def on_target(subject: Subject) -> Callable[[Score, Figure], bool]:
    """Return a predicate that is true for rows about a subject that were measured on the target."""
    return lambda score, row: row.subject is subject and row.place is Place.TARGET


HEADLINE = View("headline", "Figures", is_headline, notes.headline_note, shown_statistics)
COVERED = View("covered", "Completeness", about(Subject.COMPLETENESS), notes.covered_note)
READINGS = View(
    "readings", "Each reading of the specification", is_of_a_reading, notes.readings_note, compared_statistics
)
VIEWS = (
    HEADLINE,
    COVERED,
    READINGS,
    View("aligned", "Absolute and relative pose error", lambda score, row: row.figure in ALIGNED, notes.aligned_note),
    View("growth", "Error against the length of the sub-trajectory", is_growth),
    View("directions", "Position error by direction", is_by_direction, notes.OF_DIRECTIONS),
    View("map", "Map", about(Subject.MAP), notes.map_note),
    View("evidence", "Confidence", about(Subject.EVIDENCE), notes.OF_EVIDENCE),
    View("consistency", "Consistency of the uncertainty", about(Subject.CONSISTENCY), notes.nees_note),
    View("time", "Time per call", is_time, notes.clock_text),
    View("deadline", "Calls against the period", is_deadline, notes.OF_DEADLINE),
    View("stages", "Time of stages", is_stage, notes.OF_STAGES),
    View("memory", "Peak resident memory during a call", is_memory, notes.memory_note),
    View("target-time", "Time per call on the target", on_target(Subject.TIMING), notes.target_note),
    View("target-memory", "Peak memory on the target", on_target(Subject.MEMORY), notes.target_note),
)
"""The tables of figures, in the order of a page. Other rows are in a final table."""
FIRST_TABLES = ("verdicts", "deviations", HEADLINE.name, COVERED.name, READINGS.name)
"""Tables above the plots of a page."""
ALL_COVERED = "all-covered"  #: Name of the complete table of completeness below the plots.
SUMMARY = (
    *(HEADLINE.name, "aligned", "map", "time", "memory", "target-time", "target-memory", "external", "method"),
    *(READINGS.name, COVERED.name, "verdicts"),
)
"""Tables of the terminal. The verdicts are last, so that they stay visible."""


# ---- the tables


IndexedRow = tuple[int, Figure]
"""A row of the table of figures with its index in the score."""


def score_tables(score: Score) -> list[Table]:
    """Return all non-empty tables of a score, the most important first."""
    shown = {index for view in VIEWS for index, _ in rows_of(view, score)}
    others = [(index, row) for index, row in enumerate(score.figures) if index not in shown]
    tables = [
        verdict_table(score),
        deviation_table(score),
        *(view_table(view, score) for view in VIEWS),
        figure_table("others", "Other figures", others),
        external_table(score),
        method_table(score),
        association_table(score),
    ]
    return [table for table in tables if table.rows]


def deviation_table(score: Score) -> Table:
    """Return the deviations of a judged score that are not warnings, a row each."""
    rows = tuple((Cell.head(printable(text)),) for text in deviations_beside_warnings(score))
    return Table("deviations", "Deviations", (Column("deviation", words=True),), rows)


def summary_tables(score: Score) -> list[Table]:
    """Return the tables for the terminal; completeness is shown without zeros."""
    named = {table.name: table for table in score_tables(score)}
    if COVERED.name in named:
        named[COVERED.name] = completeness_without_zeros(score)
    return [named[name] for name in SUMMARY if name in named]


def page_tables(score: Score) -> tuple[list[Table], list[Table]]:
    """Return the tables above and below the plots of a page.

    Completeness is shown above without zeros, and below completely.
    """
    above, below = [], []
    for table in score_tables(score):
        if table.name == COVERED.name:
            above.append(completeness_without_zeros(score))
            below.append(replace(table, name=ALL_COVERED, title=f"{table.title}: all figures"))
        elif table.name in FIRST_TABLES:
            above.append(table)
        else:
            below.append(table)
    return above, below


def completeness_without_zeros(score: Score) -> Table:
    """Return the figures of completeness that are not 0, with the number of the others as the note.

    What is incomplete is stated by the verdict, so the note does not repeat it.
    """
    every = rows_of(COVERED, score)
    shown = [(index, row) for index, row in every if row.value != 0.0]
    zeros = len(every) - len(shown)
    return figure_table(COVERED.name, COVERED.title, shown, f"{zeros} other figures are 0." if zeros else "")


def score_markdown(score: Score) -> str:
    """Return all tables as Markdown."""
    return to_markdown([*score_tables(score), glossary()], "Score")


def rows_of(view: View, score: Score) -> list[IndexedRow]:
    """Return the rows of a view."""
    return [(index, row) for index, row in enumerate(score.figures) if view.shows(score, row)]


def view_table(view: View, score: Score) -> Table:
    """Return the table of a view: its rows with the statistics of the view, and with every limited statistic."""
    rows = rows_of(view, score)
    note = view.note if isinstance(view.note, str) else view.note(score)
    if view.statistics is None:
        return figure_table(view.name, view.title, rows, note)
    indices = {index for index, _ in rows}
    wanted = {item.statistic for item in score.verdicts if item.row in indices}
    for _, row in rows:
        wanted.update(view.statistics(row))
    statistics = [name for name in NUMBERS if name in wanted]
    return figure_table(view.name, view.title, rows, note, statistics, is_detailed=False)


# ---- a table of figures


def figure_table(
    name: str,
    title: str,
    indexed: Sequence[IndexedRow],
    note: str = "",
    statistics: Sequence[str] = NUMBERS,
    *,
    is_detailed: bool = True,
) -> Table:
    """Return rows of the table of figures as a table; columns that no row has are omitted.

    Only a detailed table has the number of independent values.
    """
    figures = [row for _, row in indexed]
    shown = [key for key in statistics if any(row.statistic(key) is not None for row in figures)]
    has_interval = any(row.interval for row in figures)
    has_independent = is_detailed and any(row.independent is not None for row in figures)
    columns = [Column("figure", words=True), Column("unit", words=True)]
    columns += [Column(statistic_title(key)) for key in shown]
    columns += [Column("95 % interval")] if has_interval else []
    columns.append(Column("n"))
    columns += [Column("independent")] if has_independent else []
    rows: list[Row] = []
    for index, row in indexed:
        unit, key = row_unit(row), f"figures.{index}"
        cells = [Cell.head(row_title(row)), Cell(unit.symbol)]
        for statistic in shown:
            value = row.statistic(statistic)
            cells.append(Cell.number(value, f"{key}.{statistic}", unit, undefined_of(row, statistic)))
        if has_interval:
            cells.append(Cell.interval(row.interval, key, unit, ABSENT))
        cells.append(Cell.number(row.n, f"{key}.n", undefined=ABSENT))
        if has_independent:
            cells.append(Cell.number(row.independent, f"{key}.independent", undefined=ABSENT))
        rows.append(tuple(cells))
    return Table(name, title, tuple(columns), tuple(rows), note)


def undefined_of(row: Figure, statistic: str) -> str:
    """Return the text of an undefined number of a row.

    The value of a figure with a single number is unknown. A statistic of a figure with too few values has not enough
    data. All other numbers do not apply to the figure.
    """
    if row.is_one_number or row.value is not None:
        return UNKNOWN if statistic == "value" else ABSENT
    return NOT_ENOUGH if statistic != "value" and not row.is_defined else ABSENT


def row_title(row: Figure) -> str:
    """Return the displayed name of a row: `position error over 5 m, along the path`."""
    over = f" over {label_of(row.condition)}" if row.condition else ""
    part = "" if row.part is None else f", {DIRECTIONS.get(row.part, row.part.replace('_', ' '))}"
    return f"{title_of(row.figure)}{over}{part}"


def row_unit(row: Figure) -> Unit:
    """Return the unit that suits the numbers of a row."""
    numbers = [row.statistic(key) for key in NUMBERS]
    return unit_of_numbers(row.figure, row.part, row.unit, *numbers, row.high95)


# ---- verdicts


def _requirement(view: VerdictView) -> Cell:
    """Return the identifier of the requirement of a verdict."""
    return Cell(ABSENT) if view.item.id is None else Cell.word(view.item.id, f"{view.key}.id")


def verdict_table(score: Score) -> Table:
    """Return the verdict on each limit."""
    rows: list[Row] = []
    has_ids = any(item.id for item in score.verdicts)
    for view in verdict_views(score):
        row = (
            verdict_cell(view.item.state.value, f"{view.key}.verdict"),
            *([_requirement(view)] if has_ids else []),
            Cell.head(view.name),
            Cell(view.unit.symbol),
            view.value,
            view.limit,
            view.margin,
            view.interval,
            view.count,
            Cell(view.confidence),
        )
        rows.append(row)
    titles = ("unit", "value", "limit", "margin", "95 % interval", "n", "certain")
    columns = (Column("figure", words=True), *(Column(title) for title in titles))
    heads = (Column("verdict", words=True), *([Column("requirement", words=True)] if has_ids else []))
    note = notes.NO_INTERVAL if any(item.certain is None for item in score.verdicts) else ""
    return Table("verdicts", "Verdicts", (*heads, *columns), tuple(rows), note)


# ---- facts


def association_table(score: Score) -> Table:
    """Return the counts of scored frames and poses."""
    columns = (Column("frames and poses", words=True), Column("number"))
    if score.association is None:
        return Table("frames", "What was scored", columns, ())
    facts = msgspec.structs.asdict(score.association)
    rows = tuple(
        (Cell.head(name.replace("_", " ")), Cell.number(value, f"association.{name}"))
        for name, value in facts.items()
        if isinstance(value, int | float)
    )
    return Table("frames", "What was scored", columns, rows)


def method_table(score: Score) -> Table:
    """Return the description of the method under test."""
    method, facts = score.method, dict[str, str]()
    if method is not None:
        facts = {"method": method.name, "version": method.version or UNNAMED, "kind": method.kind.value}
        if method.isolation is not None:
            facts["isolated from"] = method.isolation
    if (usage := score.processes) is not None:
        facts["processor time"] = f"{usage.cpu_s:.3g} s, {number(usage.cpu_outside_s)} s of it outside the calls"
        threads, processes = (UNKNOWN if count is None else count for count in (usage.threads, usage.processes))
        facts["maximum"] = f"{threads} threads, {processes} processes"
    if text := convention_text(score):
        facts["converted"] = text
    rows = tuple((Cell.head(name), Cell(text)) for name, text in facts.items())
    return Table("method", "Method under test", (Column("property", words=True), Column("value", words=True)), rows)


def convention_text(score: Score) -> str:
    """Return the conversion of the poses before scoring, in words; empty if there was none."""
    convention = score.convention
    if convention is None:
        return ""
    parts = [f"declared: {', '.join(convention.declared)}"] if convention.declared else []
    if convention.diagnosed is not None:
        fitted = ", with values fitted to the truth" if convention.fitted else ""
        parts.append(f"by the diagnosis: {convention.diagnosed} (--apply-diagnosis{fitted})")
    return "; ".join(parts)


def external_table(score: Score) -> Table:
    """Return the answers, latency and resources of an external node."""
    columns = (Column("external node", words=True), Column("unit"), Column("value"))
    if (node := score.external) is None:
        return Table("external", "External node", columns, ())
    shown: list[tuple[str, str, float | None, Unit]] = [
        (name.replace("_", " "), f"answers.{name}", value, NONE)
        for name, value in msgspec.structs.asdict(node.answers).items()
    ]
    if (latency := node.latency_s) is not None:
        for name in STATISTICS:
            value = getattr(latency, name)
            shown.append((f"latency {statistic_title(name)}", f"latency_s.{name}", value, MILLISECOND))
    if (usage := node.process) is not None:
        shown.append(("processor time", "process.cpu_s", usage.cpu_s, Unit("s")))
        shown.append(("peak resident memory", "process.peak_rss_bytes", usage.peak_rss_bytes, MIB))
    rows = tuple(
        (Cell.head(title), Cell(unit.symbol or ABSENT), Cell.number(value, f"external.{key}", unit, NOT_ENOUGH))
        for title, key, value, unit in shown
    )
    note = (
        f"On {node.topic}, frames {node.frames or UNNAMED}. Latency: from the last image of a pair to the receipt of "
    )
    note += "the answer, including transport and queueing, unlike a time per call."
    note += f" Processes: {node.process.method}." if node.process is not None else ""
    note += f" The node {node.ended}." if node.ended else ""
    return Table("external", f"External node: {node.task}", columns, rows, note)

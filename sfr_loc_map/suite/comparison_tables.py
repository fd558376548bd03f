"""The tables of a comparison of suites and of a history."""

from __future__ import annotations

from sfr_loc_map.report.tables import (
    ABSENT,
    Cell,
    Column,
    Row,
    Table,
)
from sfr_loc_map.suite.comparison import FigureComparison, SuiteComparison
from sfr_loc_map.suite.history import History, HistoryPoint


def comparison_tables(result: SuiteComparison) -> list[Table]:
    """Return the table of a comparison of suites."""
    columns = (
        Column("runs", words=True),
        Column("figure", words=True),
        Column("drives"),
        Column("ratio"),
        Column("95 % interval"),
        Column("p"),
        Column("p, corrected"),
        Column("the other is", words=True),
        Column("largest ratio"),
        Column("at", words=True),
    )
    title = f"{result.names[1]} over {result.names[0]}, {result.common} drives in both"
    note = (
        "Ratio: geometric mean over the drives of mean + 3 sigma, or of the cost; below 1 the other is better. "
        f"Corrected for {len(result.figures)} comparisons (Holm). Not in both: {result.left_out[0]} and "
        f"{result.left_out[1]}."
    )
    return [Table("comparison", title, columns, tuple(map(_comparison_row, result.figures)), note)]


def _comparison_row(item: FigureComparison) -> Row:
    return (
        Cell.head(item.runs),
        Cell(item.figure),
        Cell.number(item.drives),
        Cell.number(item.ratio),
        Cell.interval(item.ci95),
        Cell.number(item.p, undefined=ABSENT),
        Cell.number(item.p_corrected, undefined=ABSENT),
        Cell(item.outcome.value),
        Cell.number(item.worst.other / item.worst.first),
        Cell(item.worst.label),
    )


def history_tables(history: History) -> list[Table]:
    """Return the table of a history: every figure of every run beside its baseline."""
    columns = (
        Column("figure", words=True),
        Column("run", words=True),
        Column("drives"),
        Column("median"),
        Column("baseline", words=True),
        Column("ratio"),
        Column("95 % interval"),
        Column("p"),
        Column("is", words=True),
    )
    note = f"Certain: p below {history.level:.2g}, so that a history without a change gives an alarm once in 100 times."
    return [Table("history", "Runs beside their baseline", columns, tuple(map(_history_row, history.points)), note)]


def _history_row(item: HistoryPoint) -> Row:
    return (
        Cell.head(item.figure),
        Cell(item.run),
        Cell.number(item.drives),
        Cell.number(item.median),
        Cell(item.baseline),
        Cell.number(item.ratio),
        Cell.interval(item.ci95),
        Cell.number(item.p, undefined=ABSENT),
        Cell(item.outcome.value),
    )

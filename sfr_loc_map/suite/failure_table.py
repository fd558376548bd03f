"""The table of what failed in a suite."""

from __future__ import annotations

from sfr_loc_map.report.tables import (
    ABSENT,
    Cell,
    Column,
    Row,
    Table,
)
from sfr_loc_map.suite.store import SHORT_KEY
from sfr_loc_map.suite.summary import Summary


def failure_table(summary: Summary, *, commands: bool) -> Table:
    """Return tasks that failed and sources that were refused, each with its cause.

    Args:
        summary: What is shown.
        commands: Whether each failure has the command that repeats it.
    """
    titles = ("task", "cause", "tries", "message", *(("again",) if commands else ()), "result")
    rows: list[Row] = []
    for item, again in zip(summary.failures, summary.again, strict=True):
        last = item.attempts[-1]
        told = (Cell.head(item.label), Cell(last.cause.value), Cell.number(len(item.attempts), "attempts"))
        link = Cell(item.key[:SHORT_KEY], link=f"failures/{item.key}.json")
        rows.append((*told, Cell(last.message), *((Cell(again or ABSENT),) if commands else ()), link))
    for refusal in summary.refusals:
        told = (Cell.head(refusal.path), Cell("source refused"), Cell.number(0, "refusals"))
        rows.append((*told, Cell(refusal.reason), *((Cell(ABSENT),) if commands else ()), Cell(ABSENT)))
    columns = tuple(Column(title, words=title != "tries") for title in titles)
    return Table("failures", "Failures", columns, tuple(rows))

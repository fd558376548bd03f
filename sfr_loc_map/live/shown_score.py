"""The score of the monitor, as all views show it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from sfr_loc_map.metrics.config import label_of
from sfr_loc_map.metrics.judging.judge import with_missing_results
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import to_dict
from sfr_loc_map.report.limit_bars import limit_bars
from sfr_loc_map.report.plotted_data import error_sizes
from sfr_loc_map.report.score_tables import score_tables
from sfr_loc_map.report.summary import banner_of
from sfr_loc_map.report.tables import Cell, Table

NO_SCORE_SHOWN: dict[str, Any] = {"overall": None, "tables": [], "limits": [], "errors": None}
"""Content of a page before the first score."""


class ShownScore:
    """A score, its JSON values, and the displayed tables and bars."""

    def __init__(self, score: Score, received_s: float) -> None:
        self.score, self.received_s, self.content = score, received_s, to_dict(score)
        self.overall, self.tables, self.bars = banner_of(score), score_tables(score), limit_bars(score)

    def with_missing(self, missing: str) -> ShownScore:
        """Return the score at the end of a run, judged as incomplete if results are missing; figures are unchanged."""
        score = with_missing_results(self.score, missing)
        return self if score is self.score else ShownScore(score, self.received_s)

    def to_plain(self) -> dict[str, Any]:
        """Return the content of a page as JSON values."""
        return {
            "overall": asdict(self.overall),
            "tables": [_table_to_plain(table) for table in self.tables],
            "limits": [asdict(bar) for bar in self.bars],
            "errors": _errors_to_plain(self.score),
            "warnings": list(self.score.warnings),
            "received_s": self.received_s,
        }


def _errors_to_plain(score: Score) -> dict[str, Any] | None:
    """Return the position errors, m, over the first condition with their end frames; None without a trajectory."""
    drive = None if score.details is None else score.details.trajectory
    if drive is None:
        return None
    rows = drive.sub_trajectories[0]
    return {
        "over": label_of(rows.condition),
        "condition": rows.condition,
        "end_frame": rows.end_frame,
        "position_m": error_sizes(rows),
    }


def _table_to_plain(table: Table) -> dict[str, Any]:
    def plain(cell: Cell) -> dict[str, str]:
        parts = {"text": cell.text, "key": cell.key, "kind": cell.kind.value, "icon": cell.icon}
        return {name: value for name, value in parts.items() if value}

    return {
        "name": table.name,
        "title": table.title,
        "note": table.note,
        "columns": [{"heading": column.heading, "words": column.words} for column in table.columns],
        "rows": [[plain(cell) for cell in row] for row in table.rows],
    }

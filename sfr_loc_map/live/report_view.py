"""A report of the monitor as it is shown: the strings of the table model, the verdict over all limits."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.live.live_table import live_table
from sfr_loc_map.metrics.config import Condition
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import from_dict, to_dict
from sfr_loc_map.report.page import Overall, overall_of
from sfr_loc_map.report.score_tables import score_tables
from sfr_loc_map.report.tables import Cell, Table

MAX_REPORT_CHARACTERS = 8_000_000


@dataclass(frozen=True, slots=True)
class ReportView:
    """One report.

    Attributes:
        content: Its JSON values, as they came.
        overall: Verdict over all limits.
        tables: Its tables, whose strings are shown.
        warnings: One line each.
        conditions: What ends the sub-trajectories that were scored.
        spacing: Frames from one start of a sub-trajectory to the next, 0 without a trajectory.
        received_s: When it was received.
    """

    content: dict[str, Any]
    overall: Overall
    tables: tuple[Table, ...]
    warnings: tuple[str, ...]
    conditions: tuple[Condition, ...]
    spacing: int
    received_s: float

    @classmethod
    def read(cls, text: str, received_s: float) -> ReportView:
        """Return a report of its JSON.

        Raises:
            InputError: If it is not a score.
        """
        if len(text) > MAX_REPORT_CHARACTERS:
            raise InputError(f"metrics/report has {len(text)} characters: up to {MAX_REPORT_CHARACTERS} are read")
        try:
            content = parse_json(text, parse_constant=lambda _: None)
        except ValueError as error:
            raise InputError(f"metrics/report is no JSON ({error})") from error
        score = from_dict(content, "metrics/report")
        try:
            json.dumps(content, allow_nan=False)
        except ValueError:  # 1e999 is JSON, and no number here
            content = to_dict(score)
        return cls(
            content=content,
            overall=overall_of(score),
            tables=tuple(filter(None, (live_table(score), *score_tables(score)))),
            warnings=score.warnings,
            conditions=_conditions(score),
            spacing=0 if score.trajectory is None else score.trajectory.first.spacing_frames,
            received_s=received_s,
        )

    def to_plain(self) -> dict[str, Any]:
        """Return what a page shows, as JSON values."""
        overall = self.overall
        return {
            "overall": {"state": overall.state, "text": overall.text, "style": overall.style, "icon": overall.icon},
            "tables": [table_to_plain(table) for table in self.tables],
            "warnings": list(self.warnings),
            "received_s": self.received_s,
        }


def table_to_plain(table: Table) -> dict[str, Any]:
    """Return a table with the strings that are shown, as JSON values."""
    return {
        "name": table.name,
        "title": table.title,
        "note": table.note,
        "columns": [{"heading": column.heading, "words": column.words} for column in table.columns],
        "rows": [[_cell(cell) for cell in row] for row in table.rows],
    }


def _cell(cell: Cell) -> dict[str, str]:
    parts = {"text": cell.text, "key": cell.key, "kind": cell.kind.value, "icon": cell.icon}
    return {name: value for name, value in parts.items() if value}


def _conditions(score: Score) -> tuple[Condition, ...]:
    part = score.trajectory
    if part is None:
        return ()
    return tuple(item.condition for item in part.several) or (part.first.condition,)

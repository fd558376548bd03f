"""The score that all views show: the score of the monitor, or after a replay the score of the replay."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from sfr_loc_map.io.truth.config import NO_LEVER, NO_TURN
from sfr_loc_map.live.limit_bars import limit_bars
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_dict
from sfr_loc_map.report.plotted_data import error_sizes
from sfr_loc_map.report.score_tables import score_tables
from sfr_loc_map.report.summary import banner_of
from sfr_loc_map.tables.model import Cell, Table

AS_PUBLISHED: dict[str, Any] = {
    "frame": "",
    "lever_arm_m": list(NO_LEVER),
    "lever_quat_xyzw": list(NO_TURN),
    "clock_offset_s": 0.0,
}
"""Parameters `truth.*` of a monitor that scores the true poses as published."""


class ShownScore:
    """A score with its JSON values and its limits as bars."""

    def __init__(self, score: Score, received_s: float) -> None:
        self.score = score
        self.received_s = received_s
        self.content = to_dict(score)
        self.overall = banner_of(score)
        self.bars = limit_bars(score)
        self.plain: dict[str, Any] = {
            "overall": asdict(self.overall),
            "tables": [_table_to_plain(table) for table in score_tables(score)],
            "limits": [asdict(bar) for bar in self.bars],
            "errors": _errors_to_plain(score),
            "warnings": list(score.warnings),
            "received_s": received_s,
        }
        """The displayed content as JSON values."""

    @property
    def converts_truth(self) -> bool:
        """Whether the monitor converts the published true poses to RB, or takes them from /tf."""
        made = self.score.provenance
        monitor = {} if made is None else made.configuration.get("monitor")
        if not isinstance(monitor, dict):
            return False
        return any(monitor.get(f"truth.{name}", default) != default for name, default in AS_PUBLISHED.items())


def _errors_to_plain(score: Score) -> dict[str, Any] | None:
    """Return the position errors, m, of the sub-trajectories of the first condition, and their end frames.

    None without a trajectory.
    """
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

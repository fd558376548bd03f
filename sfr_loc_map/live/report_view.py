"""A report of the monitor as it is shown: the strings of the table model, and the figures beside their limits."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.metrics.config import CallKind, Condition, VerdictState
from sfr_loc_map.metrics.score import Score, Verdict
from sfr_loc_map.metrics.score_json import from_dict, to_dict
from sfr_loc_map.report.page import Overall, overall_of
from sfr_loc_map.report.score_tables import (
    headline_table,
    keyed_conditions,
    limit_name,
    limit_unit,
    map_error,
    score_tables,
)
from sfr_loc_map.report.tables import ABSENT, Cell, Column, Row, Table, fitting, number

MAX_REPORT_CHARACTERS = 8_000_000
WORST_FIRST = (VerdictState.FAIL, VerdictState.NOT_ENOUGH_DATA, VerdictState.PASS)


@dataclass(frozen=True, slots=True)
class ReportView:
    """One report: its JSON values as they came, and what is shown of it.

    The condition ends the first sub-trajectories that were scored, None without a trajectory; the spacing is that of
    their starts, frames.
    """

    content: dict[str, Any]
    overall: Overall
    tables: tuple[Table, ...]
    warnings: tuple[str, ...]
    condition: Condition | None
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
        part = score.trajectory
        return cls(
            content=content,
            overall=overall_of(score),
            tables=tuple(filter(None, (live_table(score), *score_tables(score)))),
            warnings=score.warnings,
            condition=None if part is None else (part.several or (part.first,))[0].condition,
            spacing=0 if part is None else part.first.spacing_frames,
            received_s=received_s,
        )

    def to_plain(self) -> dict[str, Any]:
        """Return what a page shows, as JSON values."""
        return {
            "overall": asdict(self.overall),
            "tables": [_table_to_plain(table) for table in self.tables],
            "warnings": list(self.warnings),
            "received_s": self.received_s,
        }


def _table_to_plain(table: Table) -> dict[str, Any]:
    return {
        "name": table.name,
        "title": table.title,
        "note": table.note,
        "columns": [{"heading": column.heading, "words": column.words} for column in table.columns],
        "rows": [[_cell_to_plain(cell) for cell in row] for row in table.rows],
    }


def _cell_to_plain(cell: Cell) -> dict[str, str]:
    parts = {"text": cell.text, "key": cell.key, "kind": cell.kind.value, "icon": cell.icon}
    return {name: value for name, value in parts.items() if value}


def live_table(score: Score) -> Table | None:
    """Return the figures of the headline with their limits and verdicts, None where there is no figure yet."""
    headline = headline_table(score)
    if headline is None:
        return None
    limits: dict[str, list[Verdict]] = {}
    for item in score.verdicts:
        limits.setdefault(next(_places(score, item), ""), []).append(item)

    def with_limits(row: Row) -> Row:
        *cells, count = row
        found = limits.get(row[2].key.rpartition(".")[0])  # column of the mean, behind name and unit
        if not found:
            return (*cells, Cell(ABSENT), Cell(ABSENT), count)
        worst = min((item.state for item in found), key=WORST_FIRST.index)
        return (*cells, Cell("; ".join(map(_limit, found))), Cell.verdict(worst.value), count)

    *columns, count = headline.columns
    added = (Column("limit", words=True), Column("verdict", words=True))
    return Table("live", "Figures", (*columns, *added, count), tuple(map(with_limits, headline.rows)), headline.note)


def _places(score: Score, item: Verdict) -> Iterator[str]:
    """Yield the place in the JSON of the statistic that a limit is on."""
    metric = item.metric
    for key, part in keyed_conditions(score):
        for name in ("position_m", "attitude_deg", "heading_deg"):
            if metric.startswith(name.partition("_")[0]) and part.condition == item.condition:
                yield f"{key}.{name}"
    error = map_error(score.map) if score.map is not None else None
    if metric.startswith("point_error_") and error is not None:
        yield error.key
    for kind in CallKind:
        if metric.startswith(f"{kind}_") and metric.endswith("_s"):
            yield f"timing.{kind}_s"


def _limit(item: Verdict) -> str:
    """Return a limit with its statistic and unit: `mean + 3 sigma ≤ 50 mm`."""
    unit, name = fitting(limit_unit(item.metric), item.limit, item.value), limit_name(item.metric)
    subjects = ("position ", "attitude ", "heading ", "point error ", *(f"{kind} time " for kind in CallKind))
    statistic = next((name.removeprefix(subject) for subject in subjects if name.startswith(subject)), name)
    return f"{statistic} ≤ {number(item.limit, unit=unit)} {unit.symbol}"

"""Looks up rows and numbers in the JSON of a score."""

from typing import Any

from sfr_loc_map.metrics.completeness.expected_items import expected_row
from sfr_loc_map.metrics.completeness.shortfall_kinds import SHORTFALLS
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import Scope


def row(score: Any, figure: str, **where: Any) -> dict[str, Any]:
    """Return the first row of a figure with these values; empty if there is none."""
    found = (item for item in score["figures"] if item["figure"] == figure)
    return next((item for item in found if all(item.get(key) == value for key, value in where.items())), {})


def number(score: Any, figure: str, statistic: str = "value", **where: Any) -> Any:
    """Return one number of a figure; None if undefined."""
    return row(score, figure, **where).get(statistic)


def rows_about(score: Any, *subjects: str) -> list[dict[str, Any]]:
    """Return the rows about the given subjects."""
    return [item for item in score["figures"] if item["subject"] in subjects]


def complete() -> tuple[Figure, ...]:
    """Return the rows of a score in which a drive, a map and all calls are complete."""
    parts = ["drive", "map", *(f"{what} {kind}" for what in ("calls", "memory") for kind in CallKind)]
    parts += [f"target {part}" for part in parts[2:]]
    rows = [expected_row(RowPart(part), 1, 1) for part in parts]
    kinds = [f"{place}{kind}" for place in ("", "target ") for kind in CallKind]
    names = [each.figure for each in SHORTFALLS if each.scope in (Scope.CALLS, Scope.MEMORY)]
    return (*rows, *(figure_row(name, part=kind, n=1, value=0.0) for kind in kinds for name in names))

"""Tables of a comparison of methods and of a benchmark of faults, made from the JSON of the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sfr_loc_map.tables.model import Cell, Column, Row, Table, Unit

ResultColumn = tuple[str, str, str]
"""Heading without the unit, symbol of the displayed unit, and path of keys within an entry."""
COSTS: tuple[ResultColumn, ...] = (
    ("p50", "ms", "time_s/p50"),
    ("p95", "ms", "time_s/p95"),
    ("max", "ms", "time_s/max"),
    ("peak", "MiB", "memory_bytes/peak"),
)
MAPS: tuple[ResultColumn, ...] = (
    ("points", "", "points"),
    ("coverage", "%", "accuracy/coverage"),
    ("point error mean", "mm", "accuracy/mean"),
    ("mean + 3 sigma", "mm", "accuracy/mean_plus_3sigma"),
)
FAULTS: tuple[ResultColumn, ...] = (
    ("pairs", "", "pairs"),
    ("position", "mm", "position_m"),
    ("heading", "deg", "heading_deg"),
    ("tracking", "", "tracking"),
    ("degraded", "", "degraded"),
    ("lost", "", "lost"),
    ("compared", "", "compared"),
    ("position error / 3 sigma", "", "position_ratio"),
    ("attitude error / 3 sigma", "", "attitude_ratio"),
    ("step error / 3 sigma", "", "step_ratio"),
    ("ratio above 5", "%", "beyond_share"),
    ("vertical disparity", "px", "vertical_offset_px"),
    ("disparity bias", "px", "disparity_offset_px"),
)


def registered_methods_table(methods: Sequence[Mapping[str, str | None]]) -> Table:
    """Return the registered methods under test with task, version and kind."""
    rows = tuple(tuple(Cell(text or "-") for text in item.values()) for item in methods)
    columns = tuple(Column(title, words=True) for title in ("task", "method", "version", "kind", ""))
    return Table("methods", "Methods", columns, rows)


def benchmark_tables(result: Mapping[str, Any]) -> list[Table]:
    """Return the tables of a benchmark."""
    if result["kind"] == "faults":
        title = f"Localisation with faults, {result['condition']}: mean + 3 sigma; largest errors of tracking pairs"
        return [_table("faults", title, result, FAULTS, word="error_report")]
    if result["kind"] == "localise":
        kinds = {"position_m": "mm", "attitude_deg": "deg", "heading_deg": "deg"}
        errors = [
            (f"{condition} {key.partition('_')[0]}", unit, f"accuracy/{condition}/{key}")
            for condition in result["conditions"]
            for key, unit in kinds.items()
        ]
        title = "Localisation: mean + 3 sigma; host times"
        return [_table("localise", title, result, (*errors, ("lost", "", "lost"), *COSTS))]
    title = f"Maps of single pairs, {result['disparities']} disparities; host times"
    return [_table("map", title, result, (*MAPS, *COSTS))]


def _table(
    name: str, title: str, result: Mapping[str, Any], figures: Sequence[ResultColumn], word: str = "version"
) -> Table:
    """Return a table: a row per entry with its name and `word`, then a row per ratio of our method to an entry."""
    rows: list[Row] = []
    for entry, values in result["entries"].items():
        cells = [_cell(values, place, unit) for _, unit, place in figures]
        rows.append((Cell.head(entry), Cell(str(values.get(word, ""))), *cells))
    for other, values in result.get("ratios", {}).items():
        rows.append((Cell.head(f"ours / {other}"), Cell(""), *(_cell(values, place, "") for *_, place in figures)))
    heads = (Column("", words=True), Column("", words=True))
    return Table(name, title, (*heads, *(Column(heading, Unit(unit)) for heading, unit, _ in figures)), tuple(rows))


def _cell(entry: Mapping[str, Any], place: str, unit: str) -> Cell:
    value: Any = entry
    for key in place.split("/"):
        value = value.get(key) if isinstance(value, Mapping) else None
    return Cell.number(value, unit=Unit(unit), undefined="")

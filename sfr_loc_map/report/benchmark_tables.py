"""The tables of a comparison of methods and of a benchmark of faults, made from its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sfr_loc_map.report.tables import (
    DEGREE,
    MIB,
    MILLIMETRE,
    MILLISECOND,
    NONE,
    PERCENT,
    PIXEL,
    Cell,
    Column,
    Row,
    Table,
    Unit,
)

Figure = tuple[str, Unit, str]
"""Heading without the unit, unit that it is shown in, keys that lead to it within an entry."""
COSTS: tuple[Figure, ...] = (
    ("p50", MILLISECOND, "time_s/p50"),
    ("p95", MILLISECOND, "time_s/p95"),
    ("max", MILLISECOND, "time_s/max"),
    ("peak", MIB, "memory_bytes/peak"),
)
MAPS: tuple[Figure, ...] = (
    ("points", NONE, "points"),
    ("coverage", PERCENT, "accuracy/coverage"),
    ("point error mean", MILLIMETRE, "accuracy/mean"),
    ("mean + 3 sigma", MILLIMETRE, "accuracy/mean_plus_3sigma"),
)
FAULTS: tuple[Figure, ...] = (
    ("pairs", NONE, "pairs"),
    ("position", MILLIMETRE, "position_m"),
    ("heading", DEGREE, "heading_deg"),
    ("tracking", NONE, "tracking"),
    ("degraded", NONE, "degraded"),
    ("lost", NONE, "lost"),
    ("position error / 3 sigma", NONE, "position_ratio"),
    ("attitude error / 3 sigma", NONE, "attitude_ratio"),
    ("step error / 3 sigma", NONE, "step_ratio"),
    ("beyond 5 times", PERCENT, "beyond_share"),
    ("vertical disparity", PIXEL, "vertical_offset_px"),
    ("disparity bias", PIXEL, "disparity_offset_px"),
)


def benchmark_tables(result: Mapping[str, Any]) -> list[Table]:
    """Return the tables of a benchmark of any kind."""
    if result["kind"] == "faults":
        title = f"Localisation with faults, {result['condition']}: mean + 3 sigma; largest errors of tracking pairs"
        return [_table("faults", title, result, FAULTS, word="honesty")]
    if result["kind"] == "localise":
        kinds = {"position_m": MILLIMETRE, "attitude_deg": DEGREE, "heading_deg": DEGREE}
        errors = [
            (f"{condition} {key.partition('_')[0]}", unit, f"accuracy/{condition}/{key}")
            for condition in result["conditions"]
            for key, unit in kinds.items()
        ]
        title = "Localisation: mean + 3 sigma; host times"
        return [_table("localise", title, result, (*errors, ("lost", NONE, "lost"), *COSTS))]
    title = f"Maps of single pairs, {result['disparities']} disparities; host times"
    return [_table("map", title, result, (*MAPS, *COSTS))]


def _table(
    name: str, title: str, result: Mapping[str, Any], figures: tuple[Figure, ...] | list[Figure], word: str = "version"
) -> Table:
    """Return a table with a row for each entry, its `word` beside its name, then one for each ratio of ours to it."""
    rows: list[Row] = []
    for entry, values in result["entries"].items():
        cells = [_cell(values, place, unit) for _, unit, place in figures]
        rows.append((Cell.head(entry), Cell(str(values.get(word, ""))), *cells))
    for other, values in result.get("ratios", {}).items():
        rows.append((Cell.head(f"ours / {other}"), Cell(""), *(_cell(values, place, NONE) for *_, place in figures)))
    heads = (Column("", words=True), Column("", words=True))
    return Table(name, title, (*heads, *(Column(heading, unit) for heading, unit, _ in figures)), tuple(rows))


def _cell(entry: Mapping[str, Any], place: str, unit: Unit) -> Cell:
    value: Any = entry
    for key in place.split("/"):
        value = value.get(key) if isinstance(value, Mapping) else None
    return Cell.number(value, unit=unit, undefined="")

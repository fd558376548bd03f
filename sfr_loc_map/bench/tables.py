"""The tables of a benchmark, made from its JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from sfr_loc_map.report.tables import (
    ABSENT,
    DEGREE,
    MIB,
    MILLIMETRE,
    MILLISECOND,
    NONE,
    PERCENT,
    PIXEL,
    SECOND,
    Cell,
    Column,
    Row,
    Table,
    Unit,
)

Json = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Figure:
    """One column of figures.

    Attributes:
        title: Heading without the unit.
        unit: Unit that it is shown in.
        place: Keys that lead to it within an entry.
    """

    title: str
    unit: Unit
    place: tuple[str, ...]


COSTS = (
    Figure("p50", MILLISECOND, ("time_s", "p50")),
    Figure("p95", MILLISECOND, ("time_s", "p95")),
    Figure("max", MILLISECOND, ("time_s", "max")),
    Figure("peak", MIB, ("memory_bytes", "peak")),
)
DISPARITY = (
    Figure("density", NONE, ("accuracy", "density")),
    Figure("bad-1", PERCENT, ("accuracy", "bad_1")),
    Figure("bad-2", PERCENT, ("accuracy", "bad_2")),
    Figure("MAE", PIXEL, ("accuracy", "mean_abs_px")),
    Figure("sigma", PIXEL, ("accuracy", "sigma_px")),
    Figure("bias", PIXEL, ("accuracy", "bias_px")),
    Figure("coverage", NONE, ("accuracy", "coverage")),
)
FAULTS = (
    Figure("pairs", NONE, ("pairs",)),
    Figure("position", MILLIMETRE, ("position_m",)),
    Figure("heading", DEGREE, ("heading_deg",)),
    Figure("tracking", NONE, ("tracking",)),
    Figure("degraded", NONE, ("degraded",)),
    Figure("lost", NONE, ("lost",)),
    Figure("position error / 3 sigma", NONE, ("position_ratio",)),
    Figure("attitude error / 3 sigma", NONE, ("attitude_ratio",)),
    Figure("beyond 5 times", PERCENT, ("beyond_share",)),
    Figure("vertical disparity", PIXEL, ("vertical_offset_px",)),
    Figure("disparity bias", PIXEL, ("disparity_offset_px",)),
)
MAP_FAULTS = (
    Figure("pairs", NONE, ("pairs",)),
    Figure("refused", NONE, ("refused",)),
    Figure("coverage", NONE, ("coverage",)),
    Figure("mean error", MILLIMETRE, ("mean_error_m",)),
    Figure("median sigma", MILLIMETRE, ("median_sigma_m",)),
    Figure("error / 3 sigma, median", NONE, ("median_ratio",)),
    Figure("99 %", NONE, ("ratio_p99",)),
    Figure("largest", NONE, ("largest_ratio",)),
    Figure("beyond 5 times", PERCENT, ("beyond_share",)),
)
CAMPAIGN = (
    Figure("drives", NONE, ("drives",)),
    Figure("silent", NONE, ("silent",)),
    Figure("said", NONE, ("said",)),
    Figure("stated", NONE, ("stated",)),
    Figure("tracking pairs", NONE, ("tracking_pairs",)),
    Figure("degraded pairs", NONE, ("degraded_pairs",)),
    Figure("lost pairs", NONE, ("lost_pairs",)),
    Figure("largest error / 3 sigma", NONE, ("worst_ratio",)),
)
DRIVES = (
    Figure("pairs", NONE, ("pairs",)),
    *FAULTS[3:9],
    Figure("largest error", MILLIMETRE, ("largest_error_m",)),
)
WORST_DRIVES = 15
SCORE = (
    Figure("sub-trajectories of 5 m", NONE, ("sub_trajectories_of_5_m",)),
    Figure("time", SECOND, ("time_s", "wall")),
    Figure("processor", SECOND, ("time_s", "processor")),
    Figure("peak", MIB, ("memory_bytes", "peak")),
)


def benchmark_tables(result: Json) -> list[Table]:
    """Return the tables of a benchmark of any kind."""
    if result["kind"] == "score":
        title = f"Score of {result['poses']} poses, reading included; host times"
        return [_table("score", title, result, SCORE, word="what")]
    if result["kind"] == "faults":
        title = f"Localisation with faults, {result['condition']}: mean + 3 sigma; largest errors of tracking pairs"
        return [_table("faults", title, result, FAULTS, word="honesty")]
    if result["kind"] == "map-faults":
        title = (
            f"Maps with faults: points, and their errors over the stated 3 sigma; true points to {result['to_m']:g} m"
        )
        return [_table("map-faults", title, result, MAP_FAULTS, word="honesty")]
    if result["kind"] == "fault-campaign":
        return _campaign_tables(result)
    tables = []
    for size in result["sizes"]:
        tables += _localise_tables(result, size) if result["kind"] == "localise" else _map_tables(size)
    return [*tables, _growth_table(result)] if len(result["sizes"]) > 1 else tables


def _localise_tables(result: Json, size: Json) -> list[Table]:
    errors = []
    for condition in result["conditions"]:
        for name, unit, key in (
            ("position", MILLIMETRE, "position_m"),
            ("attitude", DEGREE, "attitude_deg"),
            ("heading", DEGREE, "heading_deg"),
        ):
            errors.append(Figure(f"{condition} {name}", unit, ("accuracy", condition, key)))
    title = f"Localisation, {size['width']} x {size['height']}: mean + 3 sigma; host times"
    return [_table("localise", title, size, (*errors, Figure("lost", NONE, ("lost",)), *COSTS))]


def _campaign_tables(result: Json) -> list[Table]:
    title = "Drives with random faults; silent: a tracking pair beyond 5 times its stated 3 sigma"
    worst = {
        f"{drive['source']} {drive['first']}: {drive['faults']}, seed {drive['seed']}": drive
        for drive in result["drives"][:WORST_DRIVES]
    }
    listed = {"entries": worst}
    return [
        _table("campaign", title, result, CAMPAIGN),
        _table("drives", "Drives with the largest errors over the stated 3 sigma", listed, DRIVES, word="honesty"),
    ]


def _map_tables(size: Json) -> list[Table]:
    title = f"Mapping, {size['width']} x {size['height']}, {size['disparities']} disparities; host times"
    tables = [_table("map", title, size, (*DISPARITY, *COSTS))]
    bins = next(iter(size["entries"].values())).get("accuracy", {}).get("by_range_m", {})
    figures = [
        Figure(f"{name} {title}", MILLIMETRE, ("accuracy", "by_range_m", name, key))
        for name, item in bins.items()
        if item["count"]
        for title, key in (("mean", "mean"), ("mean + 3 sigma", "mean_plus_3sigma"))
    ]
    return [*tables, _table("map-range", "Point error by range", size, figures)] if figures else tables


def _table(name: str, title: str, part: Json, figures: Iterable[Figure], word: str = "version") -> Table:
    """Return a table with a row for each entry, then one for each ratio of ours to another.

    Args:
        name: Its name.
        title: Its title.
        part: JSON with `entries` and, optionally, `ratios`.
        figures: Columns.
        word: Key of the word that stands beside the name of an entry.
    """
    figures = tuple(figures)
    rows: list[Row] = [
        (Cell.head(entry), Cell(str(values.get(word, ""))), *(_cell(values, item, item.unit) for item in figures))
        for entry, values in part["entries"].items()
    ]
    rows += [
        (Cell.head(f"ours / {other}"), Cell(""), *(_cell(values, item, NONE) for item in figures))
        for other, values in part.get("ratios", {}).items()
    ]
    heads = (Column("", words=True), Column("", words=True))
    return Table(name, title, (*heads, *(Column(item.title, item.unit) for item in figures)), tuple(rows))


def _growth_table(result: Json) -> Table:
    work = "pixels x disparities" if result["kind"] == "map" else "pixels"
    p50 = COSTS[0]
    columns = [Column(f"{size['width']} x {size['height']}", p50.unit) for size in result["sizes"]]
    rows = []
    for name, exponent in result["growth"].items():
        times = [_cell(size["entries"][name], p50, p50.unit) for size in result["sizes"]]
        rows.append((Cell.head(name), *times, Cell.number(exponent, undefined=ABSENT)))
    columns = [Column("", words=True), *columns, Column(f"time grows as {work} to the power of")]
    return Table("growth", "Growth with size: p50", tuple(columns), tuple(rows))


def _cell(entry: Json, figure: Figure, unit: Unit) -> Cell:
    value: Any = entry
    for key in figure.place:
        value = value.get(key) if isinstance(value, Mapping) else None
    return Cell.number(value, unit=unit, undefined="")

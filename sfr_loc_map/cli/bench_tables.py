"""The figures of a bench as rich tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

Column = tuple[str, tuple[str, ...], float]
"""Heading, where the figure lies, and the factor from SI units."""

COSTS: tuple[Column, ...] = (
    ("p50 ms", ("time_s", "p50"), 1e3),
    ("p95 ms", ("time_s", "p95"), 1e3),
    ("max ms", ("time_s", "max"), 1e3),
    ("peak MiB", ("memory_bytes", "peak"), 2.0**-20),
)
DISPARITY: tuple[Column, ...] = (
    ("density", ("accuracy", "density"), 1.0),
    ("bad-1 %", ("accuracy", "bad_1"), 1e2),
    ("bad-2 %", ("accuracy", "bad_2"), 1e2),
    ("MAE px", ("accuracy", "mean_abs_px"), 1.0),
    ("sigma px", ("accuracy", "sigma_px"), 1.0),
    ("bias px", ("accuracy", "bias_px"), 1.0),
    ("coverage", ("accuracy", "coverage"), 1.0),
)

FAULT_COLUMNS: tuple[Column, ...] = (
    ("pairs", ("pairs",), 1.0),
    ("position mm", ("position_m",), 1e3),
    ("heading deg", ("heading_deg",), 1.0),
    ("lost", ("lost",), 1.0),
    ("longest", ("longest_lost",), 1.0),
    ("silent jumps", ("silent_jumps",), 1.0),
    ("largest step error / sigma", ("largest_jump_sigma",), 1.0),
    ("rows off px", ("vertical_offset_px",), 1.0),
    ("columns off px", ("disparity_offset_px",), 1.0),
)


def tables(result: Mapping[str, Any]) -> list[Table]:
    """Return the tables of a bench of any kind."""
    if result["kind"] == "score":
        return [_score_table(result)]
    if result["kind"] == "faults":
        return [
            _table(f"Localisation with faults, {result['condition']}: mean + 3 sigma", result, FAULT_COLUMNS, "fault")
        ]
    found = []
    for size in result["sizes"]:
        found += _localise_tables(result, size) if result["kind"] == "localise" else _map_tables(size)
    if len(result["sizes"]) > 1:
        found.append(_growth_table(result))
    return found


def _localise_tables(result: Mapping[str, Any], size: Mapping[str, Any]) -> list[Table]:
    errors: list[Column] = []
    for text in result["conditions"]:
        errors += [
            (f"{text} position mm", ("accuracy", text, "position_m"), 1e3),
            ("attitude deg", ("accuracy", text, "attitude_deg"), 1.0),
            ("heading deg", ("accuracy", text, "heading_deg"), 1.0),
        ]
    title = f"Localisation, {size['width']} x {size['height']}: mean + 3 sigma; host times"
    return [_table(title, size, [*errors, ("lost", ("lost",), 1.0), *COSTS])]


def _map_tables(size: Mapping[str, Any]) -> list[Table]:
    title = f"Mapping, {size['width']} x {size['height']}, {size['disparities']} disparities; host times"
    found = [_table(title, size, [*DISPARITY, *COSTS])]
    bins = next(iter(size["entries"].values())).get("accuracy", {}).get("by_range_m", {})
    columns: list[Column] = []
    for name, item in bins.items():
        if item["count"]:
            columns += [
                (f"{name} mean mm", ("accuracy", "by_range_m", name, "mean"), 1e3),
                ("mean+3sigma mm", ("accuracy", "by_range_m", name, "mean_plus_3sigma"), 1e3),
            ]
    return [*found, _table("Point error by range", size, columns)] if columns else found


def _score_table(result: Mapping[str, Any]) -> Table:
    columns: list[Column] = [
        ("sub-trajectories of 5 m", ("sub_trajectories_of_5_m",), 1.0),
        ("time s", ("time_s", "wall"), 1.0),
        ("processor s", ("time_s", "processor"), 1.0),
        ("peak MiB", ("memory_bytes", "peak"), 2.0**-20),
    ]
    return _table(f"Score of {result['poses']} poses, reading included; host times", result, columns, what="what")


def _table(title: str, part: Mapping[str, Any], columns: Sequence[Column], what: str = "version") -> Table:
    """Return a table with a row for each entry, then one for each ratio of ours to another."""
    table = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    table.add_column("")
    for heading, _, _ in columns:
        table.add_column(heading, justify="right")
    for name, entry in part["entries"].items():
        table.add_row(name, str(entry.get(what, "")), *(_cell(entry, path, factor) for _, path, factor in columns))
    table.add_section()
    for name, ratio in part.get("ratios", {}).items():
        table.add_row(f"ours / {name}", "", *(_cell(ratio, path, 1.0) for _, path, _ in columns), style="cyan")
    return table


def _growth_table(result: Mapping[str, Any]) -> Table:
    table = Table(title="Growth with size: p50 ms", title_justify="left", header_style="bold", box=SIMPLE_HEAD)
    table.add_column("")
    for size in result["sizes"]:
        table.add_column(f"{size['width']} x {size['height']}", justify="right")
    work = "pixels x disparities" if result["kind"] == "map" else "pixels"
    table.add_column(f"time grows as {work} to the power of", justify="right")
    for name, exponent in result["growth"].items():
        times = [_cell(size["entries"][name], ("time_s", "p50"), 1e3) for size in result["sizes"]]
        table.add_row(name, *times, "-" if exponent is None else f"{exponent:.2f}")
    return table


def _cell(part: Any, path: tuple[str, ...], factor: float) -> str:  # noqa: ANN401
    for key in path:
        part = part.get(key) if isinstance(part, Mapping) else None
    if part is None:
        return ""
    value = part * factor
    return f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"

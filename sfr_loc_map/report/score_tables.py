"""The tables of a score: verdicts and figures first, then all the others."""

from __future__ import annotations

import re

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score import Score, Verdict
from sfr_loc_map.report.aligned_table import aligned_table
from sfr_loc_map.report.call_tables import (
    clock_text,
    memory_table,
    stage_table,
    target_name,
    target_tables,
    time_table,
)
from sfr_loc_map.report.map_tables import map_error, map_table
from sfr_loc_map.report.method_tables import external_table, method_table
from sfr_loc_map.report.score_cells import figure, keyed_conditions, statistic_columns, statistic_row
from sfr_loc_map.report.terms import terms
from sfr_loc_map.report.trajectory_tables import association_table, component_table, consistency_table, growth_table
from sfr_loc_map.tables.markdown import to_markdown
from sfr_loc_map.tables.numbers import ABSENT, DEGREE, METRE, MIB, SECOND, SHARE, Unit, fitting, number
from sfr_loc_map.tables.table import Cell, Column, Row, Table

SUMMARY = (
    "headline",
    "aligned",
    "map",
    "time",
    "memory",
    "target-time",
    "target-memory",
    "external",
    "method",
    "verdicts",
)
"""Tables of the terminal; the verdicts stand last, where they are seen."""
_CERTAIN = {True: "yes", False: "no", None: ABSENT}


def score_tables(score: Score) -> list[Table]:
    """Return all tables of a score that have something to show, the most important first."""
    tables = (
        verdict_table(score),
        headline_table(score),
        aligned_table(score),
        growth_table(score),
        component_table(score),
        map_table(score),
        consistency_table(score),
        time_table(score),
        stage_table(score),
        memory_table(score),
        *target_tables(score),
        external_table(score),
        method_table(score),
        association_table(score),
    )
    return [table for table in tables if table is not None]


def summary_tables(score: Score) -> list[Table]:
    """Return the tables for the terminal."""
    named = {table.name: table for table in score_tables(score)}
    return [named[name] for name in SUMMARY if name in named]


def score_markdown(score: Score) -> str:
    """Return all tables as Markdown."""
    return to_markdown(score_tables(score), "Score")


def verdict_table(score: Score) -> Table | None:
    """Return the verdicts on the limits, None if no limits were given."""
    if not score.verdicts:
        return None
    columns = (
        Column("verdict", words=True),
        Column("figure", words=True),
        *(Column(title) for title in ("unit", "limit", "value", "95 % interval", "n", "certain")),
    )
    rows = tuple(_verdict_row(item, f"verdicts.{number}") for number, item in enumerate(score.verdicts))
    return Table("verdicts", "Verdicts", columns, rows, terms=terms("certain", "95 % interval", "not enough data"))


def _verdict_row(item: Verdict, key: str) -> Row:
    unit = fitting(limit_unit(item.metric), item.limit, item.value, *(item.ci95 or ()))
    sign = "≥" if item.metric.endswith("_min") else "≤"
    over = f", over {item.condition}" if item.condition is not None else ""
    return (
        Cell.verdict(item.state.value),
        Cell.head(limit_name(item.metric) + over),
        Cell(unit.symbol),
        Cell(f"{sign} {number(item.limit, unit=unit)}", item.limit, f"{key}.limit"),
        figure(item.value, f"{key}.value", unit),
        Cell.interval(item.ci95, f"{key}.ci95", unit),
        Cell.number(item.count, f"{key}.count", undefined=ABSENT),
        Cell(_CERTAIN[item.certain]),
    )


def limit_name(metric: str) -> str:
    """Return the name of a limit in words, without its unit: `position mean + 3 sigma`."""
    if metric == "coverage_min":
        return "map coverage"
    words = re.sub(r"_(m|deg|s|bytes)$", "", metric).replace("mean_plus_3sigma", "mean + 3 sigma")
    return re.sub(r"\b(localisation|mapping|fusion) (?!peak|above)", r"\1 time ", words.replace("_", " "))


def limit_unit(metric: str) -> Unit:
    """Return the unit to show a figure in, from its name in the limits, which ends in the unit of its value."""
    if metric == "coverage_min":
        return SHARE
    return MIB if metric.endswith("_bytes") else Unit(metric.rpartition("_")[2])


def headline_table(score: Score) -> Table | None:
    """Return the figures of the specification with their 95 % intervals."""
    rows: list[Row] = []
    for key, part in keyed_conditions(score):
        count = Cell.number(part.count, f"{key}.count")
        for name, unit, value in (
            ("position", METRE, part.position_m),
            ("attitude", DEGREE, part.attitude_deg),
            ("heading", DEGREE, part.heading_deg),
        ):
            title = f"{name} error over {part.condition}"
            rows.append(statistic_row(title, unit, value, f"{key}.{name}_{unit.symbol}", count))
    if score.map is not None and (error := map_error(score.map)) is not None:
        count = Cell.number(error.value.count, f"{error.key}.count")
        rows.append(statistic_row(error.title, METRE, error.value, error.key, count))
    for kind in CallKind:
        calls = score.timing.of(kind) if score.timing is not None else None
        if calls is not None:
            count = Cell.number(calls.count, f"timing.{kind}_s.count")
            rows.append(statistic_row(f"{kind} time per call", SECOND, calls, f"timing.{kind}_s", count))
    if not rows:
        return None
    columns = (
        Column("figure", words=True),
        Column("unit"),
        *statistic_columns(),
        Column("95 % interval"),
        Column("n"),
    )
    note = "Interval: of mean + 3 sigma. n: sub-trajectories, map points or calls. "
    note += frames_text(score) + clock_text(score.timing, target_name(score))
    return Table("headline", "Figures", columns, tuple(rows), note.rstrip(), _headline_terms(score))


def _headline_terms(score: Score) -> tuple[tuple[str, str], ...]:
    """Return the definitions of what the headline has."""
    names = ["mean + 3 sigma", "95 % interval"]
    if score.trajectory is not None:
        names += ["sub-trajectory", "re-based", "position error", "attitude error", "heading error", "lost", "degraded"]
    if score.map is not None:
        names.append("point error" if score.map.errors is not None else "distance to the nearest true point")
    if score.timing is not None:
        names.append("time per call")
    return terms(*names)


def frames_text(score: Score) -> str:
    """Return how many frames were scored, empty without a trajectory."""
    part = score.trajectory
    if part is None:
        return ""
    frames = f"{part.matched} frames of {part.estimate_poses} estimates, {part.lost} lost, {part.degraded} degraded"
    return f"{frames}; re-based by {part.first.rebase}. "

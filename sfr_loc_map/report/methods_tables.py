"""Several methods on the same data: one row each, their maps as differences, what each was made of."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.score import IntervalStatistic, MapScore, RangeScore, Score
from sfr_loc_map.report.map_tables import map_error
from sfr_loc_map.report.method_tables import UNTOLD, convention_text
from sfr_loc_map.tables.numbers import ABSENT, DEGREE, METRE, MIB, MILLIMETRE, MILLISECOND, number
from sfr_loc_map.tables.table import Cell, Column, Row, Table

LOCALISATION, MAPPING = CallKind.LOCALISATION, CallKind.MAPPING


def methods_tables(scores: Sequence[Score], names: Sequence[str]) -> list[Table]:
    """Return the tables of several methods side by side.

    Args:
        scores: Scores of the same data.
        names: Name of each.
    """
    named = list(zip(names, scores, strict=True))
    tables = (_methods(named), _map_differences(named), _provenance(named))
    return [table for table in tables if table is not None]


def _methods(named: Sequence[tuple[str, Score]]) -> Table:
    over = next((s.trajectory.first.condition.label for _, s in named if s.trajectory is not None), "")
    drives = any(score.trajectory is not None for _, score in named)
    maps = any(score.map is not None for _, score in named)
    columns = [Column("method", words=True), Column("kind", words=True)]
    if drives:
        figures = (("position", MILLIMETRE), ("attitude", DEGREE), ("heading", DEGREE))
        columns += [Column(f"{name} over {over}", unit) for name, unit in figures]
        columns += [Column("frames"), Column("lost")]
    if maps:
        columns += [Column("map point", MILLIMETRE), Column("coverage")]
    columns += [
        Column("time p50", MILLISECOND),
        Column("time p95", MILLISECOND),
        Column("memory", MIB),
        Column("findings"),
    ]
    rows = tuple(_method_row(name, score, drives=drives, maps=maps) for name, score in named)
    note = (
        "Errors: mean + 3 sigma, of position with its 95 % interval. Time per call: localisation / mapping; a latency "
    )
    note += "is marked, it has transport and waiting in it, and is not a time per call. Memory: largest peak."
    return Table("counts", "Methods", tuple(columns), rows, note)


def _method_row(name: str, score: Score, *, drives: bool, maps: bool) -> Row:
    method = score.method
    cells = [Cell.head(name), Cell(ABSENT if method is None else method.kind.value)]
    part = score.trajectory
    if drives and part is not None:
        first = part.first
        cells.append(_bounded(first.position_m, 1e3))
        for value in (first.attitude_deg, first.heading_deg):
            cells.append(Cell.number(value.mean_plus_3sigma, undefined=ABSENT))
        cells += [Cell.number(part.matched), Cell.number(part.lost)]
    elif drives:
        cells += [Cell(ABSENT)] * 5
    if maps:
        error = None if score.map is None else map_error(score.map)
        total = None if error is None else error.value.mean_plus_3sigma
        cells += [Cell.number(total, unit=MILLIMETRE, undefined=ABSENT)]
        cells += [Cell.number(None if score.map is None else score.map.coverage, undefined=ABSENT)]
    findings = sum(item.count for item in score.findings)
    return (*cells, Cell(_times(score, "p50")), Cell(_times(score, "p95")), Cell(_memory(score)), Cell.number(findings))


def _bounded(value: IntervalStatistic, factor: float) -> Cell:
    total, bounds = value.mean_plus_3sigma, value.mean_plus_3sigma_ci95
    if total is None:
        return Cell(ABSENT)
    text = number(factor * total)
    if bounds is not None:
        text += f" ({number(factor * bounds[0])} to {number(factor * bounds[1])})"
    return Cell(text, factor * total)


def _times(score: Score, name: str) -> str:
    known = []
    for kind in (LOCALISATION, MAPPING):
        calls = None if score.timing is None else score.timing.of(kind)
        if calls is not None:
            known.append(number(getattr(calls, name), unit=MILLISECOND))
    if not known and score.external is not None and score.external.latency_s is not None:
        return f"latency {number(getattr(score.external.latency_s, name), unit=MILLISECOND)}"
    return " / ".join(known) or ABSENT


def _memory(score: Score) -> str:
    peaks = [] if score.memory is None else [score.memory.of(kind) for kind in (LOCALISATION, MAPPING)]
    known = [number(peak.peak_bytes, unit=MIB) for peak in peaks if peak is not None and peak.peak_bytes is not None]
    return " / ".join(known) or ABSENT


def _map_differences(named: Sequence[tuple[str, Score]]) -> Table | None:
    """Return the maps by range, each less the first one; None for fewer than two maps with pixels."""
    maps = [(name, score.map) for name, score in named if score.map is not None and score.map.errors is not None]
    if len(maps) < 2:
        return None
    first_name, first = maps[0]
    columns = (
        Column("map", words=True),
        Column("range", words=True),
        Column(f"p50 of {first_name}", MILLIMETRE),
        Column("p50", MILLIMETRE),
        Column("difference", MILLIMETRE),
        Column("p95", MILLIMETRE),
        Column("difference", MILLIMETRE),
        Column("coverage"),
        Column("difference"),
    )
    rows = tuple(row for name, other in maps[1:] for row in _range_rows(name, first, other))
    note = f"Point error and coverage by true range; differences: less {first_name}. Not paired by pixel: no interval."
    return Table("map-differences", "Maps as differences", columns, rows, note)


def _range_rows(name: str, first: MapScore, other: MapScore) -> list[Row]:
    mine = {} if first.errors is None else {(item.from_m, item.to_m): item for item in first.errors.by_range}
    theirs = () if other.errors is None else other.errors.by_range
    return [_range_row(name, mine[item.from_m, item.to_m], item) for item in theirs if (item.from_m, item.to_m) in mine]


def _range_row(name: str, mine: RangeScore, other: RangeScore) -> Row:
    a, b = mine.point_error_m, other.point_error_m
    return (
        Cell.head(name),
        Cell(f"{other.from_m:g} to {other.to_m:g} {METRE.symbol}"),
        Cell.number(a.p50, unit=MILLIMETRE, undefined=ABSENT),
        Cell.number(b.p50, unit=MILLIMETRE, undefined=ABSENT),
        Cell.number(_less(b.p50, a.p50), unit=MILLIMETRE, undefined=ABSENT, signed=True),
        Cell.number(b.p95, unit=MILLIMETRE, undefined=ABSENT),
        Cell.number(_less(b.p95, a.p95), unit=MILLIMETRE, undefined=ABSENT, signed=True),
        Cell.number(other.coverage, undefined=ABSENT),
        Cell.number(_less(other.coverage, mine.coverage), undefined=ABSENT, signed=True),
    )


def _less(value: float | None, first: float | None) -> float | None:
    return None if value is None or first is None else value - first


def _provenance(named: Sequence[tuple[str, Score]]) -> Table:
    columns = tuple(
        Column(title, words=True)
        for title in (
            "method",
            "name and version",
            "poses converted",
            "estimate or cloud",
            "sha256",
            "scored by",
            "time",
        )
    )
    return Table("provenance", "What each was made of", columns, tuple(_origin_row(*item) for item in named))


def _origin_row(name: str, score: Score) -> Row:
    method, origin = score.method, score.provenance
    inputs = {} if origin is None else origin.inputs
    own = inputs.get("estimate") or inputs.get("cloud")
    return (
        Cell.head(name),
        Cell(UNTOLD if method is None else f"{method.name} {method.version or ''}".strip()),
        Cell(ABSENT if score.convention is None else convention_text(score.convention)),
        Cell(ABSENT if own is None else own.path),
        Cell(ABSENT if own is None else own.sha256[:16]),
        Cell(UNTOLD if origin is None else f"sfr_loc_map {origin.version}"),
        Cell(UNTOLD if origin is None or origin.time is None else origin.time),
    )

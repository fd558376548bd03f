"""The table of absolute and relative error, as other tools give them."""

from __future__ import annotations

from dataclasses import fields

from sfr_loc_map.metrics.score import ErrorStatistics, Score
from sfr_loc_map.report.score_cells import figure
from sfr_loc_map.tables.numbers import DEGREE, METRE
from sfr_loc_map.tables.table import Cell, Column, Row, Table

NAMES = tuple(item.name for item in fields(ErrorStatistics))


def aligned_table(score: Score) -> Table | None:
    """Return APE and RPE, None where no alignment was asked for."""
    if score.aligned is None:
        return None
    rows: list[Row] = []
    for key, part in (("ape", score.aligned.ape), ("rpe", score.aligned.rpe)):
        for name, unit, values, place in (
            ("position", METRE, part.translation, key),
            ("attitude", DEGREE, part.rotation_deg, f"{key}.rotation_deg"),
        ):
            cells = (figure(getattr(values, item), f"{place}.{item}") for item in NAMES)
            count = Cell.number(part.count, f"{key}.count")
            head = Cell.head(f"{key.upper()}, {name}, align {part.alignment}")
            rows.append((head, Cell(unit.symbol), *cells, count))
    columns = (Column("error", words=True), Column("unit"), *map(Column, NAMES), Column("n"))
    note = f"{score.aligned.ape.description}. {score.aligned.rpe.description}. Not figures of the specification."
    return Table("aligned", "Absolute and relative error as other tools give it", columns, tuple(rows), note)

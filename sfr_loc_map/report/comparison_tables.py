"""The tables of a comparison of scores."""

from __future__ import annotations

from sfr_loc_map.metrics.comparison import Comparison, PairedDifference
from sfr_loc_map.tables.numbers import ABSENT, Unit, fitting
from sfr_loc_map.tables.table import Cell, Column, Row, Table


def comparison_tables(result: Comparison) -> list[Table]:
    """Return the tables of a comparison: pairs of sub-trajectories, whole runs side by side."""
    names = result.names
    tables = []
    if result.pairs:
        title = f"Mean + 3 sigma, compared with {names[0]}, paired by sub-trajectory"
        columns = (
            Column("figure", words=True),
            Column("of", words=True),
            *(Column(heading) for heading in (names[0], "other", "difference", "95 % interval", "n", "p, corrected")),
            Column("the other is", words=True),
        )
        note = "The other is better or worse where the interval does not hold zero. p: of such a difference by chance, "
        note += f"corrected for {len(result.pairs)} comparisons (Holm)."
        tables.append(Table("pairs", title, columns, tuple(map(_pair_row, result.pairs)), note))
    if result.side_by_side:
        title = "Whole runs, side by side (not paired: no interval)"
        columns = (Column("figure", words=True), *(Column(name) for name in names))
        rows = tuple(
            (Cell.head(row.figure), *(Cell.number(value, undefined=ABSENT) for value in row.values))
            for row in result.side_by_side
        )
        tables.append(Table("runs", title, columns, rows))
    return tables


def _pair_row(pair: PairedDifference) -> Row:
    name, _, symbol = pair.figure.partition("_")
    unit = fitting(Unit(symbol), pair.first, pair.other)
    return (
        Cell.head(f"{name}, {unit.symbol}, over {pair.condition.label}"),
        Cell(pair.name),
        Cell.number(pair.first, unit=unit, undefined=ABSENT),
        Cell.number(pair.other, unit=unit, undefined=ABSENT),
        Cell.number(pair.difference, unit=unit, undefined=ABSENT, signed=True),
        Cell.interval(pair.ci95, unit=unit, signed=True),
        Cell.number(pair.count),
        Cell.number(pair.p_corrected, undefined=ABSENT),
        Cell(pair.outcome.value),
    )

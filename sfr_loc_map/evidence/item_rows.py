"""Lines of the tables of a check: the figures that have the same condition and part, as cells that name their keys."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.report.tables import NONE, Cell, Unit


class Item(NamedTuple):
    """One line of a table: the figures that have the same condition and part."""

    condition: str | None
    part: str | None
    rows: dict[str, Figure]  #: Rows by the name of their figure.
    indices: dict[str, int]  #: Index of each row in the figures of the check, by the name of the figure.

    def number(self, figure: str, name: str = "value") -> float | None:
        """Return a number of a figure."""
        return self.rows[figure].statistic(name)

    def cell(self, figure: str, name: str = "value", unit: Unit = NONE) -> Cell:
        """Return a number of a figure as a cell."""
        return Cell.number(self.number(figure, name), f"figures.{self.indices[figure]}.{name}", unit)


def items_with(figure: str, figures: Sequence[Figure]) -> list[Item]:
    """Return the items that have a figure, in the order of the figures of a check.

    InputError if two rows have the same figure, condition and part, because one line cannot show both.
    """
    items: dict[tuple[str | None, str | None], Item] = {}
    for index, row in enumerate(figures):
        item = items.setdefault((row.condition, row.part), Item(row.condition, row.part, {}, {}))
        if row.figure in item.rows:
            raise InputError(f"two figures of the check have the name '{row.label}': each name must be unique")
        item.rows[row.figure] = row
        item.indices[row.figure] = index
    return [item for item in items.values() if figure in item.rows]

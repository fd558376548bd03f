"""Items of the tables of a check: the figures with one condition and part, as cells that name their keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sfr_loc_map.metrics.table import Figure
from sfr_loc_map.report.tables import NONE, Cell, Unit


class Item(NamedTuple):
    """The figures with one condition and part."""

    condition: str | None
    part: str | None
    figures: Sequence[Figure]  #: All figures of the check.
    places: Mapping[str, int]  #: Index of each figure of the item among all figures, by its name.

    def number(self, figure: str, name: str = "value") -> float | None:
        """Return a number of a figure."""
        return self.figures[self.places[figure]].statistic(name)

    def cell(self, figure: str, name: str = "value", unit: Unit = NONE) -> Cell:
        """Return a number of a figure as a cell."""
        return Cell.number(self.number(figure, name), f"figures.{self.places[figure]}.{name}", unit)


def items_with(figure: str, figures: Sequence[Figure]) -> list[Item]:
    """Return the items that have a figure, in the order of the figures."""
    places: dict[tuple[str | None, str | None], dict[str, int]] = {}
    for place, row in enumerate(figures):
        places.setdefault((row.condition, row.part), {})[row.figure] = place
    return [Item(*keys, figures, at) for keys, at in places.items() if figure in at]

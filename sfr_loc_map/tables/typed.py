"""Tables of typed rows: each column has a title, a unit and a function that returns the value of a row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from sfr_loc_map.tables.model import ABSENT, NONE, Bounds, Cell, Column, Table, Unit

Row = TypeVar("Row")
RowUnit = Unit | Callable[[Row], Unit]
"""Unit of a column, or function that returns the unit of a row if the rows have different units."""


@dataclass(frozen=True, slots=True)
class RowColumn(Generic[Row]):
    """A column of a table with rows of one type."""

    column: Column
    cell: Callable[[Row], Cell]


def heads(title: str, of: Callable[[Row], str], link: Callable[[Row], str] = lambda row: "") -> RowColumn[Row]:
    """Return the column of the heads of the rows, each with the relative link of its row."""
    return RowColumn(Column(title, words=True), lambda row: replace(Cell.head(of(row)), link=link(row)))


def words(title: str, of: Callable[[Row], str | None], link: Callable[[Row], str] = lambda row: "") -> RowColumn[Row]:
    """Return a column of texts; an empty text is displayed as absent."""
    return RowColumn(Column(title, words=True), lambda row: Cell(of(row) or ABSENT, link=link(row)))


def numbers(
    title: str, of: Callable[[Row], float | None], unit: RowUnit[Row] = NONE, undefined: str = ABSENT
) -> RowColumn[Row]:
    """Return a column of numbers, which have no key in the JSON of a score."""
    return RowColumn(_column(title, unit), lambda row: Cell.number(of(row), "", _unit(unit, row), undefined))


def intervals(title: str, of: Callable[[Row], Bounds | None], unit: RowUnit[Row] = NONE) -> RowColumn[Row]:
    """Return a column of intervals, which have no key in the JSON of a score."""
    return RowColumn(_column(title, unit), lambda row: Cell.interval(of(row), "", _unit(unit, row)))


def table_of(name: str, title: str, columns: Sequence[RowColumn[Row]], rows: Iterable[Row], note: str = "") -> Table:
    """Return a table with a row of cells for each row."""
    cells = tuple(tuple(column.cell(row) for column in columns) for row in rows)
    return Table(name, title, tuple(item.column for item in columns), cells, note)


def _column(title: str, unit: RowUnit[Row]) -> Column:
    return Column(title, unit if isinstance(unit, Unit) else NONE)


def _unit(unit: RowUnit[Row], row: Row) -> Unit:
    return unit if isinstance(unit, Unit) else unit(row)

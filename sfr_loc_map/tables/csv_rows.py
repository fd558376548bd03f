"""Tables as CSV, one row for each figure, exactly and in the unit of its source."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator

from sfr_loc_map.tables.table import Cell, CellKind, Table

COLUMNS = ("table", "row", "column", "key", "value")


def to_csv(tables: Iterable[Table]) -> str:
    """Return every figure in a row of its own: table, row, column, key, value.

    The value is in the unit that its key ends in, whatever unit suits the tables, so the column is named without one. A
    figure that is not defined has no value; the bounds of an interval are two rows.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for table in tables:
        for row in table.rows:
            head = next((cell.text for cell in row if cell.kind is CellKind.HEAD), "")
            for column, cell in zip(table.columns, row, strict=True):
                writer.writerows((table.name, head, column.title, key, text) for key, text in _figures(cell))
    return buffer.getvalue()


def _figures(cell: Cell) -> Iterator[tuple[str, str]]:
    """Yield key and exact value of each figure in a cell."""
    if cell.kind is CellKind.VERDICT:
        yield "", cell.text
    elif isinstance(cell.value, tuple):
        yield from ((f"{cell.key}.{k}", repr(bound)) for k, bound in enumerate(cell.value))
    elif cell.key:
        yield cell.key, "" if cell.value is None else repr(cell.value)

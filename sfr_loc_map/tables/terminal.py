"""Tables on the terminal, with rich."""

from __future__ import annotations

from collections.abc import Iterable

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from sfr_loc_map.tables.table import Cell, CellKind, Table

COLOURS = {"pass": "green", "fail": "bold red"}
OPEN_COLOUR = "yellow"
FILE_WIDTH = 150
"""Characters of a line where the output is no terminal."""


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables to standard output."""
    console = Console()
    console = console if console.is_terminal else Console(width=FILE_WIDTH)
    for table in tables:
        console.print(to_rich(table))


def to_rich(table: Table) -> RichTable:
    """Return a table as rich prints it: titles and texts as they are, without markup."""
    shown = RichTable(
        title=Text(table.title),
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
        pad_edge=False,
        caption=Text(table.note) if table.note else None,
        caption_justify="left",
    )
    for column in table.columns:
        shown.add_column(Text(column.heading), justify="left" if column.words else "right")
    for row in table.rows:
        shown.add_row(*map(_text, row))
    return shown


def _text(cell: Cell) -> Text:
    style = COLOURS.get(cell.text, OPEN_COLOUR) if cell.kind is CellKind.VERDICT else ""
    return Text(cell.text, style)

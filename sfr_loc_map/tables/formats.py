"""The formats of a table: terminal, HTML, Markdown and CSV.

All formats but CSV have the same texts. Markdown and HTML have an icon before a verdict. The terminal has the colour of
the verdict instead. CSV contains the exact values.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING
from urllib.parse import quote

from sfr_loc_map.message_text import printable
from sfr_loc_map.tables.model import Cell, CellKind, Column, Table

if TYPE_CHECKING:
    from rich.table import Table as RichTable

FORMULA_STARTS = ("=", "+", "-", "@", "\t")  #: Characters with which a spreadsheet begins a formula.
ENDS = ("low95", "high95")  #: Keys of the bounds of an interval, below the key of its cell.
LEAN_ROWS = 300  #: Tables with more rows omit keys and exact values, so that large pages stay small.
WORDS = ' class="words"'  #: Attribute of words and their heading, which are aligned to the left.


def print_tables(tables: Iterable[Table]) -> None:
    """Print tables to standard output."""
    from rich.console import Console

    console = Console()
    console = console if console.is_terminal else Console(width=150)  # output to a file
    for table in tables:
        console.print(to_rich(table))


def to_rich(table: Table) -> RichTable:
    """Return a table for rich, with titles and texts taken literally."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

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
        shown.add_column(Text(column.heading), justify="left" if column.words else "right", overflow="fold")
    for row in table.rows:
        styles = ("" if cell.style is None else cell.style.colour for cell in row)
        texts = (f"{cell.sign} {cell.text}" if cell.mark else cell.text for cell in row)
        shown.add_row(*(Text(text, style) for text, style in zip(texts, styles, strict=True)))
    return shown


def to_html(table: Table) -> str:
    """Return a section with title, table and note, all texts escaped. Figures have value and key as attributes."""
    heads = "".join(f'<th scope="col"{WORDS * column.words}>{escape(column.heading)}</th>' for column in table.columns)
    lean = len(table.rows) > LEAN_ROWS
    rows = "\n".join(
        f"<tr>{''.join(_html_cell(*pair, lean=lean) for pair in zip(row, table.columns, strict=True))}</tr>"
        for row in table.rows
    )
    note = f'\n<p class="note">{escape(table.note)}</p>' if table.note else ""
    return (
        f'<div class="table" id="table-{escape(table.name)}">\n<h3>{escape(table.title)}</h3>\n'
        f'<div class="scroll"><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table></div>'
        f"{note}\n</div>\n"
    )


def _html_cell(cell: Cell, column: Column, *, lean: bool) -> str:
    text = escape(cell.text)
    if cell.link:
        text = f'<a href="{escape(_url_of(cell.link))}">{text}</a>'
    if cell.kind is CellKind.HEAD:
        return f'<th scope="row">{text}</th>'
    if cell.style is not None:
        return (
            f'<td class="verdict {cell.style.css}"><span class="icon" aria-hidden="true">{cell.icon}</span> {text}</td>'
        )
    classes = " ".join(filter(None, ("words" if column.words else "", cell.mark)))
    attributes = f' class="{classes}"' if classes else ""
    if cell.key and not lean:
        attributes += f' data-key="{escape(cell.key)}"'
    if cell.mark:
        text = f'<span title="{cell.mark} of the column">{cell.sign}</span>&nbsp;{text}'
    if isinstance(cell.value, (int, float)) and not lean:
        attributes += f' data-value="{cell.value}" title="{f"{escape(cell.key)} = " if cell.key else ""}{cell.value}"'
    return f"<td{attributes}>{text}</td>"


def _url_of(link: str) -> str:
    """Return a relative link as a URL; bytes of a file name that are not UTF-8 remain as they are."""
    try:
        return quote(link, errors="surrogateescape")
    except UnicodeEncodeError:  # surrogates that do not represent bytes
        return quote(link, errors="replace")


def to_markdown(tables: Iterable[Table], title: str = "") -> str:
    """Return tables as Markdown, under a common heading if `title` is given."""

    def escaped(text: str) -> str:
        """Return a text with Markdown characters escaped."""
        return re.sub(r"([\\`*_<>|\[\]])", r"\\\1", " ".join(text.split()))

    def line(texts: Iterable[str]) -> str:
        return "| " + " | ".join(map(escaped, texts)) + " |"

    lines = [f"# {escaped(title)}", ""] if title else []
    for table in tables:
        lines += [f"## {escaped(table.title)}", ""] if table.title else []
        lines += [line(column.heading for column in table.columns), line(["---"] * len(table.columns))]
        lines += [line(f"{cell.sign} {cell.text}".lstrip() for cell in row) for row in table.rows]
        lines += ["", *([escaped(table.note), ""] if table.note else [])]
    return "\n".join(lines)


def to_csv(tables: Iterable[Table]) -> str:
    """Return one CSV row per figure, in the unit of its key. The bounds of an interval are two rows."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(("table", "row", "column", "key", "value"))
    for table in tables:
        for row in table.rows:
            head = next((cell.text for cell in row if cell.kind is CellKind.HEAD), "")
            for column, cell in zip(table.columns, row, strict=True):
                found: list[tuple[str, str]] = []
                if cell.kind in (CellKind.VERDICT, CellKind.WORD):
                    found = [(cell.key, csv_text(cell.text))]
                elif isinstance(cell.value, tuple) and cell.key:
                    found = [(f"{cell.key}.{end}", repr(bound)) for end, bound in zip(ENDS, cell.value, strict=True)]
                elif cell.key:
                    found = [(cell.key, "" if cell.value is None else repr(cell.value))]
                words = csv_text(table.name), csv_text(head), csv_text(column.title)
                writer.writerows((*words, *item) for item in found)
    return buffer.getvalue()


def csv_text(text: str) -> str:
    """Return a text for a cell of a CSV file, printable and with an apostrophe before the start of a formula.

    A spreadsheet would otherwise execute the text of a requirement that begins with `=`.
    """
    shown = printable(text)
    return f"'{shown}" if shown.startswith(FORMULA_STARTS) else shown

"""A table as HTML, every text escaped; each figure keeps its exact value and its key as attributes."""

from __future__ import annotations

from html import escape
from urllib.parse import quote

from sfr_loc_map.tables.table import Cell, CellKind, Column, Table

OPEN_CLASS = "open"
WORDS = ' class="words"'
"""Attribute of words and of the heading over them: they are aligned to the left."""
VERDICT_CLASSES = {"pass": "pass", "fail": "fail"}
"""Class of the style of a verdict; every other is open."""


def to_html(table: Table) -> str:
    """Return a section with title, table and note."""
    heads = "".join(f'<th scope="col"{WORDS * column.words}>{escape(column.heading)}</th>' for column in table.columns)
    rows = "\n".join(f"<tr>{''.join(map(_cell, row, table.columns))}</tr>" for row in table.rows)
    note = f'\n<p class="note">{escape(table.note)}</p>' if table.note else ""
    return (
        f'<div class="table" id="table-{escape(table.name)}">\n<h3>{escape(table.title)}</h3>\n'
        f'<div class="scroll"><table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table></div>'
        f"{note}{_terms(table)}\n</div>\n"
    )


def _terms(table: Table) -> str:
    """Return the definitions as a list, empty without any."""
    items = "".join(f"<div><dt>{escape(word)}</dt><dd>{escape(text)}</dd></div>" for word, text in table.terms)
    return f'\n<dl class="terms">{items}</dl>' if items else ""


def _cell(cell: Cell, column: Column) -> str:
    text = escape(cell.text)
    if cell.link:
        text = f'<a href="{escape(quote(cell.link))}">{text}</a>'
    if cell.kind is CellKind.HEAD:
        return f'<th scope="row">{text}</th>'
    if cell.kind is CellKind.VERDICT:
        style = VERDICT_CLASSES.get(cell.text, OPEN_CLASS)
        return f'<td class="verdict {style}"><span class="icon" aria-hidden="true">{cell.icon}</span> {text}</td>'
    place = f' data-key="{escape(cell.key)}"' if cell.key else ""
    if isinstance(cell.value, (int, float)):
        place += f' data-value="{cell.value}" title="{escape(cell.key)} = {cell.value}"'
    return f"<td{WORDS * column.words}{place}>{text}</td>"

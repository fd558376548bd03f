"""Tables as Markdown (GitHub's pipe tables)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from sfr_loc_map.tables.table import Cell, Table


def to_markdown(tables: Iterable[Table], title: str = "") -> str:
    """Return tables below each other, each with its title and note if it has them, under one heading if it is given."""
    lines = [f"# {_plain(title)}", ""] if title else []
    for table in tables:
        lines += [f"## {_plain(table.title)}", ""] if table.title else []
        lines += [*_rows(table), ""]
        lines += [_plain(table.note), ""] if table.note else []
        lines += [*(f"- **{_plain(word)}**: {_plain(text)}" for word, text in table.terms), ""] if table.terms else []
    return "\n".join(lines)


def _rows(table: Table) -> list[str]:
    heads = _line([column.heading for column in table.columns])
    return [heads, _line(["---"] * len(table.columns)), *(_line([_text(cell) for cell in row]) for row in table.rows)]


def _text(cell: Cell) -> str:
    return f"{cell.icon} {cell.text}" if cell.icon else cell.text


def _line(texts: Sequence[str]) -> str:
    return "| " + " | ".join(_plain(text) for text in texts) + " |"


def _plain(text: str) -> str:
    """Return text that Markdown shows as it is."""
    return re.sub(r"([\\`*_<>|\[\]])", r"\\\1", " ".join(text.split()))

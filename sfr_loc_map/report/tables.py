"""The tables of a score as Markdown and as CSV."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sfr_loc_map.report.cells import VERDICT_ICONS, Cell, dig
from sfr_loc_map.report.score_tables import score_tables


def to_markdown(score: Mapping[str, Any]) -> str:
    """Return all tables as Markdown (GitHub's pipe tables)."""
    lines = ["# Score", ""]
    for table in score_tables(score):
        lines += [f"## {_plain(table.title)}", "", _line(table.columns), _line(["---"] * len(table.columns))]
        lines += [_line([_sign(cell) for cell in row]) for row in table.rows]
        lines += ["", _plain(table.note), ""] if table.note else [""]
    return "\n".join(lines)


def _sign(cell: Cell) -> str:
    return f"{VERDICT_ICONS.get(cell.text, '?')} {cell.text}" if cell.kind == "verdict" else cell.text


def _line(texts: Sequence[str]) -> str:
    return "| " + " | ".join(_plain(text) for text in texts) + " |"


def _plain(text: str) -> str:
    """Return text that Markdown shows as it is."""
    return re.sub(r"([\\`*_<>|\[\]])", r"\\\1", " ".join(text.split()))


def to_csv(score: Mapping[str, Any]) -> str:
    """Return every figure in a row of its own, exactly and in the unit of the JSON: table, row, column, key, value.

    An undefined figure has no value; the bounds of an interval are two rows.
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(("table", "row", "column", "key", "value"))
    for table in score_tables(score):
        for row in table.rows:
            head = next(cell.text for cell in row if cell.kind == "head")
            for column, cell in zip(table.columns, row, strict=True):
                writer.writerows((table.name, head, column, key, value) for key, value in _exact(score, cell))
    return buffer.getvalue()


def _exact(score: Mapping[str, Any], cell: Cell) -> Iterator[tuple[str, str]]:
    if cell.kind == "verdict":
        yield "", cell.text
    elif cell.key:
        value = dig(score, cell.key)
        values = enumerate(value) if isinstance(value, list) else [(None, value)]
        for k, item in values:
            yield cell.key if k is None else f"{cell.key}.{k}", "" if item is None else repr(item)

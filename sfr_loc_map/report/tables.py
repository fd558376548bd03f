"""Tables of figures: numbers with units, a model of tables, and renderers for terminal, HTML, Markdown and CSV.

Terminal, page, live page and Markdown show the same strings. CSV contains the exact values.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from html import escape
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

from sfr_loc_map.inputs import printable
from sfr_loc_map.metrics.intervals import Interval

if TYPE_CHECKING:
    from rich.table import Table as RichTable

UNKNOWN, NOT_ENOUGH, ABSENT = "unknown", "not enough data", "-"
"""Texts of an unknown fact, an undefined figure, and a figure that does not apply."""


# ---- numbers


SHOWN_UNITS = {"mm": ("m", 1e-3), "ms": ("s", 1e-3), "%": ("1", 1e-2), "MiB": ("bytes", 2.0**20)}
"""Displayed units, each with the unit of the values and the size of the displayed unit in this unit."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A displayed unit; `size` is its size in the unit of the values, for example 1e-3 for ms and values in s."""

    symbol: str = ""
    size: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", SHOWN_UNITS.get(self.symbol, (self.symbol, 1.0))[1])

    @property
    def of_values(self) -> str:
        """Symbol of the unit of the values."""
        return SHOWN_UNITS.get(self.symbol, (self.symbol, 1.0))[0]


NONE, METRE, MILLIMETRE, MILLISECOND, PERCENT, MIB = map(Unit, ("", "m", "mm", "ms", "%", "MiB"))


def fitting(unit: Unit, *values: float | None) -> Unit:
    """Return the common display unit of values that are compared: 3.2 mm instead of 0.0032 m."""
    limit, smaller = {"m": (1.0, MILLIMETRE), "s": (10.0, MILLISECOND)}.get(unit.symbol, (0.0, unit))
    largest = max((abs(value) for value in values if value is not None and math.isfinite(value)), default=0.0)
    return smaller if 0.0 < largest < limit else unit


def number(value: float | int | None, unit: Unit = NONE, undefined: str = UNKNOWN, *, signed: bool = False) -> str:
    """Return a value in a unit with four significant digits, integers in full; return `undefined` for None."""
    if value is None:
        return undefined
    shown = value if unit.size == 1.0 else value / unit.size
    sign = "+" if signed else ""
    if isinstance(shown, int) or 1e4 <= abs(shown) < 1e7:
        return f"{shown:{sign}.0f}"
    return f"{shown:{sign}.4g}"


# ---- the table


class CellKind(StrEnum):
    """Role of a cell."""

    PLAIN = ""
    HEAD = "head"
    VERDICT = "verdict"


@dataclass(frozen=True, slots=True)
class Column:
    """A column: title, unit of all values (empty if the rows differ), and whether the column contains words."""

    title: str
    unit: Unit = NONE
    words: bool = False

    def __post_init__(self) -> None:
        # the title may be a file name
        object.__setattr__(self, "title", printable(self.title))

    @property
    def heading(self) -> str:
        """Title with unit: `mean, m`."""
        return f"{self.title}, {self.unit.symbol}" if self.unit.symbol else self.title


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell."""

    text: str
    #: Exact value in the unit of its source, or both bounds of an interval; None for words and undefined values.
    value: float | int | Interval | None = None
    #: Origin in the score, such as `figures.3.mean`; empty for text. For an interval, the row that has both bounds.
    key: str = ""
    kind: CellKind = CellKind.PLAIN
    link: str = ""  #: Relative link to a page about the cell; empty if there is none.
    mark: str = ""  #: One of `MARKS`; empty if there is none.

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", printable(self.text))

    @classmethod
    def head(cls, text: str) -> Cell:
        """Return the head of a row."""
        return cls(text, kind=CellKind.HEAD)

    @classmethod
    def verdict(cls, word: str) -> Cell:
        """Return a verdict."""
        return cls(word, kind=CellKind.VERDICT)

    @classmethod
    def number(
        cls, value: float | None, key: str = "", unit: Unit = NONE, undefined: str = UNKNOWN, *, signed: bool = False
    ) -> Cell:
        """Return a figure, displayed in a unit."""
        return cls(number(value, unit, undefined, signed=signed), value, key)

    @classmethod
    def interval(
        cls, bounds: Interval | None, key: str = "", unit: Unit = NONE, undefined: str = ABSENT, *, signed: bool = False
    ) -> Cell:
        """Return an interval, displayed in a unit."""
        if not bounds:
            return cls(undefined)
        return cls(" to ".join(number(bound, unit=unit, signed=signed) for bound in bounds), bounds, key)

    @property
    def icon(self) -> str:
        """Icon of a verdict; empty for other cells."""
        return VERDICTS.get(self.text, OPEN).icon if self.kind is CellKind.VERDICT else ""


class VerdictStyle(NamedTuple):
    """Icon and colour of a verdict. The colour only repeats the word and the icon."""

    icon: str
    css: str
    colour: str


ENDS = ("low95", "high95")  #: Keys of the bounds of an interval, below the key of its cell.
MARKS = {"best": "★", "worst": "✕"}  #: Marks in a column. An arrow would suggest that larger is better.
LEAN_ROWS = 300  #: Tables with more rows omit keys and exact values, so that large pages stay small.
VERDICTS = {"pass": VerdictStyle("✔", "pass", "green"), "fail": VerdictStyle("✖", "fail", "bold red")}
OPEN = VerdictStyle("?", "open", "yellow")  #: Style of every other verdict.
Row = tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """One table."""

    name: str  #: Used as an anchor and in CSV.
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    note: str = ""  #: Explanation of the figures.

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", printable(self.title))
        object.__setattr__(self, "note", printable(self.note))


# ---- renderers


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
        styles = (VERDICTS.get(cell.text, OPEN).colour if cell.kind is CellKind.VERDICT else "" for cell in row)
        texts = (f"{MARKS[cell.mark]} {cell.text}" if cell.mark else cell.text for cell in row)
        shown.add_row(*(Text(text, style) for text, style in zip(texts, styles, strict=True)))
    return shown


WORDS = ' class="words"'  #: Attribute of words and their heading, which are aligned to the left.


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
        text = f'<a href="{escape(quote(cell.link))}">{text}</a>'
    if cell.kind is CellKind.HEAD:
        return f'<th scope="row">{text}</th>'
    if cell.kind is CellKind.VERDICT:
        css = VERDICTS.get(cell.text, OPEN).css
        return f'<td class="verdict {css}"><span class="icon" aria-hidden="true">{cell.icon}</span> {text}</td>'
    place = f' data-key="{escape(cell.key)}"' if cell.key and not lean else ""
    if cell.mark:
        place += f' class="{cell.mark}"'
        text = f'<span title="{cell.mark} of the column">{MARKS[cell.mark]}</span> {text}'
    if isinstance(cell.value, (int, float)) and not lean:
        place += f' data-value="{cell.value}" title="{escape(cell.key)} = {cell.value}"'
    return f"<td{WORDS * column.words}{place}>{text}</td>"


def to_markdown(tables: Iterable[Table], title: str = "") -> str:
    """Return tables as Markdown, under a common heading if `title` is given."""

    def plain(text: str) -> str:
        """Return a text with Markdown characters escaped."""
        return re.sub(r"([\\`*_<>|\[\]])", r"\\\1", " ".join(text.split()))

    def line(texts: Iterable[str]) -> str:
        return "| " + " | ".join(map(plain, texts)) + " |"

    lines = [f"# {plain(title)}", ""] if title else []
    for table in tables:
        lines += [f"## {plain(table.title)}", ""] if table.title else []
        lines += [line(column.heading for column in table.columns), line(["---"] * len(table.columns))]
        lines += [line(f"{cell.icon} {cell.text}" if cell.icon else cell.text for cell in row) for row in table.rows]
        lines += ["", *([plain(table.note), ""] if table.note else [])]
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
                if cell.kind is CellKind.VERDICT:
                    found = [("", cell.text)]
                elif isinstance(cell.value, tuple):
                    found = [(f"{cell.key}.{end}", repr(bound)) for end, bound in zip(ENDS, cell.value, strict=True)]
                elif cell.key:
                    found = [(cell.key, "" if cell.value is None else repr(cell.value))]
                writer.writerows((table.name, head, column.title, *item) for item in found)
    return buffer.getvalue()

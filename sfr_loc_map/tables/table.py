"""A table: columns with units, cells with the exact value and the place that it comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.printable import printable
from sfr_loc_map.tables.numbers import ABSENT, NONE, UNKNOWN, Unit, number

VERDICT_ICONS = {"pass": "✔", "fail": "✖"}
"""A verdict is told by word and sign; colour only repeats it."""
OPEN_ICON = "?"
"""Sign of every other verdict."""


class CellKind(StrEnum):
    """What a cell is for."""

    PLAIN = ""
    HEAD = "head"
    VERDICT = "verdict"


@dataclass(frozen=True, slots=True)
class Column:
    """A column.

    Attributes:
        title: What it holds.
        unit: Unit of all its values; without a symbol where the rows differ in it.
        words: Whether it holds words: these are aligned to the left.
    """

    title: str
    unit: Unit = NONE
    words: bool = False

    def __post_init__(self) -> None:
        """Make the title fit for a terminal: it may be the name of a file."""
        object.__setattr__(self, "title", printable(self.title))

    @property
    def heading(self) -> str:
        """Title with unit: `mean, m`."""
        return f"{self.title}, {self.unit.symbol}" if self.unit.symbol else self.title


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell.

    Attributes:
        text: What is shown.
        value: The same exactly, in the unit of its source; both bounds of an interval; None for words and for what is
            not defined.
        key: Where it comes from, such as `trajectory.position_m.mean`; empty for words.
        kind: Head of a row, verdict, or neither.
        link: Place of a page about it, relative to the page that the table stands in; empty for none.
    """

    text: str
    value: float | int | tuple[float, float] | None = None
    key: str = ""
    kind: CellKind = CellKind.PLAIN
    link: str = ""

    def __post_init__(self) -> None:
        """Make the text fit for a terminal: it may come from a file."""
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
        cls,
        value: float | int | None,
        key: str = "",
        unit: Unit = NONE,
        undefined: str = UNKNOWN,
        *,
        signed: bool = False,
    ) -> Cell:
        """Return a figure shown in a unit."""
        return cls(number(value, undefined, unit, signed=signed), value, key)

    @classmethod
    def interval(
        cls,
        bounds: Sequence[float] | None,
        key: str = "",
        unit: Unit = NONE,
        undefined: str = ABSENT,
        *,
        signed: bool = False,
    ) -> Cell:
        """Return an interval shown in a unit."""
        if not bounds:
            return cls(undefined)
        low, high = bounds
        text = " to ".join(number(bound, unit=unit, signed=signed) for bound in (low, high))
        return cls(text, (low, high), key)

    @property
    def icon(self) -> str:
        """Sign of a verdict, empty for other cells."""
        return VERDICT_ICONS.get(self.text, OPEN_ICON) if self.kind is CellKind.VERDICT else ""


Row = tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """One table.

    Attributes:
        name: Short name, used as an anchor and in CSV.
        title: What it shows.
        columns: Its columns.
        rows: As many cells as columns in each.
        note: How the figures are to be read.
        terms: Words of the table with their definitions, shown where there is room: in pages and in Markdown.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    note: str = ""
    terms: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Make the texts fit for a terminal: they may come from a file."""
        object.__setattr__(self, "title", printable(self.title))
        object.__setattr__(self, "note", printable(self.note))

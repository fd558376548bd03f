"""The model of a table: numbers with units, cells, columns and rows.

The columns and rows of a table are laid out where the table is made: for a score in `report.score_tables`, for other
results in the module of the result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from decimal import Decimal
from enum import StrEnum
from typing import NamedTuple

from sfr_loc_map.message_text import printable

Bounds = tuple[float, float]  #: Lower and upper bound of an interval.
UNKNOWN, NOT_ENOUGH, ABSENT = "unknown", "not enough data", "-"
"""Texts of an unknown fact, an undefined figure, and a figure that does not apply."""


# ---- numbers


SHOWN_UNITS = {
    "mm": ("m", 1e-3),
    "ms": ("s", 1e-3),
    "%": ("1", 1e-2),
    "MiB": ("bytes", 2.0**20),
    "MB": ("bytes", 1e6),
    "GB": ("bytes", 1e9),
}
"""Displayed units, each with the unit of the values and with its size in that unit: 1 mm is 1e-3 m."""
SIGNIFICANT_DIGITS = 4  #: Significant digits of displayed values.
MAX_DIGITS = 17  #: Significant digits that distinguish any two values.
LARGEST_IN_FULL = 1e7  #: Values of this size or larger are written with an exponent, unless they are integers.
LARGEST_INTEGER = 1e16  #: Given integers of this size or larger are written with an exponent.
ROUNDING_OF_DIFFERENCE = 0.1  #: Largest rounding error of a value as a fraction of its difference from its limit.
ROUNDING_OF_UNITS = 1e-14  #: Relative error of a conversion of units.


@dataclass(frozen=True, slots=True)
class Unit:
    """A displayed unit; `size` is its size in the unit of the values: 1e-3 if values in s are displayed in ms."""

    symbol: str = ""
    size: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", SHOWN_UNITS.get(self.symbol, (self.symbol, 1.0))[1])

    @property
    def of_values(self) -> str:
        """Symbol of the unit of the values."""
        return SHOWN_UNITS.get(self.symbol, (self.symbol, 1.0))[0]


NONE, METRE, MILLIMETRE, MILLISECOND, PERCENT = map(Unit, ("", "m", "mm", "ms", "%"))
MIB, MB, GB = map(Unit, ("MiB", "MB", "GB"))


def fitting(unit: Unit, *values: float | None) -> Unit:
    """Return the common display unit of values that are compared: 3.2 mm instead of 0.0032 m."""
    limit, smaller = {"m": (1.0, MILLIMETRE), "s": (10.0, MILLISECOND)}.get(unit.symbol, (0.0, unit))
    largest = max((abs(value) for value in values if value is not None and math.isfinite(value)), default=0.0)
    return smaller if 0.0 < largest < limit else unit


def number(
    value: float | int | None,
    unit: Unit = NONE,
    undefined: str = UNKNOWN,
    *,
    signed: bool = False,
    digits: int = SIGNIFICANT_DIGITS,
) -> str:
    """Return a value in a unit with significant digits, integers in full; return `undefined` for None."""
    if value is None:
        return undefined
    shown = value if unit.size == 1.0 else value / unit.size
    sign = "+" if signed else ""
    if isinstance(shown, int):
        return f"{shown:{sign}d}"
    text = f"{shown:{sign}.{digits}g}"
    if 10.0**digits <= abs(float(text)) < LARGEST_IN_FULL:
        return f"{shown:{sign}.0f}"
    return text


def exact_number(value: float, unit: Unit = NONE) -> str:
    """Return a given number, such as a limit, in a unit: the shortest text from which the number can be read again.

    The quotient is computed with decimals, because a binary quotient of 0.0183 m and 1 mm is not 18.3.
    """
    shown = float(Decimal(repr(float(value))) / Decimal(repr(unit.size)))
    is_integer = shown.is_integer() and abs(shown) < LARGEST_INTEGER
    return f"{shown:.0f}" if is_integer else repr(shown)


def digits_beside(value: float | None, limit: float, unit: Unit) -> int:
    """Return the number of significant digits of a value that is displayed beside its exact limit.

    The rounding error of the value is small beside its difference from the limit, so that the text of the value shows
    whether the limit is met.
    """
    if value is None or not math.isfinite(value):
        return SIGNIFICANT_DIGITS
    exact = value / unit.size
    largest_error = max(ROUNDING_OF_DIFFERENCE * abs(value - limit) / unit.size, ROUNDING_OF_UNITS * abs(exact))
    for digits in range(SIGNIFICANT_DIGITS, MAX_DIGITS):
        text = number(value, unit, digits=digits)
        is_distinct = value == limit or text != exact_number(limit, unit)
        if is_distinct and abs(float(text) - exact) <= largest_error:
            return digits
    return MAX_DIGITS


# ---- the table


class CellKind(StrEnum):
    """Role of a cell."""

    PLAIN = ""
    HEAD = "head"
    VERDICT = "verdict"  #: A verdict, which has a style.
    WORD = "word"  #: A word of the score, such as the identifier of a requirement, which CSV contains.


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


class VerdictStyle(NamedTuple):
    """Icon and colour of a verdict. The colour only repeats the word and the icon."""

    icon: str
    css: str  #: CSS class.
    colour: str  #: Style of rich.


MARKS = {"best": "★", "worst": "✕"}  #: Marks in a column. An arrow would suggest that larger is better.


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell."""

    text: str
    #: Exact value in the unit of its source, or both bounds of an interval; None for words and undefined values.
    value: float | int | Bounds | None = None
    #: Origin in the score, such as `figures.3.mean`; empty for text. For an interval, the row that has both bounds.
    key: str = ""
    kind: CellKind = CellKind.PLAIN
    link: str = ""  #: Relative link to a page about the cell; empty if there is none.
    mark: str = ""  #: One of `MARKS`; empty if there is none.
    style: VerdictStyle | None = None  #: Style of a verdict; None for other cells.

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", printable(self.text))

    @classmethod
    def head(cls, text: str) -> Cell:
        """Return the head of a row."""
        return cls(text, kind=CellKind.HEAD)

    @classmethod
    def verdict(cls, word: str, style: VerdictStyle, key: str = "") -> Cell:
        """Return a verdict with its style."""
        return cls(word, key=key, kind=CellKind.VERDICT, style=style)

    @classmethod
    def word(cls, text: str, key: str) -> Cell:
        """Return a word of the score."""
        return cls(text, key=key, kind=CellKind.WORD)

    @classmethod
    def number(
        cls,
        value: float | None,
        key: str = "",
        unit: Unit = NONE,
        undefined: str = UNKNOWN,
        *,
        signed: bool = False,
        digits: int = SIGNIFICANT_DIGITS,
    ) -> Cell:
        """Return a figure, displayed in a unit."""
        return cls(number(value, unit, undefined, signed=signed, digits=digits), value, key)

    @classmethod
    def interval(
        cls, bounds: Bounds | None, key: str = "", unit: Unit = NONE, undefined: str = ABSENT, *, signed: bool = False
    ) -> Cell:
        """Return an interval, displayed in a unit."""
        if not bounds:
            return cls(undefined)
        return cls(" to ".join(number(bound, unit=unit, signed=signed) for bound in bounds), bounds, key)

    @property
    def icon(self) -> str:
        """Icon of a verdict; empty for other cells."""
        return "" if self.style is None else self.style.icon

    @property
    def sign(self) -> str:
        """Sign before the text: the icon of a verdict, or the mark; empty for other cells."""
        return self.icon or MARKS.get(self.mark, "")


Row = tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """One table; ValueError unless each row has a cell for each column."""

    name: str  #: Used as an anchor and in CSV.
    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    note: str = ""  #: Explanation of the figures.

    def __post_init__(self) -> None:
        if wrong := [len(row) for row in self.rows if len(row) != len(self.columns)]:
            raise ValueError(f"table '{self.name}' has a row of {wrong[0]} cells: {len(self.columns)} are required")
        object.__setattr__(self, "title", printable(self.title))
        object.__setattr__(self, "note", printable(self.note))

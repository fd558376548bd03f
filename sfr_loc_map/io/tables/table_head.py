"""The head of a text table: the lines before the first row, with titles and units, and the cells of the first rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io.number_text import is_number, number_or_nan
from sfr_loc_map.io.stamps.stamp_text import TIMES, UTC_UNIT, is_time
from sfr_loc_map.io.stamps.time_units import inferred_time_unit
from sfr_loc_map.io.tables.length_units import METRES
from sfr_loc_map.io.tables.pose_columns import NANOSECONDS, SECONDS, STAMP
from sfr_loc_map.io.tables.text_table import COMMENTS, split_cells
from sfr_loc_map.io.tables.titles import split_unit, symbol_of

HEAD_LINES = 5000  #: Number of lines from which the columns are detected. Later rows that do not fit are invalid.
SEPARATORS = (";", "\t", ",")  #: Separators of cells in the order of preference; spaces are tried last.
NAMED_COLUMNS = 4  #: Smallest number of names in a header: t, x, y, z.
_WORD = re.compile(r"[\w/]")  #: Beginning of a cell with a name.


@dataclass(frozen=True, slots=True)
class TableHead:
    """The first lines of a table."""

    name: str  #: Name of the table in messages.
    option: str  #: Option by which the user can name the columns, for messages; COLUMNS stands for the columns.
    before: Sequence[str]  #: Lines before the first row: comments, titles, units, empty lines.
    first_row: str
    separator: str | None  #: Separator of the cells; None: spaces.
    rows: Sequence[Sequence[str]]  #: Cells of the rows.

    @classmethod
    def of(cls, lines: Sequence[str], name: str, option: str) -> TableHead:
        """Return the head of a table that begins with these lines; InputError if no line is a row of numbers."""
        lines = lines[:HEAD_LINES]
        for number, line in enumerate(lines):
            text = line.strip()
            if not text or text.startswith(COMMENTS):
                continue
            separator = _separator_of_row(text)
            cells = split_cells(text, separator)
            if _are_numbers(cells) and _begins_row(cells):
                return cls(name, option, lines[:number], text, separator, _cells_of(lines[number:], separator))
        filled = [(number, line.strip()[:60]) for number, line in enumerate(lines, 1) if line.strip()]
        found = ", ".join(f"line {number} is '{line}'" for number, line in filled[:2]) or "it is empty"
        raise InputError(
            f"{name} has no pose: at least one line with a pose is required, with numbers separated by commas, "
            f"semicolons, tabs or spaces, and stamps as numbers or as 2026-05-04T10:22:01.25; {found}:",
            "give a csv, TUM, KITTI or EuRoC file",
        )

    @property
    def width(self) -> int:
        """Largest number of cells in a row."""
        return max(len(cells) for cells in self.rows)

    @property
    def time_unit(self) -> str:
        """Unit of the stamps in the first column, for examples in messages: inferred, or `s`."""
        return inferred_time_unit([cells[0] for cells in self.rows], is_seconds=False) or "s"

    def numbers(self, width: int) -> FloatArray:
        """Return the numbers in the first `width` cells of each row that has so many; NaN for other cells."""
        rows = [cells[:width] for cells in self.rows if len(cells) >= width]
        return np.array([[number_or_nan(cell) for cell in cells] for cells in rows]).reshape(-1, width)

    def cells_of(self, line: str) -> list[str]:
        """Return the cells of a line that may be the header of the table."""
        return header_cells(line, self.separator, self.width)

    def named_by(self, columns: str) -> str:
        """Return the end of a message: the option with an example of columns."""
        return f"name the columns: {self.option_with(columns)}"

    def option_with(self, columns: str) -> str:
        """Return the option that gives these columns."""
        return self.option.replace("COLUMNS", columns)

    def named_by_number(self, keys: Sequence[str] = ("x", "y", "z")) -> str:
        """Return the end of a message: the option with an example of columns by their numbers."""
        columns = ",".join((f"t=#1[{self.time_unit}]", *(f"{key}=#{number}" for number, key in enumerate(keys, 2))))
        return f"{self.named_by(columns)} with the numbers of the columns in the file"


def header_cells(line: str, separator: str | None, width: int = NAMED_COLUMNS) -> list[str]:
    """Return the cells of a line that may be a header of `width` columns, without a comment sign."""
    text = line.strip().lstrip("#%/").strip()
    options = [separator, ",", ";", "\t", None]
    cells = [split_cells(text, option) for option in options]
    return next((found for found in cells if len(found) >= min(width, NAMED_COLUMNS)), cells[0])


def separator_in(text: str) -> str | None:
    """Return the first of `SEPARATORS` in a text; None (spaces) if it has none."""
    return next((separator for separator in SEPARATORS if separator in text), None)


def _separator_of_row(text: str) -> str | None:
    """Return the separator of the cells of a row; None for spaces, also between decimal commas (`1,5 2,25 3,0 4`)."""
    words = text.split()
    has_decimal_commas = len(words) >= NAMED_COLUMNS and all(is_number(word) and word[-1] != "," for word in words)
    separator = separator_in(text)
    if separator == "\t" and all(map(is_number, words)) and any(" " in cell for cell in split_cells(text, separator)):
        return None  # some columns are separated by tabs, others by spaces
    if separator == "," and has_decimal_commas and not _are_numbers(split_cells(text, separator)):
        return None
    return separator


def _are_numbers(cells: Sequence[str]) -> bool:
    """Return whether there are two or more cells, of which at least half are numbers or empty."""
    return len(cells) > 1 and 2 * sum(is_number(cell) or not cell for cell in cells) >= len(cells)


def _begins_row(cells: Sequence[str]) -> bool:
    """Return whether the first cell may be that of a row: a number, a time, or a word before at least four numbers.

    A word is the name of a point, a frame or a topic. Lines with fewer numbers are titles (`Objects 100`). Sentences of
    NMEA begin with a dollar sign.
    """
    first = cells[0]
    if is_number(first) or is_time(first):
        return True
    return bool(_WORD.match(first)) and sum(is_number(cell) or is_time(cell) for cell in cells) >= NAMED_COLUMNS


def _cells_of(lines: Sequence[str], separator: str | None) -> list[list[str]]:
    """Return the cells of the lines that are rows."""
    rows = [line.strip() for line in lines]
    return [split_cells(row, separator) for row in rows if row and not row.startswith(COMMENTS)]


UNITS = {*METRES, *TIMES, UTC_UNIT, "rad", "deg", "1"}  #: Contents of a line of units below a header.


def units_below(head: TableHead, number: int, count: int) -> list[str]:
    """Return the units of `count` columns in a line between the header and the rows; empty without such a line.

    `number` is the index of the header. A comment is a line of units only if all its units are known, or if one is a
    unit of time. A line that is not a comment is a line of units if it contains no number; `column_detection` refuses
    its unknown units.
    """
    for line in head.before[number + 1 :]:
        units = units_in(head.cells_of(line))
        is_comment = line.strip().startswith(COMMENTS)
        has_number = any(is_number(unit) for unit in units)
        if len(units) == count and (are_units(units) or (any(units) and not is_comment and not has_number)):
            return units
    return []


def units_in(cells: Sequence[str]) -> list[str]:
    """Return the units in the cells of a line; empty for a dash, which states that a number has no unit."""
    return [symbol_of(cell.strip("()[] -=_")) for cell in cells]


def are_units(units: Sequence[str]) -> bool:
    """Return whether all texts are known units, or at least one is a unit of time."""
    return any(units) and (all(unit in UNITS for unit in units) or any(unit in TIMES for unit in units))


def unit_of_column(head: TableHead, key: str, title: str, below: str, given: str = "") -> str:
    """Return the unit of a column by its title, the line of units below, and the user; empty if none states a unit.

    A unit of another quantity is part of the title (`pos_s` for a position). InputError if two units differ.
    """
    in_title = split_unit(title)[1]
    others = METRES if key in (STAMP, SECONDS, NANOSECONDS) else TIMES
    stated = {
        head.option.partition(" ")[0]: given,
        f"its title '{title}'": "" if given and in_title in others else in_title,
        "the line of units": below if below in UNITS else "",
    }
    units = {origin: unit for origin, unit in stated.items() if unit}
    if len(set(units.values())) > 1:
        states = " and ".join(f"{unit} by {origin}" for origin, unit in units.items())
        raise InputError(f"{head.name}: the unit of {key} is {states}: one unit is required;", "correct the wrong one")
    return next(iter(units.values()), below)

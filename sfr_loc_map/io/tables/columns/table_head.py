"""The head of a text table: the lines before the first row of numbers, and the cells of the first rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io.number_text import is_number, number_or_nan
from sfr_loc_map.io.stamps.stamp_text import is_time
from sfr_loc_map.io.stamps.time_units import inferred_time_unit
from sfr_loc_map.io.tables.cells.text_table import COMMENTS, split_cells

HEAD_LINES = 5000  #: Number of lines from which the columns are detected. Later rows that do not fit are invalid.
SEPARATORS = (";", "\t", ",")  #: Separators of cells in the order of preference; spaces are tried last.
NAMED_COLUMNS = 4  #: Smallest number of names in a header: t, x, y, z.


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
            if _are_numbers(cells) and (is_number(cells[0]) or is_time(cells[0])):
                return cls(name, option, lines[:number], text, separator, _cells_of(lines[number:], separator))
        filled = [(number, line.strip()[:60]) for number, line in enumerate(lines, 1) if line.strip()]
        found = ", ".join(f"line {number} is '{line}'" for number, line in filled[:2]) or "it is empty"
        raise InputError(
            f"{name} has no pose: at least one line with a pose is required, with numbers separated by commas, "
            f"semicolons, tabs or spaces, and stamps as numbers or as 2026-05-04T10:22:01.25; {found}: give a csv, "
            "TUM, KITTI or EuRoC file"
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


def _cells_of(lines: Sequence[str], separator: str | None) -> list[list[str]]:
    """Return the cells of the lines that are rows."""
    rows = [line.strip() for line in lines]
    return [split_cells(row, separator) for row in rows if row and not row.startswith(COMMENTS)]

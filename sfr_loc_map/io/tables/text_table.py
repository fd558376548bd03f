"""Tables of numbers in text files, with a stamp in each row or without.

A table is read in blocks. The numbers in all rows of a block are read at once (`cell_grid`). If this fails, the block
is read line by line, so that other forms of numbers, quotes, decimal commas and missing values are read, and invalid
rows are found. The commas in all numbers of a table decide whether they are decimal commas (`DecimalMarks`).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.inputs import MAX_INVALID, read_table_text, split_lines
from sfr_loc_map.io.number_text import parse_number
from sfr_loc_map.io.stamps.stamp_text import STAMP_LENGTH, StampParser
from sfr_loc_map.io.tables.cell_grid import CellGrid
from sfr_loc_map.message_text import counted

BOM = b"\xef\xbb\xbf"
COMMENTS = ("#", "%", "//")  #: Beginnings of comment lines.
_COMMENTS = tuple(sign.encode() for sign in COMMENTS)
_NUMBER_STARTS = np.frombuffer(b"+-.0123456789", np.uint8)
_SPACES = np.frombuffer(b" \t\v\f", np.uint8)
NO_VALUE = ("", "nan", "null", "none", "-")  #: Spellings of a missing value, in lower case.


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file without blank lines and without comments (`#`)."""
    lines = split_lines(read_table_text(path))
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


@dataclass(frozen=True, slots=True)
class RowForm:
    """The form of the rows of a table: which cells are read, and what a valid row consists of."""

    content: str  #: Content of a row, for messages.
    columns: Sequence[int]  #: Columns that are read, from 0; the column of the stamp is the first.
    stamps: StampParser | None = None  #: Parser of the stamp; None: no stamp.
    separator: str | None = None  #: Separator of the cells; None: spaces.
    allows_more: bool = False  #: Whether a row may have more columns than those that are read.
    small_unit: str = ""  #: A unit below a metre that some numbers have, if any (`DecimalMarks`).

    @property
    def value_count(self) -> int:
        """Number of columns other than the stamp."""
        return len(self.columns) - (self.stamps is not None)

    @property
    def width(self) -> int:
        """Smallest number of columns of a row."""
        return max(self.columns) + 1

    def has_width(self, count: int) -> bool:
        """Return whether a row may have this number of columns."""
        return count == self.width or (count > self.width and self.allows_more)


@dataclass(frozen=True, slots=True, eq=False)
class TableRows:
    """The valid rows of a text table."""

    name: str  #: Name of the text, for messages.
    lines: IntArray  #: `(N,)` line number of each row, from 1.
    stamps_ns: IntArray  #: `(N,)` nanoseconds; empty without a column of stamps.
    values: FloatArray  #: `(N, K)` finite numbers.
    skipped_lines: tuple[int, ...] = ()  #: Line numbers, ascending, of the rows that are invalid or without a value.
    invalid: tuple[str, ...] = ()  #: The error in each invalid row, with its line number.

    def without(self, is_valid: Mask, problems: Sequence[str]) -> TableRows:
        """Return the rows that a mask `(N,)` selects; `problems` contains the error in each of the other rows."""
        if is_valid.all():
            return self
        lines = self.lines[~is_valid].tolist()
        invalid = [f"line {line}: {problem}" for line, problem in zip(lines, problems, strict=True)]
        return replace(
            self,
            lines=self.lines[is_valid],
            stamps_ns=self.stamps_ns[is_valid] if len(self.stamps_ns) else self.stamps_ns,
            values=self.values[is_valid],
            skipped_lines=tuple(sorted((*self.skipped_lines, *lines))),
            invalid=(*self.invalid, *invalid),
        )

    def checked(self) -> TableRows:
        """Return the rows; InputError if the fraction of invalid rows exceeds `MAX_INVALID`."""
        count = len(self.invalid)
        rows = len(self.lines) + count
        if count > MAX_INVALID * rows:
            several = f" ({count} of {rows} lines are invalid)" if count > 1 else ""
            raise InputError(f"{self.name} {self.invalid[0]};", f"correct or remove the line{several}")
        return self

    @property
    def row_count(self) -> int:
        """Number of rows in the text, with the skipped rows."""
        return len(self.lines) + len(self.skipped_lines)

    @property
    def row_numbers(self) -> IntArray:
        """`(N,)` number of each row in the text, from 0; skipped rows are counted."""
        return np.arange(len(self.lines)) + np.searchsorted(self.skipped_lines, self.lines)

    @property
    def skipped(self) -> str:
        """Description of the skipped rows; empty if no row was skipped."""
        without_values = len(self.skipped_lines) - len(self.invalid)
        parts = [f"{counted(without_values, 'line')} without values skipped"] if without_values else []
        if self.invalid:
            parts.append(f"{counted(len(self.invalid), 'invalid line')} skipped, the first: {self.invalid[0]}")
        return "; ".join(parts)


def parse_table(
    blocks: Iterable[bytes], name: str, form: RowForm, *, skip: int = 0, tolerant: bool = False
) -> TableRows:
    """Return the rows of a text; empty lines, comments and the first `skip` lines are ignored.

    The text is given in blocks of complete lines. Messages call the text `name`. InputError if a row is invalid; with
    `tolerant`, invalid rows up to the fraction `MAX_INVALID` and rows without a value are skipped and counted.
    """
    marks = DecimalMarks(form.small_unit)
    reader = _BlockReader(name, form, tolerant, marks)
    row_lines, stamps_ns = np.zeros(0, np.int64), np.zeros(0, np.int64)
    values = np.zeros((0, form.value_count))
    line_count = 0
    invalid = list[str]()
    skipped = list[int]()
    for block in blocks:
        text, lines, line_count = _rows_of(block.removeprefix(BOM) if not line_count else block, line_count, skip)
        rows = reader.read(text, lines)
        _append(row_lines, rows.lines)
        _append(stamps_ns, rows.stamps_ns)
        _append(values, rows.values)
        invalid += rows.invalid
        skipped += rows.skipped
    marks.check(name)
    return TableRows(name, row_lines, stamps_ns, values, tuple(skipped), tuple(invalid)).checked()


def _append(array: NDArray[Any], part: NDArray[Any]) -> None:
    """Append rows to an array in place, because the concatenation of all parts takes twice the memory."""
    end = len(array)
    array.resize((end + len(part), *array.shape[1:]), refcheck=False)
    array[end:] = part


def _rows_of(block: bytes, line_count: int, skip: int) -> tuple[bytes, IntArray, int]:
    """Return the rows of a block, each ended by LF, with their line numbers, and the number of all lines so far.

    `line_count` is the number of lines before the block. Empty lines, comments and the first `skip` lines of the text
    are not rows.
    """
    if line_count >= skip and _has_only_rows(block):
        count = block.count(b"\n")
        return block, np.arange(line_count + 1, line_count + count + 1), line_count + count
    texts = [text.strip() for text in block.splitlines()]
    numbers = [
        number
        for number, text in enumerate(texts, line_count + 1)
        if text and number > skip and not text.startswith(_COMMENTS)
    ]
    rows = b"".join(texts[number - line_count - 1] + b"\n" for number in numbers)
    return rows, np.array(numbers, np.int64), line_count + len(texts)


def _has_only_rows(block: bytes) -> bool:
    """Return whether each line of a block is certainly a row without spaces around it, ended by LF.

    Such a line begins with a sign, a digit or a point, and is thus neither a comment nor empty.
    """
    if b"\r" in block or not block.endswith(b"\n"):
        return False
    chars = np.frombuffer(block, np.uint8)
    line_ends = np.flatnonzero(chars == ord("\n"))
    firsts, lasts = chars[np.append(0, line_ends[:-1] + 1)], chars[line_ends - 1]
    return bool(np.isin(firsts, _NUMBER_STARTS).all() and not np.isin(lasts, _SPACES).any())


class _BlockRows(NamedTuple):
    """The rows of a block."""

    lines: IntArray  #: Line number of each row that was read.
    stamps_ns: IntArray
    values: FloatArray
    invalid: Sequence[str] = ()  #: The error in each invalid row.
    skipped: Sequence[int] = ()  #: Line number of each row that was not read: invalid or without a value.


@dataclass(frozen=True, slots=True)
class _BlockReader:
    """Reads the cells of all rows of a block at once or, if this fails because a row is invalid, row by row."""

    name: str
    form: RowForm
    tolerant: bool
    marks: DecimalMarks

    def read(self, rows: bytes, lines: IntArray) -> _BlockRows:
        """Return the rows with these line numbers; InputError if a row is invalid, unless `tolerant`."""
        try:
            stamps_ns, values = self._all_at_once(rows)
        except (ValueError, ArithmeticError):
            return self._one_by_one(rows, lines)
        self.marks.add_numbers(values)
        return _BlockRows(lines, stamps_ns, values)

    def _all_at_once(self, rows: bytes) -> tuple[IntArray, FloatArray]:
        """Return stamps and numbers of rows; ValueError or ArithmeticError if a row requires `_one`."""
        form, columns = self.form, tuple(self.form.columns)
        if not rows:
            return np.zeros(0, np.int64), np.zeros((0, form.value_count))
        grid = CellGrid.of(rows, form.separator)
        if not form.has_width(grid.width):
            raise ValueError(f"the rows have {grid.width} columns")
        if form.stamps is None:
            return np.zeros(0, np.int64), grid.numbers(columns)
        stamps_ns = form.stamps.parse_all(grid.texts(columns[0], STAMP_LENGTH))
        return stamps_ns, grid.numbers(columns[1:])

    def _one_by_one(self, rows: bytes, lines: IntArray) -> _BlockRows:
        """Return the rows with these line numbers, read one at a time."""
        results = [(line, self._one(row, line)) for line, row in zip(lines.tolist(), rows.splitlines(), strict=True)]
        invalid = [result for _, result in results if isinstance(result, str)]
        if invalid and not self.tolerant:
            raise InputError(f"{self.name} {invalid[0]};", "correct or remove the line")
        valid = [(line, result) for line, result in results if isinstance(result, tuple)]
        return _BlockRows(
            np.array([line for line, _ in valid], np.int64),
            np.array([stamp_ns for _, (stamp_ns, _) in valid] if self.form.stamps else [], np.int64),
            np.array([numbers for _, (_, numbers) in valid], np.float64).reshape(-1, self.form.value_count),
            invalid,
            skipped=[line for line, result in results if not isinstance(result, tuple)],
        )

    def _one(self, row: bytes, line: int) -> tuple[int, list[float]] | str | None:
        """Return the stamp and numbers of a row, or the error in the row, or None if a value is missing."""
        form = self.form
        cells = split_cells(row.decode("utf-8", "replace"), form.separator)
        if not form.has_width(len(cells)):
            return f"line {line} has {counted(len(cells), 'column')}: {form.width} ({form.content}) are required"
        texts = [cells[column] for column in form.columns]
        words = [text.lower().lstrip("+-").partition("(")[0] for text in texts]
        if self.tolerant and any(word in NO_VALUE for word in words):
            return None
        # also of invalid rows, because a number with a comma and a point, 1,234.5, makes a row invalid
        self.marks.add_cells(texts[1:] if form.stamps else texts)
        texts = [text.replace(",", ".") for text in texts]  # decimal commas
        try:
            stamp_ns = form.stamps.parse(texts.pop(0)) if form.stamps else 0
            return stamp_ns, [parse_number(text) for text in texts]
        except (ValueError, ArithmeticError) as error:
            return f"line {line}: {error}"


def split_cells(text: str, separator: str | None) -> list[str]:
    """Return the cells of a line without surrounding spaces and quotes; separator None: spaces."""
    if separator is None:
        return [cell.strip('"') for cell in text.split()]
    return [cell.strip() for cell in next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])]


_NUMBER = re.compile(r"[+-]?[0-9.,]*[0-9][0-9.,]*([eE][+-]?[0-9]+)?")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(,[0-9]{3})+")  #: A number whose commas may separate thousands.
_BELOW_THOUSAND = re.compile(r"[+-]?[1-9][0-9]{0,2}")
"""A whole number of 1 to 999, which has no thousands separator. If commas were decimal commas, this
number would have three decimals like its neighbours."""


class DecimalMarks:
    """Collects the commas and points in all numbers of a table that is read with decimal commas.

    Three decimals of metres are millimetres, as total stations write them. Three decimals of a smaller unit are not
    plausible.
    """

    def __init__(self, small_unit: str = "") -> None:
        """Judge numbers of which some are in `small_unit`, a unit below a metre; empty if all are in larger units."""
        self._small_unit = small_unit
        self._with_comma = ""  # the first number with a comma; the two below: with a point, and below 1000
        self._with_point = ""
        self._below_thousand = ""
        self._may_be_thousands = True

    def add_cells(self, cells: Iterable[str]) -> None:
        """Add the cells of numbers as written; other texts are ignored."""
        for cell in filter(_NUMBER.fullmatch, cells):
            if "," in cell:
                self._with_comma = self._with_comma or cell
                self._may_be_thousands = self._may_be_thousands and _THOUSANDS.fullmatch(cell) is not None
            if "." in cell:
                self._with_point = self._with_point or cell
            elif _BELOW_THOUSAND.fullmatch(cell):
                self._below_thousand = self._below_thousand or cell

    def add_numbers(self, numbers: FloatArray) -> None:
        """Add numbers that were written without commas."""
        if not self._with_point:
            with_decimals = numbers[numbers != np.floor(numbers)]
            self._with_point = f"{with_decimals[0]:g}" if len(with_decimals) else ""
        if not self._below_thousand:
            below = numbers[(numbers == np.floor(numbers)) & (np.abs(numbers) < 1000.0) & (numbers != 0.0)]
            self._below_thousand = f"{below[0]:g}" if len(below) else ""

    def check(self, name: str) -> None:
        """Raise InputError if the commas in the numbers of a table may separate thousands."""
        other = self._with_point or (self._below_thousand if self._may_be_thousands else "")
        is_small = bool(self._small_unit) and self._may_be_thousands
        if not self._with_comma or not (other or is_small):
            return
        numbers = f"'{self._with_comma}' in {self._small_unit}"
        if other:
            numbers = f"the numbers '{self._with_comma}' and '{other}'"
        raise InputError(
            f"{name} has {numbers}: the comma may separate thousands or decimals:",
            "write numbers with a decimal point and without separators of thousands",
        )

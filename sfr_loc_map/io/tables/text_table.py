"""Tables of numbers in text files, with a stamp in each row or without.

A table is read in blocks. The numbers in all rows of a block are read at once (`cell_grid`). If this fails, the block
is read line by line, so that other forms of numbers, quotes, decimal commas and missing values are read, and invalid
rows are found.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.inputs import read_table_text, split_lines
from sfr_loc_map.io.tables.cell_grid import CellGrid
from sfr_loc_map.io.tables.decimal_marks import DecimalMarks
from sfr_loc_map.io.tables.number_text import parse_number
from sfr_loc_map.io.tables.stamps import STAMP_LENGTH, parse_stamps
from sfr_loc_map.message_text import counted

BOM = b"\xef\xbb\xbf"
COMMENTS = ("#", "%", "//")  #: Beginnings of comment lines.
_COMMENTS = tuple(sign.encode() for sign in COMMENTS)
_NUMBER_STARTS = np.frombuffer(b"+-.0123456789", np.uint8)
_SPACES = np.frombuffer(b" \t\v\f", np.uint8)
NO_VALUE = ("", "nan", "null", "none", "-")  #: Spellings of a missing value, in lower case.
MAX_BROKEN = 0.1  #: Largest fraction of invalid lines that are skipped.


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file without blank lines and without comments (`#`)."""
    lines = split_lines(read_table_text(path))
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The rows of a text table."""

    name: str  #: Name of the text, for messages.
    lines: IntArray  #: `(N,)` line number of each row, from 1.
    stamps_ns: IntArray  #: `(N,)` nanoseconds; empty without a column of stamps.
    values: FloatArray  #: `(N, K)` finite numbers.
    missing: int = 0  #: Number of skipped rows without a value in a column that is read.
    broken: tuple[str, ...] = ()  #: The error in each invalid row, with its line number.
    skipped_lines: tuple[int, ...] = ()  #: Line numbers, ascending, of the rows that the reader skipped.

    def without(self, good: Mask, problems: Sequence[str]) -> Table:
        """Return the good rows; `problems` contains the error in each of the other rows."""
        if good.all():
            return self
        stamps_ns = self.stamps_ns[good] if len(self.stamps_ns) else self.stamps_ns
        kept = replace(self, lines=self.lines[good], stamps_ns=stamps_ns, values=self.values[good])
        return replace(kept, broken=(*self.broken, *problems))

    def checked(self) -> Table:
        """Return the table; InputError if the fraction of invalid rows exceeds `MAX_BROKEN`."""
        count = len(self.broken)
        rows = len(self.lines) + count
        if count > MAX_BROKEN * rows:
            several = f" ({count} of {rows} lines are invalid)" if count > 1 else ""
            raise InputError(f"{self.name} {self.broken[0]}; correct or remove the line{several}")
        return self

    @property
    def row_numbers(self) -> IntArray:
        """`(N,)` number of each row in the text, from 0; rows that were skipped when they were read are counted."""
        return np.arange(len(self.lines)) + np.searchsorted(self.skipped_lines, self.lines)

    @property
    def skipped(self) -> str:
        """Description of the skipped rows; empty if no row was skipped."""
        parts = [f"{counted(self.missing, 'line')} without values skipped"] if self.missing else []
        if self.broken:
            parts.append(f"{counted(len(self.broken), 'invalid line')} skipped, the first: {self.broken[0]}")
        return "; ".join(parts)


def parse_table(
    blocks: Iterable[bytes],
    name: str,
    form: str,
    columns: Sequence[int],
    *,
    stamp: Callable[[str], int] | None = None,
    separator: str | None = None,
    more: bool = False,
    skip: int = 0,
    tolerant: bool = False,
    small_unit: str = "",
) -> Table:
    """Return the stamps and numbers of a text; empty lines, comments and the first `skip` lines are ignored.

    The text is given in blocks of complete lines. `columns` are the columns to read, from 0. If `stamp` is given, it
    converts the first of these columns to nanoseconds. With `more`, lines may have further columns. Without a
    `separator`, cells are separated by spaces. Messages call the text `name` and the content of a line `form`. With
    `tolerant`, invalid rows up to the fraction `MAX_BROKEN` are skipped and counted. `small_unit` is a unit below a
    metre that some numbers have, if any (`DecimalMarks`).
    """
    marks = DecimalMarks(small_unit)
    reader = _RowReader(name, form, tuple(columns), stamp, separator, more, tolerant, marks)
    row_lines, stamps_ns = np.zeros(0, np.int64), np.zeros(0, np.int64)
    values = np.zeros((0, reader.value_count))
    line_count, missing, broken, skipped = 0, 0, list[str](), list[int]()
    for block in blocks:
        plain, lines, line_count = _rows_of(block.removeprefix(BOM) if not line_count else block, line_count, skip)
        rows = reader.read(plain, lines)
        _append(row_lines, rows.lines)
        _append(stamps_ns, rows.stamps_ns)
        _append(values, rows.values)
        missing += len(rows.skipped) - len(rows.broken)
        broken += rows.broken
        skipped += rows.skipped
    marks.check(name)
    return Table(name, row_lines, stamps_ns, values, missing, tuple(broken), tuple(skipped)).checked()


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


class _Rows(NamedTuple):
    """The rows of a block."""

    lines: IntArray  #: Line number of each row that was read.
    stamps_ns: IntArray
    values: FloatArray
    broken: Sequence[str] = ()  #: The error in each invalid row.
    skipped: Sequence[int] = ()  #: Line number of each row that was not read: invalid or without a value.


@dataclass(frozen=True, slots=True)
class _RowReader:
    """Reads the cells of all rows of a block at once or, if this fails because a row is invalid, row by row."""

    name: str
    form: str
    columns: tuple[int, ...]
    stamp: Callable[[str], int] | None
    separator: str | None
    more: bool
    tolerant: bool
    marks: DecimalMarks

    @property
    def value_count(self) -> int:
        """Number of columns other than the stamp."""
        return len(self.columns) - (self.stamp is not None)

    def read(self, rows: bytes, lines: IntArray) -> _Rows:
        """Return the rows with these line numbers; InputError if a row is invalid, unless `tolerant`."""
        try:
            stamps_ns, values = self._all_at_once(rows)
        except (ValueError, ArithmeticError) as error:
            numbered = [*zip(lines.tolist(), rows.splitlines(), strict=True)]
            found = [(line, self._one(row, line)) for line, row in numbered]
            broken = [row for _, row in found if isinstance(row, str)]
            if broken and not self.tolerant:
                raise InputError(f"{self.name} {broken[0]}; correct or remove the line") from error
            good = [(line, row) for line, row in found if isinstance(row, tuple)]
            skipped = [line for line, row in found if not isinstance(row, tuple)]
            lines = np.array([line for line, _ in good], np.int64)
            stamps_ns = np.array([row[0] for _, row in good] if self.stamp else [], np.int64)
            values = np.array([row[1] for _, row in good], np.float64).reshape(-1, self.value_count)
            return _Rows(lines, stamps_ns, values, broken, skipped)
        self.marks.add_numbers(values)
        return _Rows(lines, stamps_ns, values)

    def _all_at_once(self, rows: bytes) -> tuple[IntArray, FloatArray]:
        """Return stamps and numbers of rows; ValueError or ArithmeticError if a row requires `_one`."""
        if not rows:
            return np.zeros(0, np.int64), np.zeros((0, self.value_count))
        grid = CellGrid.of(rows, self.separator)
        width = max(self.columns) + 1
        if grid.width < width or (grid.width > width and not self.more):
            raise ValueError(f"the rows have {grid.width} columns")
        if self.stamp is None:
            return np.zeros(0, np.int64), grid.numbers(self.columns)
        stamps_ns = parse_stamps(grid.texts(self.columns[0], STAMP_LENGTH), self.stamp)
        return stamps_ns, grid.numbers(self.columns[1:])

    def _one(self, row: bytes, line: int) -> tuple[int, list[float]] | str | None:
        """Return the stamp and numbers of a row, or the error in the row, or None if a value is missing."""
        cells = split_cells(row.decode("utf-8", "replace"), self.separator)
        width = max(self.columns) + 1
        if len(cells) < width or (len(cells) > width and not self.more):
            return f"line {line} has {counted(len(cells), 'column')}: {width} ({self.form}) are required"
        texts = [cells[column] for column in self.columns]
        words = [text.lower().lstrip("+-").partition("(")[0] for text in texts]
        if self.tolerant and any(word in NO_VALUE for word in words):
            return None
        self.marks.add_cells(texts[1:] if self.stamp else texts)
        texts = [text.replace(",", ".") for text in texts]  # decimal commas
        try:
            stamp_ns = self.stamp(texts.pop(0)) if self.stamp else 0
            return stamp_ns, [parse_number(text) for text in texts]
        except (ValueError, ArithmeticError) as error:
            return f"line {line}: {error}"


def split_cells(text: str, separator: str | None) -> list[str]:
    """Return the cells of a line without surrounding spaces and quotes; separator None: spaces."""
    if separator is None:
        return [cell.strip('"') for cell in text.split()]
    return [cell.strip() for cell in next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])]

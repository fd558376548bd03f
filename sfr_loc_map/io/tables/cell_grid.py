"""The cells of many rows of a table, which are found and read without a loop over the rows.

All numbers are decoded together, as one list of JSON. JSON accepts only decimal numbers. Every cell that is read here
is therefore also accepted by `number_text`, which returns the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray

_OTHER_SPACES = (b"  ", b"\t")  #: Separators that are not a single space, such as those of aligned columns.
_numbers = msgspec.json.Decoder(list[float])


@dataclass(frozen=True, slots=True, eq=False)
class CellGrid:
    """Rows with an equal number of cells."""

    text: bytes  #: The cells row by row, each followed by a comma.
    ends: IntArray  #: `(N, K)` position of the comma after each cell.

    @classmethod
    def of(cls, rows: bytes, separator: str | None) -> CellGrid:
        """Return the cells of rows that each end with LF, without spaces around a row.

        Without a `separator`, cells are separated by spaces.

        ValueError if the rows differ in their numbers of cells, or contain quotes or decimal commas.
        """
        if b'"' in rows or (separator != "," and b"," in rows):
            raise ValueError("a cell contains a quote or a comma")
        if separator is None and any(space in rows for space in _OTHER_SPACES):
            rows = b"".join(b" ".join(row.split()) + b"\n" for row in rows.splitlines())
        row_ends = np.flatnonzero(np.frombuffer(rows, np.uint8) == ord("\n"))
        text = rows.replace(b" " if separator is None else separator.encode(), b",").replace(b"\n", b",")
        ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord(","))
        has_equal_rows = len(ends) % len(row_ends) == 0
        grid = ends.reshape(len(row_ends), -1) if has_equal_rows else ends[:, None]
        if not np.array_equal(grid[:, -1], row_ends):
            raise ValueError("the rows differ in their numbers of cells")
        return cls(text, grid)

    @property
    def width(self) -> int:
        """Number of cells in each row."""
        return int(self.ends.shape[1])

    @property
    def begins(self) -> IntArray:
        """`(N, K)` position of the first character of each cell."""
        return np.append(0, self.ends.ravel()[:-1] + 1).reshape(self.ends.shape)

    def texts(self, column: int, length: int) -> NDArray[np.bytes_]:
        """Return the texts `(N,)` of a column; ValueError if one has more than `length` characters."""
        begins = self.begins[:, column, None]
        lengths = self.ends[:, column, None] - begins
        longest = int(lengths.max())
        if longest > length:
            raise ValueError(f"a cell has {longest} characters")
        place = np.arange(longest)
        chars = np.zeros((len(begins), length), np.uint8)
        all_chars = np.frombuffer(self.text, np.uint8)
        cells = all_chars[np.minimum(begins + place, len(all_chars) - 1)]
        chars[:, :longest] = np.where(place < lengths, cells, 0)
        texts: NDArray[Any] = chars.view(f"S{length}")
        return texts[:, 0]

    def numbers(self, columns: tuple[int, ...]) -> FloatArray:
        """Return the numbers `(N, C)` in columns; ValueError if a cell is not a decimal number as in JSON."""
        if not columns:
            return np.zeros((len(self.ends), 0))
        order = sorted(set(columns))
        text = self.text if len(order) == self.width else self._text_of(order)
        text = text.replace(b"-0,", b"-0.0,")  # JSON has no negative zero among its integers
        table = np.array(_numbers.decode(b"[" + text[:-1] + b"]"), np.float64).reshape(len(self.ends), -1)
        return table if tuple(order) == columns else table[:, [order.index(column) for column in columns]]

    def _text_of(self, columns: list[int]) -> bytes:
        """Return the cells of columns in ascending order, each followed by a comma."""
        is_read = np.zeros(self.width, np.bool_)
        is_read[columns] = True
        lengths = np.diff(self.ends.ravel(), prepend=-1)
        of_read = np.repeat(np.tile(is_read, len(self.ends)), lengths)
        return np.frombuffer(self.text, np.uint8)[of_read].tobytes()

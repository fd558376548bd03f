"""Tables of numbers as text: all at once, and the line that is wrong by its number."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io.text_numbers import parse_number


def rows_of(data: bytes) -> tuple[list[bytes], list[int]]:
    """Return the lines of a text that are neither empty nor a comment, and their numbers from 1."""
    rows, numbers = [], []
    for number, line in enumerate(data.removeprefix(b"\xef\xbb\xbf").splitlines(), 1):
        row = line.strip()
        if row and not row.startswith(b"#"):
            rows.append(row)
            numbers.append(number)
    return rows, numbers


def number_rows(
    data: bytes, columns: int, name: str, meaning: str, separator: str | None = None
) -> tuple[FloatArray, list[int]]:
    """Return the numbers of a text `(N, columns)` and the number of the line of each row.

    Args:
        data: The text.
        columns: Numbers in a line; further ones are left out where `separator` is given.
        name: Name of the text, for messages.
        meaning: What the numbers are, for messages.
        separator: Between numbers; None: spaces.

    Raises:
        InputError: If a line holds too few numbers or none, or no line is there; names the line.
    """
    rows, lines = rows_of(data)
    if not rows:
        raise InputError(f"{name} has no pose: at least one line of {columns} numbers is needed")
    used = None if separator is None else range(columns)
    try:
        values = np.loadtxt(rows, np.float64, delimiter=separator, comments=None, usecols=used, ndmin=2)
        if values.shape[1] == columns and np.isfinite(values).all():
            return np.asarray(values), lines
    except (ValueError, UnicodeDecodeError):
        pass
    for row, line in zip(rows, lines, strict=True):
        words = row.decode("utf-8", "replace").split(separator)
        enough = len(words) == columns if separator is None else len(words) >= columns
        if not enough:
            raise InputError(f"{name} line {line}: {len(words)} columns found where {columns} are needed: {meaning}")
        for word in words[:columns]:
            try:
                parse_number(word)
            except ValueError as error:
                raise InputError(f"{name} line {line}: {error}; correct or leave out the line") from error
    raise InputError(f"{name} cannot be read as a table of {columns} numbers a line")

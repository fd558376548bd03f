"""Large tables of decimal numbers, read in machine code and rounded exactly as Python rounds them.

A number is an integer of up to 19 digits times a power of ten. Where both are exact in double precision one operation
rounds correctly (Clinger 1990). Otherwise the product is formed with twice the precision (Dekker 1971), which tells the
nearest double unless the product lies within 2^-38 of the middle between two; those, and longer numbers, are left to
Python.
"""

from __future__ import annotations

from fractions import Fraction
from math import frexp, ldexp

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.jit import jit

COLUMNS = 8
STAMP_DECIMALS = 9
_LARGEST = 60
_POWERS = [Fraction(10) ** e for e in range(-_LARGEST, _LARGEST + 1)]
_HIGH = np.array([float(p) for p in _POWERS])
_LOW = np.array([float(p - Fraction(float(p))) for p in _POWERS])


def parse_rows(
    data: bytes, *, comma: bool, decimal_stamps: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    """Return the stamps `(N,)` and the seven numbers `(N, 7)` of every line.

    Args:
        data: Lines of a whole-number or decimal stamp and seven numbers; blank lines and lines from `#` are skipped.
        comma: Whether numbers are parted by commas rather than blanks.
        decimal_stamps: Whether stamps are seconds with decimals (to 1e-9) rather than whole nanoseconds.

    Returns:
        None if a line is of any other form: the caller's slower reader finds out why.
    """
    letters = np.frombuffer(data, np.uint8)
    rows = int(np.count_nonzero(letters == ord("\n"))) + 1
    stamps, values = np.empty(rows, np.int64), np.empty((rows, COLUMNS - 1))
    hard = np.empty((max(rows // 50, 64), 4), np.int64)
    separator = ord(",") if comma else ord(" ")
    count, hard_count = _parse(letters, separator, decimal_stamps, _HIGH, _LOW, stamps, values, hard)
    if count <= 0:
        return None
    for row, column, first, end in hard[:hard_count].tolist():
        values[row, column] = float(data[first:end])
    return stamps[:count], values[:count]


@jit
def _parse(  # noqa: C901 - one walk over the bytes
    letters: NDArray[np.uint8],
    separator: int,
    decimal_stamps: bool,
    high: NDArray[np.float64],
    low: NDArray[np.float64],
    stamps: NDArray[np.int64],
    values: NDArray[np.float64],
    hard: NDArray[np.int64],
) -> tuple[int, int]:
    """Fill the arrays; return the number of rows, -1 if a line has another form, and the number of hard numbers."""
    place, row, hard_count = 0, 0, 0
    while place < len(letters):
        if letters[place] == 10:
            place += 1
            continue
        if letters[place] == 35:
            while place < len(letters) and letters[place] != 10:
                place += 1
            continue
        for column in range(8):
            first = place
            digits, exponent, negative, place = _number(letters, place)
            if place < 0:
                return -1, 0
            if column == 0:
                shift = exponent + 9 if decimal_stamps else exponent
                if (
                    exponent == -99
                    or shift < 0
                    or shift > 9
                    or digits > 9223372036 * np.uint64(10) ** np.uint64(9 - shift)
                ):
                    return -1, 0
                size = np.int64(digits * np.uint64(10) ** np.uint64(shift))
                stamps[row] = -size if negative else size
            else:
                value = _nearest(digits, exponent, high, low)
                if np.isnan(value):
                    if hard_count == len(hard):
                        return -1, 0
                    hard[hard_count, 0], hard[hard_count, 1] = row, column - 1
                    hard[hard_count, 2], hard[hard_count, 3] = first, place
                    hard_count += 1
                values[row, column - 1] = -value if negative else value
            if column < 7:
                if place >= len(letters) or letters[place] != separator:
                    return -1, 0
                place += 1
        if place < len(letters) and letters[place] == 13:
            place += 1
        if place < len(letters) and letters[place] != 10:
            return -1, 0
        row += 1
    return row, hard_count


@jit
def _number(letters: NDArray[np.uint8], place: int) -> tuple[np.uint64, int, bool, int]:  # noqa: C901 - as above
    """Return digits, exponent (-99 if there are too many digits), sign, and the place after; place -1 if none."""
    digits, used, exponent, seen, point = np.uint64(0), 0, 0, False, False
    negative = place < len(letters) and letters[place] == 45
    if negative:
        place += 1
    while place < len(letters):
        letter = letters[place]
        if 48 <= letter <= 57:
            seen = True
            if used > 0 or letter != 48:
                used += 1
            if used <= 19:
                digits = digits * np.uint64(10) + np.uint64(letter - 48)
            exponent -= 1 if point else 0
        elif letter == 46 and not point:
            point = True
        else:
            break
        place += 1
    if not seen:
        return digits, exponent, negative, -1
    if place < len(letters) and (letters[place] | 32) == 101:
        place += 1
        down = place < len(letters) and letters[place] == 45
        if place < len(letters) and (letters[place] == 45 or letters[place] == 43):
            place += 1
        power, figures = 0, 0
        while place < len(letters) and 48 <= letters[place] <= 57 and figures < 4:
            power = power * 10 + (letters[place] - 48)
            figures += 1
            place += 1
        if figures == 0 or figures == 4:
            return digits, exponent, negative, -1
        exponent += -power if down else power
    if used > 19:
        exponent = -99
    return digits, exponent, negative, place


@jit
def _nearest(digits: np.uint64, exponent: int, high: NDArray[np.float64], low: NDArray[np.float64]) -> float:
    """Return the double nearest to `digits 10^exponent`; NaN where this precision does not tell."""
    if digits == 0:
        return 0.0 if exponent != -99 else np.nan
    if digits <= np.uint64(9007199254740992) and -22 <= exponent <= 22:
        number = float(digits)
        return float(number / high[60 - exponent] if exponent < 0 else number * high[60 + exponent])
    if exponent < -60 or exponent > 60:
        return np.nan
    a, b = float(digits >> np.uint64(32)) * 4294967296.0, float(digits & np.uint64(4294967295))
    head = a + b
    tail = b - (head - a)
    factor = high[60 + exponent]
    product = head * factor
    split = 134217729.0 * head
    head_1 = split - (split - head)
    split = 134217729.0 * factor
    factor_1 = split - (split - factor)
    head_2, factor_2 = head - head_1, factor - factor_1
    rest = ((head_1 * factor_1 - product) + head_1 * factor_2 + head_2 * factor_1) + head_2 * factor_2
    rest += head * low[60 + exponent] + tail * factor
    value = product + rest
    left = abs(rest - (value - product))
    half = ldexp(1.0, frexp(value)[1] - 54)
    if abs(left - half) < half * 2.0**-38 or abs(left - 0.5 * half) < half * 2.0**-38:
        return np.nan
    return float(value)

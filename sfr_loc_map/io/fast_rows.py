"""Rows of a stamp and numbers as text, read at the speed that trajectories of a million poses ask for.

Numbers are rounded correctly, so that they have the bits that `float` gives: a product or quotient of two exact
numbers where one is enough, the algorithm of Eisel and Lemire (D. Lemire, "Number parsing at a gigabyte per second",
Software: Practice and Experience 51, 2021) for others. What is not plain is refused, never guessed: the caller reads
it in another way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.io.text_memory import eight_at, letter_at
from sfr_loc_map.jit import jit, jit_inline

Bits = NDArray[np.uint64]

NEWLINE, RETURN, HASH, SPACE, TAB, COMMA, MINUS, DOT, ZERO = (ord(sign) for sign in "\n\r# \t,-.0")
SMALL_E, LARGE_E, PLUS = ord("e"), ord("E"), ord("+")
BIT_PATTERN = np.uint8(ZERO)
MOST_DIGITS = 19
"""Significant digits of a number that fits 64 bits."""
MOST_POWER = 60
"""Powers of ten of a number's last digit, either sign."""
MOST_EXACT_POWER = 22
"""Powers of ten that a double holds exactly."""
EXACT = np.array([10.0**power for power in range(MOST_EXACT_POWER + 1)])
SECONDS_DIGITS, FRACTION_DIGITS = 10, 9
"""Digits of decimal seconds; together they fit 64 bits."""

U0, U1, U2, U3, U10 = (np.uint64(number) for number in (0, 1, 2, 3, 10))
U32, U52, U63 = (np.uint64(number) for number in (32, 52, 63))
LOW_HALF, NINE_BITS = np.uint64(2**32 - 1), np.uint64(2**9 - 1)
U4, U8, U16, TEN_TO_8 = (np.uint64(number) for number in (4, 8, 16, 10**8))
HIGH_NIBBLES, SIXES, THREES, ZEROS = (np.uint64(byte * 0x0101010101010101) for byte in (0xF0, 6, 0x33, 0x30))
PAIRS, MUL1, MUL2 = np.uint64(0xFF000000FF), np.uint64(100 + (1000000 << 32)), np.uint64(1 + (10000 << 32))
MOST_EXACT = np.uint64(2**53)


def _power_of_five(power: int) -> tuple[int, int]:
    """Return the 128 leading bits of a power of five as two words; of a negative power rounded up."""
    if power >= 0:
        value = 5**power
        shift = value.bit_length() - 128
        bits = value >> shift if shift > 0 else value << -shift
    else:
        divisor = 5**-power
        bits = 2 ** (divisor.bit_length() + 127) // divisor + 1
    return bits >> 64, bits & (2**64 - 1)


POWERS_OF_FIVE: Bits = np.array([_power_of_five(power) for power in range(-MOST_POWER, MOST_POWER + 1)], np.uint64)


def parse_rows(text: bytes, columns: int, *, comma: bool) -> tuple[IntArray, FloatArray] | None:
    """Return the nanoseconds `(N,)` and numbers `(N, columns)` of lines; empty lines and those of `#` are none.

    Args:
        text: Whole lines.
        columns: Numbers behind the stamp.
        comma: Whether columns are parted by commas and stamps are whole nanoseconds; otherwise by spaces or tabs, and
            stamps are decimal seconds.

    Returns:
        None if a line has anything that is not plain: then nothing is known.
    """
    text = text if text.endswith(b"\n") else text + b"\n"
    room = len(text) // (2 * (columns + 1)) + 1  # of shortest rows
    stamps, values = np.empty(room, np.int64), np.empty((room, columns))
    address, numbers = np.frombuffer(text, np.uint8).ctypes.data, values.ravel()
    count = _parse_rows(address, len(text), comma, stamps, numbers, numbers.view(np.uint64))
    return None if count < 0 else (stamps[:count], values[:count])


@jit_inline
def _product(a: np.uint64, b: np.uint64) -> tuple[np.uint64, np.uint64]:
    """Return the high and the low word of a product."""
    low = (a & LOW_HALF) * (b & LOW_HALF)
    middle = (a >> U32) * (b & LOW_HALF) + (low >> U32)
    other = (a & LOW_HALF) * (b >> U32) + (middle & LOW_HALF)
    return (a >> U32) * (b >> U32) + (middle >> U32) + (other >> U32), (other << U32) | (low & LOW_HALF)


@jit_inline
def _rounded(digits: np.uint64, power: int) -> np.uint64:
    """Return the bits of the double nearest to `digits * 10**power`; `digits` is not 0 (Lemire 2021, algorithm 1)."""
    zeros = 0
    for width in (32, 16, 8, 4, 2, 1):
        if digits >> np.uint64(64 - width) == U0:
            digits <<= np.uint64(width)
            zeros += width
    high, low = _product(digits, POWERS_OF_FIVE[power + MOST_POWER, 0])
    if high & NINE_BITS == NINE_BITS:
        carry = _product(digits, POWERS_OF_FIVE[power + MOST_POWER, 1])[0]
        low += carry
        if carry > low:
            high += U1
    upper = high >> U63
    mantissa = high >> (upper + np.uint64(9))
    exponent = ((217706 * power) >> 16) + 63 + int(upper) - zeros + 1023
    tie = low <= U1 and -4 <= power <= 23 and mantissa & U3 == U1
    if tie and mantissa << (upper + np.uint64(9)) == high:
        mantissa &= ~U1
    mantissa = (mantissa + (mantissa & U1)) >> U1
    if mantissa >> np.uint64(53) != U0:
        mantissa >>= U1
        exponent += 1
    return (np.uint64(exponent) << U52) | (mantissa & ((U1 << U52) - U1))


@jit_inline
def _are_digits(word: np.uint64) -> bool:
    """Tell whether eight letters are digits."""
    return bool((word & HIGH_NIBBLES) | (((word + SIXES) & HIGH_NIBBLES) >> U4) == THREES)


@jit_inline
def _value(word: np.uint64) -> np.uint64:
    """Return the number of eight digits: neighbours are put together, three times."""
    word -= ZEROS
    word = word * U10 + (word >> U8)
    return ((word & PAIRS) * MUL1 + ((word >> U16) & PAIRS) * MUL2) >> U32


@jit_inline
def _digits(text: int, i: int, end: int) -> tuple[np.uint64, int, int, int]:
    """Read `12`, `1.2` or `.12` from a place on: digits as a whole number, how many, of them behind the dot, the end.

    Leading zeros do not count; the number of digits is negative if there are none at all.
    """
    begin, whole, dot = i, U0, -1
    digit = letter_at(text, i) ^ BIT_PATTERN
    while digit <= 9:
        whole = whole * U10 + np.uint64(digit)
        i += 1
        digit = letter_at(text, i) ^ BIT_PATTERN
    count, behind = i - begin, 0
    if letter_at(text, i) == DOT:
        dot = i
        i += 1
        if i + 8 <= end and _are_digits(eight_at(text, i)):
            whole = whole * TEN_TO_8 + _value(eight_at(text, i))
            i += 8
        digit = letter_at(text, i) ^ BIT_PATTERN
        while digit <= 9:
            whole = whole * U10 + np.uint64(digit)
            i += 1
            digit = letter_at(text, i) ^ BIT_PATTERN
        behind = i - dot - 1
        count += behind
    if count > MOST_DIGITS:
        j = begin
        while letter_at(text, j) == ZERO or j == dot:
            count -= 1 if j != dot else 0
            j += 1
    return whole, (count if count > 0 or i - begin > (dot >= 0) else -1), behind, i


@jit_inline
def _exponent(text: int, i: int) -> tuple[int, int]:
    """Read an exponent, if there is one; return it and the end, negative if it is not plain."""
    if letter_at(text, i) != SMALL_E and letter_at(text, i) != LARGE_E:
        return 0, i
    i += 1
    negative = letter_at(text, i) == MINUS
    if negative or letter_at(text, i) == PLUS:
        i += 1
    begin, exponent = i, 0
    while letter_at(text, i) ^ BIT_PATTERN <= 9 and i - begin < 3:
        exponent = 10 * exponent + int(letter_at(text, i)) - ZERO
        i += 1
    return (-exponent if negative else exponent), (i if i > begin else -1)


@jit_inline
def _number(text: int, i: int, end: int) -> tuple[float, np.uint64, int]:
    """Read a number; return it, its bits in place of it where they are not 0, and the end, negative if not plain."""
    negative = letter_at(text, i) == MINUS
    digits, count, behind, i = _digits(text, i + 1 if negative else i, end)
    exponent, i = _exponent(text, i)
    power = exponent - behind
    if not 0 <= count <= MOST_DIGITS or abs(power) > MOST_POWER:
        return 0.0, U0, -1
    exact = float(digits)
    if digits <= MOST_EXACT and abs(power) <= MOST_EXACT_POWER:
        exact = exact * EXACT[power] if power >= 0 else exact / EXACT[-power]
    elif digits != U0:
        return 0.0, _rounded(digits, power) | (U1 << U63 if negative else U0), i
    return (-exact if negative else exact), U0, i


@jit_inline
def _stamp(text: int, i: int, end: int, whole: bool) -> tuple[np.int64, int]:
    """Read a stamp; return its nanoseconds and the end, negative if it is not plain."""
    begin = i
    digits, count, behind, i = _digits(text, i, end)
    plain = 0 <= count <= MOST_DIGITS and letter_at(text, begin) != DOT and letter_at(text, i - 1) != DOT
    if not plain or behind > (0 if whole else FRACTION_DIGITS) or (not whole and count - behind > SECONDS_DIGITS):
        return np.int64(0), -1
    if not whole:
        for _ in range(FRACTION_DIGITS - behind):
            digits *= U10
    return np.int64(digits), (i if digits >> U63 == U0 else -1)


@jit_inline
def _next_column(text: int, i: int, comma: bool) -> int:
    """Return where the next column begins, negative if there is none."""
    if comma:
        return i + 1 if letter_at(text, i) == COMMA else -1
    begin = i
    while letter_at(text, i) == SPACE or letter_at(text, i) == TAB:
        i += 1
    return i if i > begin else -1


@jit
def _parse_rows(text: int, end: int, comma: bool, stamps: IntArray, values: FloatArray, bits: Bits) -> int:
    """Fill in stamps and numbers; return how many rows there are, negative if a line is not plain."""
    i, count, columns = 0, 0, len(values) // len(stamps)
    while i < end:
        if letter_at(text, i) == HASH:
            while letter_at(text, i) != NEWLINE:
                if letter_at(text, i) == RETURN:  # it ends a line, too
                    return -1
                i += 1
        if letter_at(text, i) == NEWLINE:
            i += 1
            continue
        stamps[count], i = _stamp(text, i, end, comma)
        for at in range(count * columns, (count + 1) * columns):
            i = _next_column(text, i, comma) if i >= 0 else -1
            if i < 0:
                return -1
            value, pattern, i = _number(text, i, end)
            if pattern == U0:
                values[at] = value
            else:
                bits[at] = pattern
        if i < 0 or letter_at(text, i) != NEWLINE:
            return -1
        i, count = i + 1, count + 1
    return count

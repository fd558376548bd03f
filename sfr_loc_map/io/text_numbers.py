"""Numbers of text files, read strictly.

Python's own conversions take more than files mean: underscores, digits of other scripts, `nan` and `infinity`,
integers of any length.
"""

from __future__ import annotations

import math
import re

_WHOLE = re.compile(r"[+-]?[0-9]{1,19}")
_COUNT = re.compile(r"[0-9]{1,12}")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,4})?")
MAX_NUMBER_LENGTH = 400
STAMP_LIMIT = 2**63


def parse_stamp_ns(text: str) -> int:
    """Return whole nanoseconds; spaces around them are allowed.

    Raises:
        ValueError: If it is not a whole number of 64 bits.
    """
    if not _WHOLE.fullmatch(text.strip(" \t")):
        raise ValueError("it is not a whole number of 64 bits")
    return fitting(int(text))


def parse_count(text: str) -> int:
    """Return a number of things, as a header gives it.

    Raises:
        ValueError: If it is not a whole number from 0 of at most 12 digits.
    """
    if not _COUNT.fullmatch(text):
        raise ValueError(f"'{text[:40]}' is not a number of points, bytes or values")
    return int(text)


def fitting(stamp_ns: int) -> int:
    """Return a stamp as it is.

    Raises:
        ValueError: If it does not fit 64 bits.
    """
    if not -STAMP_LIMIT <= stamp_ns < STAMP_LIMIT:
        raise ValueError("the stamp does not fit 64 bit")
    return stamp_ns


def is_decimal(text: str) -> bool:
    """Tell whether a text is a decimal number in digits of ASCII, of a bounded length."""
    return len(text) <= MAX_NUMBER_LENGTH and _DECIMAL.fullmatch(text) is not None


def parse_number(text: str) -> float:
    """Return a finite decimal number; spaces around it are allowed.

    Raises:
        ValueError: If it is none, or too large.
    """
    word = text.strip(" \t")
    value = float(word) if is_decimal(word) else math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{word[:40]}' is not a finite number")
    return value

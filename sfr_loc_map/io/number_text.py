"""Strict reading of numbers in text files.

Python's own conversions accept more than is valid in files: underscores, digits of other scripts, `nan` and
`infinity`, integers of any length.
"""

from __future__ import annotations

import math
import re

MAX_NUMBER_LENGTH = 400
_COUNT = re.compile(r"[0-9]{1,12}")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,4})?")


def is_decimal(text: str) -> bool:
    """Return whether a text without spaces is a decimal number."""
    return len(text) <= MAX_NUMBER_LENGTH and _DECIMAL.fullmatch(text) is not None


def parse_count(text: str) -> int:
    """Return a count in a header."""
    if not _COUNT.fullmatch(text):
        raise ValueError(f"'{text[:40]}' is not a count: a whole number is required")
    return int(text)


def parse_number(text: str) -> float:
    """Return a finite decimal number; surrounding spaces are allowed."""
    word = text.strip(" \t")
    value = float(word) if is_decimal(word) else math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{word[:40]}' is not a finite number")
    return value


def number_or_nan(text: str) -> float:
    """Return a number, with a decimal point or a decimal comma; NaN if the text is not a number."""
    word = text.strip().replace(",", ".")
    return float(word) if is_decimal(word) else math.nan


def is_number(text: str) -> bool:
    """Return whether a cell is a number, NaN or infinite."""
    is_special = text.strip().lower().lstrip("+-").partition("(")[0] in ("nan", "inf")
    return is_special or math.isfinite(number_or_nan(text))

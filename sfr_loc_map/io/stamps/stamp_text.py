"""Stamps as text, in tables and in names of images.

A stamp is an integer number of nanoseconds. Conversions from and to text are exact to the nanosecond. Stamps of
messages are read by `message_stamps`, and paired by `stamp_pairing`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.io.number_text import is_decimal
from sfr_loc_map.message_stamps import NS_PER_S

STAMP_LENGTH = 64  #: Maximum length of a stamp in text, characters.
STAMP_LIMIT = 2**62  #: 146 years from 1970, ns; differences of two stamps fit 64 bits.
TIMES = {"s": NS_PER_S, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""Units of stamps, ns."""
UTC_UNIT = "utc"  #: Unit of times written as `2026-05-04 10:22:01.25`.
UNIT_WORDS = {1: "nanoseconds", 1_000: "microseconds", 1_000_000: "milliseconds", NS_PER_S: "seconds"}
NANOSECOND_DIGITS = 9  #: Number of decimals of a stamp in seconds with nanosecond resolution.
_WHOLE = re.compile(r"[+-]?[0-9]{1,19}")
_BELOW_MICROSECONDS = re.compile(r"[.,][0-9]{6}([0-9]{1,3})")


def parse_stamp_ns(text: str) -> int:
    """Return integer nanoseconds; surrounding spaces are allowed."""
    if _WHOLE.fullmatch(text.strip(" \t")) and _is_in_range(int(text)):
        return int(text)
    raise ValueError(f"stamp '{text[:40]}' is not an integer number of nanoseconds within 146 years of 1970")


def parse_seconds(text: str) -> int:
    """Return decimal seconds as nanoseconds, exactly; more than nine decimals are rounded half to even."""
    word = text.strip(" \t")
    whole, _, fraction = word.partition(".")
    if 0 < len(whole) <= 10 and len(fraction) <= 9 and (whole + fraction).isdecimal() and word.isascii():
        stamp = int(whole) * NS_PER_S + int(fraction.ljust(9, "0"))  # fast path for the common form
        if stamp < STAMP_LIMIT:
            return stamp
    elif is_decimal(word):
        with suppress(InvalidOperation):
            stamp = int(Decimal(word).scaleb(9).quantize(Decimal(1), ROUND_HALF_EVEN))
            if _is_in_range(stamp):
                return stamp
    hint = " (are these nanoseconds?)" if word.isdigit() else ""
    raise ValueError(f"stamp '{word[:40]}' is not a number of seconds{hint}")


def parse_decimal(text: str, unit_ns: int) -> int:
    """Return the nanoseconds of a decimal number in a unit of `unit_ns` nanoseconds, rounded half to even."""
    word = text.strip(" \t").replace(",", ".")
    if is_decimal(word):
        with suppress(InvalidOperation):
            stamp = int((Decimal(word) * unit_ns).quantize(Decimal(1), ROUND_HALF_EVEN))
            if _is_in_range(stamp):
                return stamp
    raise ValueError(f"stamp '{word[:40]}' is not a number of {UNIT_WORDS[unit_ns]} since 1970 (at most 146 years)")


def parse_nanoseconds(text: str) -> int:
    """Return the nanoseconds in a text that may have decimals or an exponent: `1700000000000000000.000`."""
    try:
        return parse_stamp_ns(text)
    except ValueError:
        return parse_decimal(text, 1)


def parse_utc(text: str) -> int:
    """Return the nanoseconds of a time written as `2026-05-04 10:22:01.25`, UTC unless the text has a zone.

    Decimals after the ninth are ignored.
    """
    moment = datetime.fromisoformat(text.strip())
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
    stamp = since // timedelta(microseconds=1) * 1000
    if below := _BELOW_MICROSECONDS.search(text):  # `fromisoformat` ignores these decimals
        stamp += int(below[1].ljust(3, "0"))
    if not _is_in_range(stamp):
        raise ValueError(f"time '{text.strip()[:40]}' is not within 146 years of 1970")
    return stamp


def is_time(text: str) -> bool:
    """Return whether a cell is a time such as `2026-05-04 10:22:01.25`."""
    try:
        parse_utc(text)
    except (ValueError, OverflowError):
        return False
    return True


def _is_in_range(stamp_ns: int) -> bool:
    return -STAMP_LIMIT <= stamp_ns < STAMP_LIMIT


def seconds_text(stamp_ns: int) -> str:
    """Return nanoseconds as seconds with nine decimals, exactly."""
    whole, rest = divmod(abs(stamp_ns), NS_PER_S)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


class StampParser(NamedTuple):
    """Converts stamps in text to nanoseconds."""

    parse: Callable[[str], int]
    is_seconds: bool = False  #: Whether the text is decimal seconds.
    is_nanoseconds: bool = False

    @classmethod
    def of(cls, unit: str) -> StampParser:
        """Return the parser of stamps in a unit: a key of `TIMES`, or `UTC_UNIT`."""
        if unit == UTC_UNIT:
            return cls(parse_utc)
        if unit == "s":
            return cls(parse_seconds, is_seconds=True)
        if unit == "ns":
            return cls(parse_nanoseconds, is_nanoseconds=True)
        return cls(partial(parse_decimal, unit_ns=TIMES[unit]))

    def parse_all(self, texts: NDArray[np.bytes_]) -> IntArray:
        """Return the nanoseconds of all texts; vectorised for aligned digits of seconds or nanoseconds."""
        stamps_ns = None
        if self.is_seconds or self.is_nanoseconds:
            stamps_ns = _parse_aligned(texts, has_point=self.is_seconds)
        if stamps_ns is not None:
            return stamps_ns
        return np.array([self.parse(text.decode("ascii")) for text in texts.tolist()], np.int64)


def _parse_aligned(texts: NDArray[np.bytes_], *, has_point: bool) -> IntArray | None:
    """Return the nanoseconds of decimal seconds (`has_point`) or of nanoseconds; None if a digit is not aligned.

    All texts must have as many digits of whole seconds as the first text, and at most nine decimals.
    """
    whole_digits = texts[0].find(b".") if has_point else len(texts[0]) - NANOSECOND_DIGITS
    if not 0 < whole_digits <= 10:
        return None
    chars = np.ascontiguousarray(texts).view(np.uint8).reshape(len(texts), STAMP_LENGTH)
    begin = whole_digits + has_point
    end = begin + NANOSECOND_DIGITS
    whole, point, fraction = chars[:, :whole_digits], chars[:, whole_digits:begin], chars[:, begin:end]
    if chars[:, end:].any() or (point != ord(".")).any():
        return None
    if has_point:  # missing decimals are zero
        has_ended = fraction == 0
        if (has_ended[:, :-1] > has_ended[:, 1:]).any():
            return None
        fraction = np.where(has_ended, np.uint8(ord("0")), fraction)
    digits = np.concatenate((whole, fraction), axis=1) - np.uint8(ord("0"))  # other characters are above 9
    powers = 10.0 ** np.arange(9, -1, -1)  # sums of ten digits are exact
    seconds = digits[:, :whole_digits] @ powers[-whole_digits:]
    if digits.max() > 9 or seconds.max() >= STAMP_LIMIT // NS_PER_S:
        return None
    fraction_ns = digits[:, whole_digits:] @ powers[1:]
    return np.asarray(seconds.astype(np.int64) * NS_PER_S + fraction_ns.astype(np.int64))

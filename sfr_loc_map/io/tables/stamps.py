"""Stamps in tables and in names of images: how they are read and written, their unit and limit; the order of stamps.

A stamp is an integer number of nanoseconds. Conversions from and to text are exact to the nanosecond. Stamps of
messages are read by `message_stamps`, and paired by `stamp_pairing`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.io.tables.number_text import is_decimal, number_or_nan
from sfr_loc_map.message_stamps import NS_PER_S

STAMP_LENGTH = 64  #: Maximum length of a stamp in text, characters.
STAMP_LIMIT = 2**62  #: 146 years from 1970, ns; differences of two stamps fit 64 bits.
TIMES = {"s": NS_PER_S, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""Units of stamps, ns."""
UTC_UNIT = "utc"  #: Unit of times written as `2026-05-04 10:22:01.25`.
UNIT_WORDS = {1: "nanoseconds", 1_000: "microseconds", 1_000_000: "milliseconds", NS_PER_S: "seconds"}
NANOSECOND_DIGITS = 9  #: Number of decimals of a stamp in seconds with nanosecond resolution.
EARLIEST_CLOCK_S = 3e8  #: Stamps of clocks are in 1979 or later; smaller stamps count from the start of a program.
LATEST_CLOCK_S = 4.62e9  #: 146 years after 1970, the limit of stamps; larger numbers have a smaller unit.
LONGEST_SENSOR_STEP = 10.0  #: Longest step of stamps from which seconds are inferred.
SECONDS_OR_MILLISECONDS = 1.0
"""Shortest step of stamps that is plausible for a sensor both in seconds and in milliseconds."""
SHORTEST_POSE_STEP_NS = 500_000  #: Shortest step between poses, ns: 2 kHz, twice the rate of fast trackers.
SHORTEST_IMAGE_STEP_NS = 2_000_000  #: Shortest step between images, ns: 500 Hz.
LONGEST_STEP_S = 1000.0  #: Longest step between poses, s, of a file with stamps in seconds.
EARLIEST_DAY = 1e4  #: Days of Excel, MATLAB and Julian dates are larger numbers.
LONGEST_STEP_DAY = 1e-4  #: Longest step of a sensor, days (9 s).
FRACTION_DIGITS = (6, 9)  #: Numbers of digits of microseconds and nanoseconds in a second.
SURELY_UNPADDED = 50
"""Number of fractions that are unpadded if none of them begins with 0. Of 50 padded fractions, at least one begins with
0 with a probability of 99.5 %."""
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


def _is_in_range(stamp_ns: int) -> bool:
    return -STAMP_LIMIT <= stamp_ns < STAMP_LIMIT


def seconds_text(stamp_ns: int) -> str:
    """Return nanoseconds as seconds with nine decimals, exactly."""
    whole, rest = divmod(abs(stamp_ns), NS_PER_S)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


def parse_stamps(texts: NDArray[np.bytes_], stamp: Callable[[str], int]) -> IntArray:
    """Return the nanoseconds of texts that `stamp` reads; vectorised if the digits of all texts are aligned."""
    stamps_ns = None
    if stamp in (parse_seconds, parse_stamp_ns, parse_nanoseconds):
        stamps_ns = _parse_aligned(texts, has_point=stamp is parse_seconds)
    if stamps_ns is not None:
        return stamps_ns
    return np.array([stamp(text.decode("ascii")) for text in texts.tolist()], np.int64)


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


class _StampFigures(NamedTuple):
    """Figures of the stamps in a table from which their unit is inferred, in the unit of the table."""

    magnitude: float  #: Median of the absolute stamps.
    step: float  #: Median difference of consecutive stamps; 0 for fewer than three stamps.
    has_decimals: bool
    has_nine_decimals: bool

    @classmethod
    def of(cls, texts: Sequence[str]) -> _StampFigures | None:
        """Return the figures of stamps as written; None if no stamp is a number."""
        numbers = np.array([number_or_nan(text) for text in texts])
        numbers = numbers[np.isfinite(numbers)]
        if not len(numbers):
            return None
        middle = (len(numbers) - 1) // 2
        steps = np.abs(np.diff(numbers))
        return cls(
            magnitude=float(np.partition(np.abs(numbers), middle)[middle]),
            step=float(np.median(steps)) if len(steps) > 1 else 0.0,
            has_decimals=bool((numbers != np.floor(numbers)).any()),
            has_nine_decimals=any(len(text.partition(".")[2]) >= NANOSECOND_DIGITS for text in texts),
        )

    def is_clock_in(self, unit: str) -> bool:
        """Return whether stamps in this unit are times of a clock, which numbers of seconds cannot be."""
        return self.magnitude > LATEST_CLOCK_S and _is_clock(self.magnitude * TIMES[unit] / NS_PER_S)


def time_unit(texts: Sequence[str], *, is_seconds: bool) -> str:
    """Return the unit of stamps, inferred from their magnitude and steps; empty if several units are possible.

    The first rule that applies decides. `is_seconds`: the layout prescribes seconds, unless the stamps contradict.
    """
    found = _StampFigures.of(texts)
    if found is None:
        return "s"
    step, has_decimals = found.step, found.has_decimals
    may_be_clock = found.magnitude >= EARLIEST_CLOCK_S
    may_be_seconds = found.magnitude <= LATEST_CLOCK_S
    is_short = step <= LONGEST_STEP_S if is_seconds or may_be_clock else step < SECONDS_OR_MILLISECONDS
    are_days = found.magnitude >= EARLIEST_DAY and not may_be_clock and 0.0 < step <= LONGEST_STEP_DAY
    rules = (
        # a time of a clock, 1979 to 2116, is possible in only one unit
        *((unit, found.is_clock_in(unit)) for unit in ("ms", "us", "ns")),
        # days of Excel, MATLAB or Julian dates
        ("", has_decimals and are_days),
        # resolution of nanoseconds, or fractions of seconds
        ("s", may_be_seconds and found.has_nine_decimals),
        ("s", may_be_seconds and has_decimals and is_short),
        # whole numbers whose steps are those of a sensor, 1 ms to 10 s, in only one unit; milliseconds overlap with
        # seconds and microseconds
        ("s", not has_decimals and step <= LONGEST_SENSOR_STEP and (is_seconds or may_be_clock)),
        ("us", not has_decimals and 1e4 < step <= 1e6),
        ("ns", not has_decimals and step > 1e7),
        # a slow sensor, in a layout of seconds
        ("s", is_seconds and may_be_clock and step <= LONGEST_STEP_S),
    )
    return next((unit for unit, applies in rules if applies), "")


def _is_clock(seconds: float) -> bool:
    return EARLIEST_CLOCK_S <= seconds <= LATEST_CLOCK_S


def check_unit(
    stamps_ns: ArrayLike, name: str, *, shortest_ns: int = SHORTEST_POSE_STEP_NS, is_stated: bool = False
) -> None:
    """Raise InputError if stamps `(N,)`, ns, were probably read in a unit that is too small.

    Their median step is then below `shortest_ns`, the shortest period of the sensor, and in a larger unit they are
    times of a clock. `is_stated`: a header or the user states the unit, so that the short step alone is an error.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    steps = np.abs(np.diff(stamps))
    step_ns = float(np.median(steps[steps > 0])) if steps.any() else 0.0
    if not len(steps) or step_ns >= shortest_ns:
        return
    magnitude_s = float(np.median(np.abs(stamps))) / NS_PER_S
    factor = next((factor for factor in (1e3, 1e6, 1e9) if _is_clock(magnitude_s * factor)), 0.0)
    if factor:
        raise InputError(
            f"{name}: the stamps are {step_ns:g} ns apart, but would be times of a clock if they were {factor:g} times "
            "as large: their unit is probably larger than stated; correct the unit or the stamps"
        )
    if is_stated and step_ns > 0.0:
        raise InputError(
            f"{name}: the stamps are {step_ns:g} ns apart, but at least {shortest_ns:g} ns are required: their unit is "
            "probably larger than stated; correct the unit or the stamps"
        )


def check_padded(texts: Sequence[str], name: str) -> None:
    """Raise InputError if stamps are probably seconds, a point, and nanoseconds or microseconds without leading zeros.

    `1700000000.5000000` is then 5 ms after the second. Such fractions have different lengths and never begin with 0,
    shorter fractions may end in 0, and the stamps increase only with the leading zeros.
    """
    fractions = [fraction for text in texts if len(fraction := text.strip().partition(".")[2]) > 1]
    longest = max(map(len, fractions), default=0)
    shorter = [fraction for fraction in fractions if len(fraction) < longest]
    if not shorter or not all(map(str.isdecimal, fractions)) or any(fraction[0] == "0" for fraction in fractions):
        return
    is_unpadded = len(fractions) >= SURELY_UNPADDED or any(fraction[-1] == "0" for fraction in shorter)
    if longest in FRACTION_DIGITS and (is_unpadded or _increase_only_if_padded(texts, longest)):
        example = next(text for text in texts if text.strip().endswith(shorter[0]))
        raise InputError(
            f"{name}: the fractions of seconds have different lengths and no leading zeros, such as "
            f"'{example.strip()}', and are probably whole nanoseconds or microseconds: write leading zeros"
        )


def check_is_no_time_of_day(texts: Sequence[str], name: str) -> None:
    """Raise InputError if stamps are probably times of day written as `hhmmss.s`, which are not seconds.

    Their minutes and seconds are below 60, and a step over a full minute is that of the other stamps only if the time
    of day is converted to seconds.
    """
    numbers = np.array([number_or_nan(text) for text in texts])
    if len(numbers) < 3 or not ((numbers >= 0.0) & (numbers < 240_000.0)).all():
        return
    minutes, seconds = numbers // 100.0 % 100.0, numbers % 100.0
    if not ((minutes < 60.0) & (seconds < 60.0)).all():
        return
    steps = np.diff(numbers)
    converted = np.diff(3600.0 * (numbers // 10_000.0) + 60.0 * minutes + seconds)
    typical = float(np.median(np.abs(converted)))
    is_over_minute = steps != converted
    are_typical = np.abs(converted[is_over_minute] - typical) <= 0.5 * typical
    if is_over_minute.any() and 0.0 < typical <= LONGEST_SENSOR_STEP and are_typical.all():
        raise InputError(
            f"{name}: the stamps, such as {texts[int(np.argmax(is_over_minute)) + 1].strip()}, are probably times of "
            "day (hhmmss.s): seconds are required; convert the stamps"
        )


def _increase_only_if_padded(texts: Sequence[str], digits: int) -> bool:
    """Return whether stamps increase if their fractions are padded by leading zeros, and do not increase as written."""
    parts = [text.strip().partition(".") for text in texts if is_decimal(text.strip())]
    padded = [float(f"{whole}.{fraction.rjust(digits, '0')}") for whole, _, fraction in parts]
    as_written = [float(f"{whole}.{fraction or '0'}") for whole, _, fraction in parts]
    return bool((np.diff(padded) >= 0.0).all() and (np.diff(as_written) < 0.0).any())


def check_order(stamps_ns: ArrayLike, name: str, *, strict: bool) -> None:
    """Check that stamps do not decrease; `strict`: that they increase."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    wrong = np.diff(stamps) < (1 if strict else 0)
    if wrong.any():
        first = int(np.argmax(wrong))
        word = "is not later than" if strict else "is earlier than"
        raise InputError(
            f"{name}: stamp {stamps[first + 1]} (entry {first + 2}) {word} {stamps[first]}: stamps in increasing "
            "order are required"
        )

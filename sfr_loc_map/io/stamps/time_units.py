"""Units of stamps: stated by a table, prescribed by its format, or inferred from the stamps."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from sfr_loc_map.io.number_text import is_number, number_or_nan
from sfr_loc_map.io.stamps.stamp_text import NANOSECOND_DIGITS, TIMES, UTC_UNIT, is_time
from sfr_loc_map.message_stamps import NS_PER_S

EARLIEST_CLOCK_S = 3e8  #: Earliest time of a clock, s since 1970 (in 1979). Earlier stamps count from a start.
LATEST_CLOCK_S = 4.62e9  #: Latest time of a clock, s since 1970 (in 2116). Larger numbers are not seconds.
LONGEST_SENSOR_STEP = 10.0  #: Longest period of a sensor, s.
AMBIGUOUS_STEP = 1.0
"""Shortest ambiguous step of stamps with decimals: slow sensors have a period of 1 s, and fast ones of 1 ms."""
LONGEST_STEP_S = 1000.0  #: Longest step between poses in a file whose format prescribes seconds, s.
EARLIEST_DAY = 1e4  #: Smallest date in days: that of Excel in 1927; dates of MATLAB and Julian dates are larger.
LONGEST_STEP_DAY = 1e-4  #: Longest period of a sensor, days (9 s).


class UnitOrigin(Enum):
    """Origin of the unit of stamps."""

    STATED = "stated"  #: By the header, by a line of units or by the user.
    PRESCRIBED = "prescribed"  #: By the format: EuRoC, TUM and the csv of the suite.
    INFERRED = "inferred"  #: From the stamps.


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
        return self.magnitude > LATEST_CLOCK_S and is_clock_time(self.magnitude * TIMES[unit] / NS_PER_S)


def inferred_time_unit(texts: Sequence[str], *, is_seconds: bool) -> str:
    """Return the unit of stamps, inferred from their notation, magnitude and steps; empty if several are possible.

    If no stamp is a number, the unit is the second, and the error is reported when the rows are read. Otherwise the
    first rule that applies decides. `is_seconds`: the format prescribes seconds, unless the stamps contradict.
    """
    if texts and not is_number(texts[0]) and is_time(texts[0]):
        return UTC_UNIT
    figures = _StampFigures.of(texts)
    if figures is None:
        return "s"
    step, has_decimals = figures.step, figures.has_decimals
    may_be_clock = figures.magnitude >= EARLIEST_CLOCK_S
    may_be_seconds = figures.magnitude <= LATEST_CLOCK_S
    is_short = step <= LONGEST_STEP_S if is_seconds or may_be_clock else step < AMBIGUOUS_STEP
    are_days = figures.magnitude >= EARLIEST_DAY and not may_be_clock and 0.0 < step <= LONGEST_STEP_DAY
    rules = (
        # a number that is a time of a clock, 1979 to 2116, in one of these units has this unit
        *((unit, figures.is_clock_in(unit)) for unit in ("ms", "us", "ns")),
        # dates in days, which are not supported
        ("", has_decimals and are_days),
        # nine decimals, or decimals and a plausible step
        ("s", may_be_seconds and figures.has_nine_decimals),
        ("s", may_be_seconds and has_decimals and is_short),
        # whole numbers whose step is the period of a sensor, 1 ms to 10 s, in only one unit; a step of milliseconds
        # may also be one of seconds or of microseconds
        ("s", not has_decimals and step <= LONGEST_SENSOR_STEP and (is_seconds or may_be_clock)),
        ("us", not has_decimals and 1e4 < step <= 1e6),
        ("ns", not has_decimals and step > 1e7),
        # a slow sensor, in a format that prescribes seconds
        ("s", is_seconds and may_be_clock and step <= LONGEST_STEP_S),
    )
    return next((unit for unit, applies in rules if applies), "")


def is_clock_time(seconds: float) -> bool:
    """Return whether a stamp, s, is a time of a clock, and not a time since the start of a program."""
    return EARLIEST_CLOCK_S <= seconds <= LATEST_CLOCK_S

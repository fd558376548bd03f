"""Checks of stamps, in text or in nanoseconds: notation, unit, order and stray stamps."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray, Mask
from sfr_loc_map.inputs import MAX_INVALID
from sfr_loc_map.io.number_text import is_decimal, number_or_nan
from sfr_loc_map.io.stamps.time_units import LONGEST_SENSOR_STEP, is_clock_time
from sfr_loc_map.message_stamps import NS_PER_S

_log = logging.getLogger(__name__)
SHORTEST_POSE_STEP_NS = 500_000  #: Shortest step between poses, ns: 2 kHz, twice the rate of fast trackers.
SHORTEST_IMAGE_STEP_NS = 2_000_000  #: Shortest step between images, ns: 500 Hz.
MIN_STAMPS = 3  #: Smallest number of stamps for the detection of stray stamps.
STRAY_S = 86_400.0  #: A stray stamp is more than a day, s, and twice the drive's duration from the median stamp.
FRACTION_DIGITS = (6, 9)  #: Numbers of digits of microseconds and nanoseconds in a second.
SURELY_UNPADDED = 50
"""Minimum number of fractions that are taken for unpadded if none of them begins with 0. Of 50 padded fractions, at
least one begins with 0 with a probability of 99.5 %."""


def check_fractions_are_padded(texts: Sequence[str], name: str) -> None:
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
            f"{name}: the fractions of seconds differ in length and have no leading zeros (an example is "
            f"'{example.strip()}'), and are probably whole nanoseconds or microseconds:",
            "write leading zeros",
        )


def _increase_only_if_padded(texts: Sequence[str], digits: int) -> bool:
    """Return whether stamps increase if their fractions are padded by leading zeros, and do not increase as written."""
    parts = [text.strip().partition(".") for text in texts if is_decimal(text.strip())]
    padded = [float(f"{whole}.{fraction.rjust(digits, '0')}") for whole, _, fraction in parts]
    as_written = [float(f"{whole}.{fraction or '0'}") for whole, _, fraction in parts]
    return bool((np.diff(padded) >= 0.0).all() and (np.diff(as_written) < 0.0).any())


def check_no_times_of_day(texts: Sequence[str], name: str) -> None:
    """Raise InputError if stamps are probably times of day written as `hhmmss.s`, which are not seconds.

    Such stamps have minutes and seconds below 60. Their steps across a full minute equal the other steps only after the
    conversion to seconds.
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
            "day (hhmmss.s): seconds are required;",
            "convert the stamps",
        )


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
    factor = next((factor for factor in (1e3, 1e6, 1e9) if is_clock_time(magnitude_s * factor)), 0.0)
    if factor:
        raise InputError(
            f"{name}: the stamps are {step_ns:g} ns apart, but would be times of a clock if they were {factor:g} times "
            "as large: their unit is probably larger than stated;",
            "correct the unit or the stamps",
        )
    if is_stated and step_ns > 0.0:
        raise InputError(
            f"{name}: the stamps are {step_ns:g} ns apart, but at least {shortest_ns:g} ns are required: their unit is "
            "probably larger than stated;",
            "correct the unit or the stamps",
        )


def check_stamp_order(stamps_ns: ArrayLike, name: str, *, strict: bool) -> None:
    """Raise InputError if stamps `(N,)`, ns, decrease; `strict`: also if two consecutive stamps are equal."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    wrong = np.diff(stamps) < (1 if strict else 0)
    if wrong.any():
        first = int(np.argmax(wrong))
        word = "is not later than" if strict else "is earlier than"
        raise InputError(
            f"{name}: stamp {stamps[first + 1]} (entry {first + 2}) {word} {stamps[first]}:",
            "stamps in increasing order are required",
        )


def increasing_stamps(stamps_ns: Sequence[int], where: str) -> list[int]:
    """Return the stamps that are later than all earlier stamps; InputError if many are not, or if all are 0."""
    if len(stamps_ns) > 1 and not any(stamps_ns):
        raise InputError(
            f"{where}: all header stamps are 0:",
            "set 'sync.stamps: record' in sfr.yaml, which uses the recording times",
        )
    stamps = np.asarray(stamps_ns, np.int64)
    is_later = np.ones(len(stamps), np.bool_)
    is_later[1:] = stamps[1:] > np.maximum.accumulate(stamps)[:-1]
    ignored = int(np.count_nonzero(~is_later))
    if ignored > MAX_INVALID * len(stamps):
        check_stamp_order(stamps, where, strict=True)
    if ignored:
        _log.warning(
            f"{where}: {ignored} of {len(stamps)} messages ignored: their stamps are not later than those before"
        )
    return [int(stamp) for stamp in stamps[is_later]]


def stray_stamps(stamps_ns: IntArray) -> Mask:
    """Return which stamps `(N,)` are stray: 0 among stamps of a clock, or days apart from the others."""
    if len(stamps_ns) < MIN_STAMPS:
        return np.zeros(len(stamps_ns), np.bool_)
    middle = int(np.partition(stamps_ns, len(stamps_ns) // 2)[len(stamps_ns) // 2])
    low, high = np.quantile(stamps_ns.astype(np.float64) - middle, (MAX_INVALID, 1.0 - MAX_INVALID))
    limit = max(STRAY_S * NS_PER_S, 2.0 * (high - low))
    away = np.abs(stamps_ns.astype(np.float64) - middle) > limit
    return away if away.mean() <= MAX_INVALID else np.zeros(len(stamps_ns), np.bool_)


def check_truth_order(stamps_ns: IntArray, name: str) -> None:
    """Raise InputError if stamps `(N,)` of true poses decrease.

    Stray stamps are ignored, because `truth.pose_checks` removes and reports their poses.
    """
    check_stamp_order(stamps_ns[~stray_stamps(stamps_ns)], name, strict=False)

"""The titles of columns: their content, such as `t`, `x` or `qw`, and their unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.tables.length_units import LENGTH_WORDS, length_symbol
from sfr_loc_map.io.tables.pose_columns import COVARIANCE_KEYS, DOWN, NANOSECONDS, POSITION, QUATERNION, SECONDS, STAMP

NAMES: dict[str, tuple[str, ...]] = {  # the names of positions and quaternions follow below
    STAMP: (
        *("headerstamp", "timestamp", "stamp", "time", "t", "utime", "unixtime", "utctime", "timestamps"),
        *("gpst", "datetime"),
    ),
    SECONDS: ("sec", "secs", "headerstampsec", "headerstampsecs", "stampsec", "timesec", "timestampsec"),
    NANOSECONDS: (
        *("nsec", "nsecs", "nanosec", "nanosecs", "headerstampnanosec", "headerstampnsecs", "stampnanosec"),
        *("usec", "usecs", "microsec", "microsecs", "microseconds", "msec", "msecs", "millisec", "millisecs"),
    ),
}
_FORMS = (
    *("{}", "p{}", "t{}", "pos{}", "position{}", "{}pos", "{}position"),
    *("translation{}", "{}enu", "prsr{}", "rboriginposmds{}"),
)
_EAST, _NORTH = ("east", "easting", "ebaseline", "e"), ("north", "northing", "nbaseline", "n")
_UP = ("up", "height", "ubaseline", "h", "elevation", "altitude", "alt")
_OF_AXES: list[dict[str, tuple[str, ...]]] = [{axis: (form.format(axis),) for axis in "xyz"} for form in _FORMS]
FAMILIES: tuple[dict[str, tuple[str, ...]], ...] = (
    *_OF_AXES,
    {"x": _EAST, "y": _NORTH, "z": _UP},
    {"x": _EAST, "y": _NORTH, DOWN: (DOWN,)},
    {"x": ("yned",), "y": ("xned",), DOWN: ("zned",)},
)
"""Names of the three columns of a position. `x`, `y` and `down` form no family, because their frame is left-handed."""
NAMES |= {key: tuple(name for family in FAMILIES for name in family.get(key, ())) for key in ("x", "y", "z", DOWN)}
NAMES |= {
    f"q{axis}": (
        *(f"q{axis}", f"quat{axis}", f"quaternion{axis}", f"orientation{axis}", f"rotation{axis}", f"qrs{axis}"),
        f"attqdstorb{number}",
    )
    for number, axis in enumerate("xyzw", 1)
}
"""Names of the columns of each key: letters and digits in lower case; earlier names take precedence."""
_LENGTHS = {name for key in ("x", "y", "z", DOWN) for name in NAMES[key]}
SMALLER_FRACTIONS = {"us": ("usec", "microsec"), "ms": ("msec", "millisec")}
"""Units of the fraction of a second other than ns, by the beginning of the name of the column."""
_OTHER_NAMES = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanosecond", "nanoseconds"), "ns"),
}
"""Other names of the units of stamps, and their symbols."""
_CONJUGATES = re.compile(r"att_?q_?(ds_?to_?rb|lm_?to_?navsb)_?[1-4]", re.IGNORECASE)
"""Titles of the quaternions of the suite, which are the conjugates of those in ROS messages (docs/conventions.md)."""
_TIME_WORDS = ("s", "sec", "ms", "msec", "us", "usec", "ns", "nsec", "utc")
_WORDS = "|".join(sorted((*LENGTH_WORDS, "in", *_TIME_WORDS), key=len, reverse=True))
_UNIT = re.compile(rf"^[#%/\s]*(.*?)\s*(?:\[([^\[\]]*)\]|\((\w*)\)|(?<=\w)[\s_/]+({_WORDS}))?$", re.IGNORECASE)
_ATTACHED = re.compile(rf"([a-z._]+?)({'|'.join(word for word in LENGTH_WORDS if len(word) > 1)})", re.IGNORECASE)
"""A title and a unit without a separator: `Xmm`."""
_PREFIXES = ("field", "poseposepose", "posepose", "pose", "transform")


class KnownTitle(NamedTuple):
    """What the title of a column states."""

    key: str  #: Content of the column, a key of `NAMES` or of `COVARIANCE_KEYS`.
    precedence: int  #: Index of the name among those of the key; the smallest is preferred.


def split_unit(title: str) -> tuple[str, str]:
    """Return the name and the unit in a title: `East [mm]`, `time_ns`, `Height (m)`, `X/mm`, `Xmm`."""
    match = _UNIT.match(title.strip())
    before_unit, *units = match.groups("") if match else (title, "")
    name, unit = str(before_unit).strip(), symbol_of("".join(units))
    attached = None if unit else _ATTACHED.fullmatch(name)
    if attached and _letters(attached[1]) in _LENGTHS and _letters(name) not in _LENGTHS:
        return attached[1], symbol_of(attached[2])
    in_name = (unit for unit, starts in SMALLER_FRACTIONS.items() if name.lower().startswith(starts))
    return name, unit or next(in_name, "")


def symbol_of(unit: str) -> str:
    """Return the symbol of a unit: `mm` for `Millimetres`; an unknown unit in lower case."""
    word = unit.strip().lower()
    return length_symbol(word) or _OTHER_NAMES.get(word, word)


def _letters(title: str) -> str:
    """Return the letters and digits of a title in lower case, as in `NAMES`."""
    return re.sub(r"[^a-z0-9]", "", title.lower())


def known_title(title: str) -> KnownTitle | None:
    """Return what the title of a column states by itself; None if its name is unknown."""
    name = split_unit(title)[0]
    word = _letters(name)
    words = [word]
    words += [word.removeprefix(prefix) for prefix in _PREFIXES if word.startswith(prefix)]
    words += [word.removeprefix("field").removeprefix(prefix) for prefix in _PREFIXES if word.startswith("field")]
    for key, names in NAMES.items():
        for candidate in words:
            if candidate in names:
                return KnownTitle(key, names.index(candidate))
    return KnownTitle(name, 0) if name in COVARIANCE_KEYS else None


def known_titles(titles: Sequence[str]) -> list[KnownTitle | None]:
    """Return what each title of a header states beside the other titles.

    A title such as `stamp_sec` alone is that of a complete stamp. Beside `stamp_nsec`, the same title is that of the
    whole seconds of a stamp.
    """
    known = [known_title(title) for title in titles]
    words = [_letters(title) for title in titles]
    for index, word in enumerate(words):
        stem = word.removesuffix("sec")
        fractions = [number for number, other in enumerate(words) if other in (f"{stem}{unit}sec" for unit in "num")]
        if word in NAMES[SECONDS] and len(fractions) == 1:
            known[index], known[fractions[0]] = KnownTitle(SECONDS, 0), KnownTitle(NANOSECONDS, 0)
    return known


def named_columns(titles: Sequence[str]) -> dict[str, int]:
    """Return the column of each key that the titles name, from 0; of several columns, the preferred name decides.

    x, y and z are those of the first complete family of names, so that they belong to one position.
    """
    preferred: dict[str, tuple[int, int]] = {}
    for index, known in enumerate(known_titles(titles)):
        if known is None:
            continue
        if known.key not in preferred or known.precedence < preferred[known.key][0]:
            preferred[known.key] = (known.precedence, index)
    index_of = {key: index for key, (_, index) in preferred.items()}
    positions = named_positions(titles)
    if not positions:
        return {key: index for key, index in index_of.items() if key != DOWN}
    return {key: index for key, index in index_of.items() if key not in (*POSITION, DOWN)} | positions[0]


def named_positions(titles: Sequence[str]) -> list[dict[str, int]]:
    """Return the columns of x, y, and z or down of each complete family of names."""
    index_of: dict[str, int] = {}
    for index, title in enumerate(titles):
        known = known_title(title)
        if known is not None and known.key in (*POSITION, DOWN):
            index_of.setdefault(NAMES[known.key][known.precedence], index)
    positions = []
    for family in FAMILIES:
        columns = {key: index_of[name] for key, names in family.items() for name in names[::-1] if name in index_of}
        if len(columns) == len(family):
            positions.append(columns)
    return positions


def are_conjugates(titles: Sequence[str], index_of: Mapping[str, int], name: str) -> bool:
    """Return whether the quaternions of a table are those of the suite; InputError if only some titles state this."""
    read = [titles[index_of[key]] for key in QUATERNION if key in index_of and index_of[key] < len(titles)]
    of_suite = [title for title in read if _CONJUGATES.search(title)]
    if of_suite and len(of_suite) < len(read):
        other = next(title for title in read if title not in of_suite)
        raise InputError(
            f"{name}: the columns '{of_suite[0]}' and '{other}' belong to quaternions of two conventions:",
            "name the four columns of one quaternion",
        )
    return bool(of_suite)

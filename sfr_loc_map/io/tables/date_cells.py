"""Dates and times of day, which are one stamp: `14.11.2023;22:13:20,5` or `2023/11/14 22:13:20.5`."""

from __future__ import annotations

import re

_YEAR_FIRST = rb"(?P<y>\d{4})(?P<s>[-/])(?P<m>\d{1,2})(?P=s)(?P<d>\d{1,2})"
_DAY_FIRST = rb"(?P<d2>\d{1,2})\.(?P<m2>\d{1,2})\.(?P<y2>\d{4})"
_DATE = rb"(?<![\d.])(?:" + _YEAR_FIRST + rb"|" + _DAY_FIRST + rb")"
_QUOTES = rb"[\"' ]*"
_TIME = rb"(?P<h>\d{1,2}):(?P<rest>\d\d:\d\d"
_IN_ONE_CELL = re.compile(_DATE + rb"(?P<gap>T|[ \t]+)" + _TIME + rb")")
_IN_TWO_CELLS = (
    re.compile(_DATE + rb"(?P<gap>" + _QUOTES + rb"," + _QUOTES + rb")" + _TIME + rb"(?:\.\d+)?)"),
    re.compile(_DATE + rb"(?P<gap>" + _QUOTES + rb"[;\t]" + _QUOTES + rb")" + _TIME + rb"(?:[.,]\d+)?)"),
)
_TITLES = re.compile(rb"(?im)^(?P<sign>[#% \t]*)date +(?P<time>[a-z_]*time)\b")


def has_dates(block: bytes) -> bool:
    """Return whether a block of a table contains a date followed by a time of day."""
    return any(pattern.search(block) for pattern in (_IN_ONE_CELL, *_IN_TWO_CELLS))


def with_complete_dates(block: bytes) -> bytes:
    """Return a block of a table with each date and its time of day as one stamp, written as ISO 8601.

    If a separator is between them, both cells get the stamp, and both titles are kept. The day of a date with points is
    before the month, as in German. In dates with slashes, the year must be first, because the order of day and month is
    otherwise ambiguous.
    """
    for pattern in _IN_TWO_CELLS:
        block = pattern.sub(lambda match: _iso(match) + match["gap"] + _iso(match), block)
    return _TITLES.sub(rb"\g<sign>\g<time>", _IN_ONE_CELL.sub(_iso, block))


def _iso(match: re.Match[bytes]) -> bytes:
    year = match["y"] or match["y2"]
    month, day = (match[name] or match[f"{name}2"] for name in ("m", "d"))
    return b"%s-%s-%sT%s:%s" % (year, month.zfill(2), day.zfill(2), match["h"].zfill(2), match["rest"])

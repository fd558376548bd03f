"""Dates and times of day in adjacent cells, which are one stamp: `14.11.2023;22:13:20,5` or `2023/11/14 22:13:20.5`."""

from __future__ import annotations

import re

_YEAR_FIRST = rb"(?P<y>\d{4})(?P<s>[-/])(?P<m>\d{1,2})(?P=s)(?P<d>\d{1,2})"
_DAY_FIRST = rb"(?P<d2>\d{1,2})\.(?P<m2>\d{1,2})\.(?P<y2>\d{4})"
_DATE = rb"(?<![\d.])(?:" + _YEAR_FIRST + rb"|" + _DAY_FIRST + rb")"
_GAP = rb"[\"']?[ \t]*[,;]?[ \t]*[\"']?"
_MOMENT = re.compile(_DATE + rb"(?:T|" + _GAP + rb")(?P<h>\d{1,2}):(?P<rest>\d\d:\d\d)")
_TITLES = re.compile(rb"(?im)(?P<sign>(?:^[#%/ \t]*|[,;\t][ \t]*)[\"']?)date" + _GAP + rb"(?P<time>[a-z_ ]*time)\b")


def has_dates(block: bytes) -> bool:
    """Return whether a block of a table contains a date followed by a time of day."""
    return _MOMENT.search(block) is not None


def with_joined_dates(block: bytes) -> bytes:
    """Return a block of a table with each date and its time of day in one cell, written as ISO 8601.

    The day of a date with points is before the month, as in German. In dates with slashes, the year must be first,
    because the order of day and month is otherwise ambiguous. The titles `date` and `time` become one title.
    """
    return _TITLES.sub(rb"\g<sign>\g<time>", _MOMENT.sub(_iso, block))


def _iso(match: re.Match[bytes]) -> bytes:
    year = match["y"] or match["y2"]
    month, day = (match[name] or match[f"{name}2"] for name in ("m", "d"))
    return b"%s-%s-%sT%s:%s" % (year, month.zfill(2), day.zfill(2), match["h"].zfill(2), match["rest"])

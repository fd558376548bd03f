"""The part of a row of the table of figures: what the row is about, the kind of call, and where the calls ran.

In a score the part is one text, such as `target memory localisation`, `pair 0` or `0-4 m`. Only this module parses such
texts. A part that is one name, such as a reading or an axis, or a sentence, as for a tolerance bound, is written as is.
"""

from __future__ import annotations

import re
from enum import StrEnum
from typing import NamedTuple

from sfr_loc_map.metrics.config import CallKind

NUMBER = r"\d+(?:\.\d+)?(?:e[+-]\d+)?"  #: Pattern of a number >= 0 in the format `g`.


class Place(StrEnum):
    """Where calls were measured."""

    HOST = "host"  #: The computer of the run; omitted in the text of a part.
    TARGET = "target"  #: On a target.
    STATED = "stated"  #: Reported by an external node, which measures time and memory of its own calls.


class RowPart(NamedTuple):
    """The part of a row."""

    #: Reading of the document, axis, range or stage of a call. For a row `judged`, the expected part of the run:
    #: `drive`, `map`, `live`, `suite`, or the time (`calls`) or `memory` of calls. May be empty.
    what: str = ""
    call: CallKind | None = None  #: Kind of call; None if the part names no call.
    place: Place = Place.HOST  #: Where the calls were measured.

    @classmethod
    def of(cls, text: str | None) -> RowPart:
        """Return the part that a text states; the text is None for a row without a part."""
        words = text.split(" ") if text else []
        place, call = Place.HOST, None
        if words and words[0] in (Place.TARGET, Place.STATED):
            place = Place(words.pop(0))
        if words and words[-1] in [*CallKind]:
            call = CallKind(words.pop())
        return cls(" ".join(words), call, place)

    @property
    def text(self) -> str | None:
        """The part as written in a score; None if it is empty."""
        place = "" if self.place is Place.HOST else self.place
        return " ".join(filter(None, (place, self.what, self.call))) or None

    def at(self, place: Place) -> RowPart:
        """Return this part for calls that were measured at another place."""
        return self._replace(place=place)

    @property
    def of_calls(self) -> RowPart:
        """The calls that the part is about, without `what`."""
        return self._replace(what="")


# ---- parts with a number


def pair_part(number: int) -> str:
    """Return the part of one mapping pair, counted from 0."""
    return f"pair {number}"


def is_of_pair(part: str | None) -> bool:
    """Return whether a part is one mapping pair."""
    return re.fullmatch(r"pair \d+", part or "") is not None


def range_part(low_m: float, high_m: float) -> str:
    """Return the part of the points in a range [low, high)."""
    return f"{low_m:g}-{high_m:g} m"


def range_of(part: str | None) -> tuple[float, float] | None:
    """Return the bounds of a range of points, m; None for another part."""
    found = re.fullmatch(rf"({NUMBER})-({NUMBER}) m", part or "")
    return None if found is None else (float(found[1]), float(found[2]))


def distance_part(distance_m: float) -> str:
    """Return the part of the errors over a distance travelled."""
    return f"{distance_m:g} m"


def is_of_distance(part: str | None) -> bool:
    """Return whether a part is a distance travelled."""
    return (part or "").endswith(" m") and range_of(part) is None


def distance_of(part: str | None) -> float:
    """Return the distance travelled of such a part, m; 0 for a row without a part."""
    return float((part or "0").removesuffix(" m"))

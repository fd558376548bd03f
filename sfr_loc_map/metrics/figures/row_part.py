"""The parts of the rows of the table of figures.

A row has a `RowPart`, or None if the row is about the complete figure. The JSON of a score has its text, and only this
module parses such texts.

| text | rows | in code |
|---|---|---|
| `pose`, `displacement`, `position`, ... | errors of sub-trajectories by one reading | `READING_PARTS` |
| `x`, `y`, `z`, `along`, `cross` | position errors along one direction | `DIRECTIONS` |
| `moving`, `other frames`, `pooled` | errors of other sub-trajectories than the judged ones | `MOVING`, ... |
| `5 m` | errors over a distance travelled | `distance_part` |
| `0-4 m`, `pair 0` | points of a range, points of a mapping pair | `range_part`, `pair_part` |
| `localisation`, `target mapping_call` | memory and completeness of calls | `calls_part` |
| `first call`, `target first call`, a stage | times of calls | `FIRST`, ..., `calls_part` |
| `drive`, `map`, `calls localisation`, ... | the judged fraction of the expected items | `Scope`, `calls_part` |
| `count` | a number in place of its fraction | `COUNT` |
| `distance`, `time` | the longest gap | `DISTANCE`, `TIME` |
| `attitude`, `attitude at the start` | the error of the truth | `ATTITUDE`, `TURN` |
| `map points` | NEES of map points | `POINTS` |
| a name or a sentence | contributions, axes and tolerance bounds | the module of the figure |

A *scope* is a part of a score that has expected items, and is complete or incomplete. The *place* of calls is where
they were measured. In a look-up of rows, `ANY` accepts every part, and None accepts only rows without a part.
"""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Self

from sfr_loc_map.metrics.config import CallKind, Reading
from sfr_loc_map.metrics.figures.subjects import Scope

ANY = "*"  #: Accepts every value of a key in a look-up of rows; `score.JUDGED_ROW` selects the judged row instead.
NUMBER = r"(\d+(?:\.\d+)?(?:e[+-]\d+)?|inf)"  #: Pattern of a number >= 0 in the format `g`.


class Place(StrEnum):
    """Where calls were measured."""

    HOST = "host"  #: The computer of the run; omitted in the text of a part.
    TARGET = "target"  #: On a target.
    STATED = "stated"  #: Reported by an external node, which measures time and memory of its own calls.


CALLS_IN_WORDS = {
    CallKind.LOCALISATION: "localisation calls",
    CallKind.MAPPING_CALL: "mapping calls",
    CallKind.MAPPING: "mapping calls of single pairs",
    CallKind.FUSION: "fusion calls",
}
PLACES_IN_WORDS = {Place.HOST: "", Place.TARGET: " on the target", Place.STATED: " as reported by the node"}
"""Places of calls in words, appended to the kind of call."""


class RowPart(str):
    """The part of a row: its text in a score, and what this text states about calls.

    A part equals its text. The text is parsed once, when the part is made.
    """

    what: str  #: The text without call and place, which may be empty; in a row `judged`, the scope.
    call: CallKind | None  #: Kind of call; None if the part names no call.
    place: Place  #: Where the calls were measured.

    def __new__(cls, text: str) -> Self:
        """Return the part that a text states."""
        part = super().__new__(cls, text)
        words = part.split(" ")
        part.place, part.call = Place.HOST, None
        if words[0] in (Place.TARGET, Place.STATED):
            part.place = Place(words.pop(0))
        if words and words[-1] in [*CallKind]:
            part.call = CallKind(words.pop())
        part.what = " ".join(words)
        return part

    @classmethod
    def of(cls, text: str | None) -> Self | None:
        """Return the part of a row from its text, None for a row without a part."""
        return text if text is None or isinstance(text, cls) else cls(text)

    @property
    def words(self) -> str:
        """The part in words, for a message."""
        if self.call is None:
            return self.what
        of_what = "memory of the " if self.what == Scope.MEMORY else ""
        return of_what + CALLS_IN_WORDS[self.call] + PLACES_IN_WORDS[self.place]

    def at(self, place: Place) -> RowPart:
        """Return this part for calls that were measured at another place."""
        return calls_part(self.what, self.call, place)

    @property
    def of_calls(self) -> RowPart | None:
        """The calls that the part is about, without `what`; None if the part is not about calls."""
        return calls_part("", self.call, self.place) or None


def calls_part(what: str, call: CallKind | None, place: Place = Place.HOST) -> RowPart:
    """Return the part of what calls of a kind have at a place; `what` may be empty."""
    return RowPart(" ".join(filter(None, ("" if place is Place.HOST else place, what, call))))


READING_PARTS = tuple(map(RowPart, Reading))  #: Errors of sub-trajectories by one reading of the specification.
MOVING = RowPart("moving")  #: Errors of the sub-trajectories in which the rover moves.
OTHER_FRAMES = RowPart("other frames")  #: Errors at the frames at which no judged sub-trajectory starts or ends.
POOLED = RowPart("pooled")  #: Errors over all drives of a suite.
FIRST = RowPart("first call")  #: Time of the first measured call.
AFTER_FIRST = RowPart("after the first call")  #: Times of the calls after the first.
ON_TARGET = RowPart(Place.TARGET)  #: Times of all calls that were measured on a target.
ATTITUDE = RowPart("attitude")  #: `truth_error`: attitude error of the truth.
TURN = RowPart("attitude at the start")  #: `truth_error`: displacement of N+x by an attitude error at N.
TRANSLATION = RowPart("translation")  #: APE and RPE of positions.
ROTATION = RowPart("rotation")  #: APE and RPE of attitudes.
DISTANCE = RowPart("distance")  #: Longest gap by its path.
TIME = RowPart("time")  #: Longest gap by its time.
POSE = RowPart("pose")  #: `nees` of position and attitude together.
POINTS = RowPart("map points")  #: `nees` of the sigma of map points.
COUNT = RowPart("count")  #: Number of items in place of their fraction.
SUB_TRAJECTORIES = RowPart("sub-trajectories")  #: `standing` of one condition.
DIRECTIONS = {"x": "x (east)", "y": "y (north)", "z": "z (up)", "along": "along the path", "cross": "across the path"}
"""Parts of the position error along one direction, and their titles; x, y and z are axes of DS."""


# ---- parts with a number


def pair_part(number: int) -> RowPart:
    """Return the part of one mapping pair, counted from 0."""
    return RowPart(f"pair {number}")


def range_part(low_m: float, high_m: float) -> RowPart:
    """Return the part of the points in a range [low, high)."""
    return RowPart(f"{low_m:g}-{high_m:g} m")


def range_of(part: str | None) -> tuple[float, float] | None:
    """Return the bounds of a range of points, m; None if the part is not such a range."""
    found = re.fullmatch(f"{NUMBER}-{NUMBER} m", part or "")
    return None if found is None else (float(found[1]), float(found[2]))


def distance_part(distance_m: float) -> RowPart:
    """Return the part of the errors over a distance travelled."""
    return RowPart(f"{distance_m:g} m")


def distance_of(part: str | None) -> float | None:
    """Return the distance travelled of a part, m; None if the part is not such a distance."""
    found = re.fullmatch(f"{NUMBER} m", part or "")
    return None if found is None else float(found[1])

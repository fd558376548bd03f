"""The parts of the rows of the table of figures. Every kind of part is stated here.

The part of a row is one text, or None for the complete figure. Only this module parses such texts.

| part | rows | in code |
|---|---|---|
| `pose`, `displacement`, `position`, ... | errors of sub-trajectories by one reading | `config.Reading` |
| `x`, `y`, `z`, `along`, `cross` | position errors along one direction | `DIRECTIONS` |
| `moving`, `other frames`, `pooled` | errors of other sub-trajectories than the judged ones | `MOVING`, ... |
| `5 m` | errors over a distance travelled | `distance_part` |
| `0-4 m`, `pair 0` | points of a range, points of a mapping pair | `range_part`, `pair_part` |
| `localisation`, `target mapping_call` | memory and completeness of calls | `RowPart` |
| `first call`, `target first call`, a stage | times of calls | `FIRST`, ..., `RowPart` |
| `drive`, `map`, `calls localisation`, ... | the judged fraction of the expected items | `Scope`, `RowPart` |
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
from typing import NamedTuple

from sfr_loc_map.metrics.config import CallKind

ANY = "*"  #: Accepts every value of a key in a look-up of rows; `score.JUDGED_ROW` selects the judged row instead.
MOVING = "moving"  #: Part of the rows with the errors of the sub-trajectories in which the rover moves.
OTHER_FRAMES = "other frames"
"""Part of the rows with the errors at the frames at which no judged sub-trajectory starts or ends."""
POOLED = "pooled"  #: Part of the rows over all drives of a suite.
FIRST = "first call"  #: Part of the row of the time of the first measured call.
AFTER_FIRST = "after the first call"  #: Part of the row of the times of the calls after the first.
ATTITUDE = "attitude"  #: Part of the row `truth_error` of the attitude error of the truth.
TRANSLATION, ROTATION = "translation", "rotation"  #: Parts of the rows of APE and RPE.
TURN = "attitude at the start"  #: Part of the rows `truth_error` of the displacement of N+x by an attitude error at N.
DISTANCE, TIME = "distance", "time"  #: Parts of the rows of the longest gap.
POINTS = "map points"  #: Part of the row `nees` of the sigma of map points.
COUNT = "count"  #: Part of the row with a number of items in place of their fraction.
SUB_TRAJECTORIES = "sub-trajectories"  #: Part of the row `standing` of one condition.
DIRECTIONS = {"x": "x (east)", "y": "y (north)", "z": "z (up)", "along": "along the path", "cross": "across the path"}
"""Parts of the position error along one direction, and their titles; x, y and z are axes of DS."""
NUMBER = r"(\d+(?:\.\d+)?(?:e[+-]\d+)?|inf)"  #: Pattern of a number >= 0 in the format `g`.


class Scope(StrEnum):
    """A part of a score that has expected items. The comments name the part and, after a colon, these items."""

    DRIVE = "drive"  #: The trajectory: images, or true poses if the images are unknown.
    MAP = "map"  #: The cloud: mapping pairs.
    CALLS = "calls"  #: The times of the calls of one kind: pairs.
    MEMORY = "memory"  #: The memory of the calls of one kind: pairs.
    LIVE = "live"  #: The messages of a live run.
    SUITE = "suite"  #: The results of a suite.


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


class RowPart(NamedTuple):
    """The part of a row."""

    what: str = ""  #: The part without call and place, which may be empty; in a row `judged`, the scope.
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

    @classmethod
    def text_of(cls, part: str | RowPart | None) -> str | None:
        """Return the text of a part that may already be a text, as written in a score."""
        if isinstance(part, RowPart):
            return part.text
        return None if part is None else str(part)

    @property
    def words(self) -> str:
        """The part in words, for a message."""
        if self.call is None:
            return self.what
        of_what = "memory of the " if self.what == Scope.MEMORY else ""
        return of_what + CALLS_IN_WORDS[self.call] + PLACES_IN_WORDS[self.place]

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
    found = re.fullmatch(f"{NUMBER}-{NUMBER} m", part or "")
    return None if found is None else (float(found[1]), float(found[2]))


def distance_part(distance_m: float) -> str:
    """Return the part of the errors over a distance travelled."""
    return f"{distance_m:g} m"


def distance_of(part: str | None) -> float | None:
    """Return the distance travelled of a part, m; None for another part."""
    found = re.fullmatch(f"{NUMBER} m", part or "")
    return None if found is None else float(found[1])

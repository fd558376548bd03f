"""The part of a row of the table of figures as a value: what the row is about, the kind of call, and where it ran.

In a score the part is one text, such as `target memory localisation`. The text is made and read here alone.
"""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from sfr_loc_map.metrics.config import CallKind


class Place(StrEnum):
    """Where calls were measured."""

    HOST = "host"  #: On the computer of the run; the text of a part does not name it.
    TARGET = "target"  #: On a target.
    STATED = "stated"  #: By an external node, which states times and memory of its own calls.


class RowPart(NamedTuple):
    """The part of a row."""

    #: Reading of the document, axis, range, stage of a call, ...; of a row `judged` what of the run was expected:
    #: `drive`, `map`, `live`, `suite`, or the time (`calls`) or `memory` of calls. Empty where nothing else is named.
    what: str = ""
    call: CallKind | None = None  #: Kind of call; None where the part names none.
    place: Place = Place.HOST  #: Where the calls were measured.

    @classmethod
    def of(cls, text: str | None) -> RowPart:
        """Return the part of a text, None for a row without a part."""
        words = text.split(" ") if text else []
        place, call = Place.HOST, None
        if words and words[0] in (Place.TARGET, Place.STATED):
            place = Place(words.pop(0))
        if words and words[-1] in [*CallKind]:
            call = CallKind(words.pop())
        return cls(" ".join(words), call, place)

    @property
    def text(self) -> str | None:
        """The part as a score has it; None without any word."""
        place = "" if self.place is Place.HOST else self.place
        return " ".join(filter(None, (place, self.what, self.call))) or None

    def at(self, place: Place) -> RowPart:
        """Return the same part of calls that were measured elsewhere."""
        return self._replace(place=place)

    @property
    def of_calls(self) -> RowPart:
        """The calls that the part is about, whichever number of them it names."""
        return self._replace(what="")

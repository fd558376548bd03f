"""What ends a sub-trajectory [4.1.1], and how it is written: in settings, in words and in the score."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import MetricsError

MAX_VALUE = 1e9
"""Metres, seconds or frames of a condition; as many seconds fit 64 bits of nanoseconds."""


class ConditionKind(StrEnum):
    """What is measured from the start of a sub-trajectory; the value is the word in settings."""

    DISTANCE = "distance"
    TIME = "time"
    FRAMES = "frames"

    @property
    def unit(self) -> str:
        """Unit of its value."""
        return _UNITS[self]

    @property
    def key(self) -> str:
        """Its key in the JSON of the score."""
        return _KEYS[self]


_UNITS = {ConditionKind.DISTANCE: "m", ConditionKind.TIME: "s", ConditionKind.FRAMES: "frames"}
_KEYS = {ConditionKind.DISTANCE: "distance_m", ConditionKind.TIME: "time_s", ConditionKind.FRAMES: "frames"}


@dataclass(frozen=True, slots=True)
class Condition:
    """What ends a sub-trajectory.

    Attributes:
        kind: Distance travelled, elapsed time or number of frames.
        value: Metres, seconds or number of frames, above 0, at most `MAX_VALUE`.
    """

    kind: ConditionKind
    value: float

    @classmethod
    def parse(cls, text: str) -> Condition:
        """Return the condition of a text such as `distance=5`, `time=60` or `frames=100`.

        Raises:
            MetricsError: If it is none.
        """
        kind, _, number = text.partition("=")
        try:
            return cls._checked(ConditionKind(kind), float(number))
        except ValueError as error:
            raise MetricsError(
                f"'{text}' is not a condition: give distance=METRES, time=SECONDS or frames=NUMBER, > 0, "
                f"at most {MAX_VALUE:g}"
            ) from error

    @classmethod
    def from_plain(cls, value: object) -> Condition:
        """Return the condition of its JSON: `{"distance_m": 5.0}`.

        Raises:
            ValueError: If it is none.
        """
        for kind in ConditionKind:
            if isinstance(value, Mapping) and list(value) == [kind.key]:
                number = value[kind.key]
                if isinstance(number, (int, float)) and not isinstance(number, bool):
                    return cls._checked(kind, float(number))
        raise ValueError('a condition such as {"distance_m": 5.0} is needed')

    @classmethod
    def _checked(cls, kind: ConditionKind, value: float) -> Condition:
        whole = kind is not ConditionKind.FRAMES or value == math.floor(value) if math.isfinite(value) else False
        if not whole or not 0 < value <= MAX_VALUE:
            raise ValueError(f"{kind} = {value} ends no sub-trajectory")
        return cls(kind, value)

    def to_plain(self) -> dict[str, float | int]:
        """Return it as in the JSON of the score: `{"distance_m": 5.0}`."""
        return {self.kind.key: int(self.value) if self.kind is ConditionKind.FRAMES else self.value}

    @property
    def label(self) -> str:
        """The one spelling for people: `5 m`, `60 s`, `100 frames`."""
        return f"{self.value:g} {self.kind.unit}"

    @property
    def setting(self) -> str:
        """The spelling in settings, from which `parse` makes the same condition: `distance=5.0`."""
        return f"{self.kind}={self.value!r}"

    @property
    def threshold(self) -> float:
        """The value in the unit that frames are counted in: metres, nanoseconds or frames."""
        return float(round(self.value * NS_PER_S)) if self.kind is ConditionKind.TIME else self.value

    def __str__(self) -> str:
        """Return the label."""
        return self.label

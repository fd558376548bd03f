"""Conditions that end a sub-trajectory [4.1.1], and their texts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from sfr_loc_map.errors import MetricsError

MAX_VALUE = 1e9  #: Maximum metres, seconds or frames of a condition; this many seconds fit 64 bits of nanoseconds.
VALUES_OF_CONDITIONS = (
    "give one or several of distance=METRES, time=SECONDS, frames=NUMBER, displacement=METRES and turn=DEGREES (up to "
    "180), separated by commas; values must be positive, and frames must be whole"
)
"""Rule of valid conditions in messages."""
_DECIMAL = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


class ConditionKind(StrEnum):
    """Quantity that is measured from the start of a sub-trajectory. The value of a member is its name in settings."""

    DISTANCE = "distance"  #: Length of the path.
    TIME = "time"
    FRAMES = "frames"
    DISPLACEMENT = "displacement"  #: Straight-line distance from the start.
    TURN = "turn"  #: Rotation angle from the attitude at the start.

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        return _UNITS[self]


_UNITS = {"distance": "m", "time": "s", "frames": "frames", "displacement": "m", "turn": "deg"}


class Component(NamedTuple):
    """A number of metres, seconds, frames or degrees that a sub-trajectory must reach."""

    kind: ConditionKind
    value: float  #: Positive, and at most `MAX_VALUE`.


@dataclass(frozen=True, slots=True)
class Condition:
    """Condition that ends a sub-trajectory at the first frame at which all its components hold. `parse` makes it."""

    components: tuple[Component, ...]  #: One component of each kind, in the order of `ConditionKind`.

    @classmethod
    def parse(cls, text: str) -> Condition:
        """Return the condition of a text such as `distance=5`, `time=60`, `frames=100` or `distance=5,time=10`.

        A unit after the number is accepted (`distance=5 m`). MetricsError if the text is not a valid condition.
        """
        try:
            given = cls(tuple(_component(word) for word in text.split(",")))
        except ValueError as error:
            raise MetricsError(f"'{text}' is not a condition: {VALUES_OF_CONDITIONS}") from error
        if len({each.kind for each in given.components}) < len(given.components):
            raise MetricsError(f"'{given.setting}' has the same kind of condition twice: give each kind once")
        return cls(tuple(sorted(given.components, key=lambda each: list(ConditionKind).index(each.kind))))

    @property
    def is_of_time(self) -> bool:
        """Whether the condition also ends a sub-trajectory in which the rover is stationary."""
        return all(each.kind in (ConditionKind.TIME, ConditionKind.FRAMES) for each in self.components)

    def added_by_standing(self, sub_trajectories: str) -> str:
        """Return the sentence that a stationary rover adds sub-trajectories, which the argument counts."""
        if self.is_of_time:
            are_added = "have a stationary rover"
        else:
            are_added = "begin where the previous one begins, because the rover is stationary"
        return f"{sub_trajectories} over {self.label} {are_added}"

    @property
    def label(self) -> str:
        """The displayed form: `5 m`, `60 s`, `100 frames`, `5 m and 10 s`."""
        straight = {ConditionKind.DISPLACEMENT: " straight", ConditionKind.TURN: " turned"}
        texts = []
        for each in self.components:
            texts.append(f"{shortest(each.value)} {each.kind.unit}{straight.get(each.kind, '')}")
        return " and ".join(texts)

    @property
    def setting(self) -> str:
        """The form on the command line and in the score, which `parse` reads: `distance=5`."""
        return ",".join(f"{each.kind}={shortest(each.value)}" for each in self.components)

    def __str__(self) -> str:
        return self.label


def _component(text: str) -> Component:
    """Return the component of a text such as `distance=5 m`; ValueError if it is invalid."""
    name, _, number = text.partition("=")
    kind = ConditionKind(name.strip())
    value = _decimal(number.strip().removesuffix(kind.unit).rstrip())
    largest = 180.0 if kind is ConditionKind.TURN else MAX_VALUE
    is_countable = kind is not ConditionKind.FRAMES or value % 1.0 == 0.0
    if not 0.0 < value <= largest or not is_countable:
        raise ValueError(f"{value:g} is not a value of {kind}")
    return Component(kind, value)


def _decimal(text: str) -> float:
    """Return a decimal number; ValueError for another text that `float` accepts, such as `1_0`."""
    if _DECIMAL.fullmatch(text) is None:
        raise ValueError(f"'{text}' is not a decimal number")
    return float(text)


def is_written_condition(text: str) -> bool:
    """Return whether a text is a condition as scores write it."""
    try:
        return Condition.parse(text).setting == text
    except MetricsError:
        return False


def shortest(number: float) -> str:
    """Return the shortest text that is read back as the same number: `5` for 5.0."""
    text = f"{number:g}"
    return text if float(text) == number else repr(number)


def label_of(condition: str | None) -> str:
    """Return the displayed form of a condition of a score: `5 m` for `distance=5`; empty for None."""
    return "" if condition is None else Condition.parse(condition).label

"""How a number is written for a reader: four significant digits, in a unit with a name."""

from __future__ import annotations

from dataclasses import dataclass

UNKNOWN = "unknown"
"""Stands for a fact that is not there."""
NOT_ENOUGH = "not enough data"
"""Stands for a figure that is not defined."""
ABSENT = "-"
"""Stands for a figure that does not apply."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit that values are shown in.

    Attributes:
        symbol: Its symbol; empty for pure numbers.
        size: One of it in the unit of the values: 1e-3 for milliseconds of values in seconds.
    """

    symbol: str
    size: float = 1.0


NONE = Unit("")
METRE, SECOND, DEGREE, PIXEL, SHARE = Unit("m"), Unit("s"), Unit("deg"), Unit("px"), Unit("share")
MILLIMETRE, MILLISECOND, PERCENT = Unit("mm", 1e-3), Unit("ms", 1e-3), Unit("%", 1e-2)
MIB = Unit("MiB", 2.0**20)


def number(value: float | int | None, undefined: str = UNKNOWN, unit: Unit = NONE, *, signed: bool = False) -> str:
    """Return a value in a unit with four significant digits, whole numbers in full.

    Args:
        value: The value; None if it is not defined.
        undefined: Words for None.
        unit: Unit to show it in.
        signed: Whether a plus sign is written.
    """
    if value is None:
        return undefined
    shown = value if unit.size == 1.0 else value / unit.size
    sign = "+" if signed else ""
    if isinstance(shown, int) or 1e4 <= abs(shown) < 1e7:
        return f"{shown:{sign}.0f}"
    return f"{shown:{sign}.4g}"

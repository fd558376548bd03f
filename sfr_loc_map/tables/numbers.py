"""How a number is written for a reader: four significant digits, in a unit with a name."""

from __future__ import annotations

import math
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
_SMALLER = {"m": (1.0, MILLIMETRE), "s": (10.0, MILLISECOND)}
"""By symbol: values that are all below this, in that unit, are shown in the smaller one."""


def fitting(unit: Unit, *values: float | None) -> Unit:
    """Return the unit that suits values which are compared with each other: 3.2 mm rather than 0.0032 m.

    Args:
        unit: Unit of the values; only metres and seconds have a smaller one.
        values: The values; None is left out.
    """
    limit, smaller = _SMALLER.get(unit.symbol, (0.0, unit))
    largest = max((abs(value) for value in values if value is not None and math.isfinite(value)), default=0.0)
    return smaller if 0.0 < largest < limit else unit


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

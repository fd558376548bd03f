"""What tables are made of: figures of the score, each with the place in the JSON that it comes from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

NOT_ENOUGH = "not enough data"
UNKNOWN = "unknown"
MIB = 2**20
VERDICT_ICONS = {"pass": "✔", "fail": "✖", NOT_ENOUGH: "?"}
"""A verdict is told by word and sign; colour only repeats it."""

_CONDITION_UNITS = {"distance_m": "m", "time_s": "s", "frames": "frames"}


@dataclass(frozen=True, slots=True)
class Cell:
    """One place of a table.

    Attributes:
        text: What is shown.
        value: The same exactly; None for words and for what is undefined.
        key: Where it comes from, in the form `trajectory.position_m.mean`; empty for words.
        kind: `verdict` for a verdict, `head` for the first of a row, otherwise empty.
    """

    text: str
    value: float | int | None = None
    key: str = ""
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """One table.

    Attributes:
        name: Short name, used as an anchor.
        title: What it shows.
        columns: Heads of the columns.
        rows: As many cells as columns in each.
        note: How the figures are to be read.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


def dig(value: Any, key: str) -> Any:  # noqa: ANN401 - any value of JSON
    """Return what a key in the form `map.by_range.0.mean` leads to, None where there is nothing."""
    for part in key.split("."):
        if isinstance(value, Mapping):
            value = value.get(part)
        elif isinstance(value, Sequence) and not isinstance(value, str) and part.isdigit() and int(part) < len(value):
            value = value[int(part)]
        else:
            return None
    return value


def number(value: float | int | None, undefined: str = UNKNOWN) -> str:
    """Return a figure with four significant digits, or the words for one that is not defined."""
    if value is None:
        return undefined
    if isinstance(value, int) or (1e4 <= abs(value) < 1e7):
        return f"{value:.0f}"
    return f"{value:.4g}"


def condition_text(condition: Mapping[str, float] | None) -> str:
    """Return a condition in words: `5 m`."""
    return " ".join(f"{value:g} {_CONDITION_UNITS.get(key, '')}".strip() for key, value in (condition or {}).items())


def conditions_of(score: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return all conditions of the trajectory's score with the key that leads to each."""
    trajectory = score.get("trajectory")
    if not trajectory:
        return []
    several = trajectory.get("conditions")
    if several:
        return [(f"trajectory.conditions.{k}", part) for k, part in enumerate(several)]
    return [("trajectory", trajectory)]


def scaled_value(value: float | int | None, scale: float) -> float | int | None:
    """Return the value in another unit, None for None."""
    return value if value is None or scale == 1.0 else value / scale


def cell_of(score: Mapping[str, Any], key: str, undefined: str = UNKNOWN, scale: float = 1.0) -> Cell:
    """Return the figure at a place of the score, divided by a scale, or the word for one that is not defined."""
    value = dig(score, key)
    return Cell(number(scaled_value(value, scale), undefined), value, key)


def interval_of(score: Mapping[str, Any], key: str, scale: float = 1.0, undefined: str = "-") -> Cell:
    """Return the interval at a place of the score, or the word for one that is not there."""
    bounds = dig(score, key)
    if not bounds:
        return Cell(undefined)
    return Cell(f"{number(scaled_value(bounds[0], scale))} to {number(scaled_value(bounds[1], scale))}", None, key)

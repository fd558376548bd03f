"""Figures of a benchmark as rows: figures of a pass, medians over the passes, and ratios of two methods."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

ACCURACY, TIME, MEMORY = "accuracy", "time_s", "memory_bytes"
COMPARED = (ACCURACY, TIME, MEMORY)
"""First keys of the figures for which ratios of our method to the others are reported."""


class FigureRow(NamedTuple):
    """A figure of a pass, a median over the passes, or a ratio."""

    keys: tuple[str, ...]  #: Keys of the value in the JSON of a method, such as `accuracy`, `distance=5`, `position_m`.
    value: float | None  #: None if unknown.


def medians(passes: Sequence[Iterable[FigureRow]]) -> list[FigureRow]:
    """Return the median of each figure over the passes in which its value is known."""
    values: dict[tuple[str, ...], list[float]] = {}
    for rows in passes:
        for row in rows:
            known = values.setdefault(row.keys, [])
            if row.value is not None:
                known.append(row.value)
    return [FigureRow(keys, float(np.median(known)) if known else None) for keys, known in values.items()]


def ratios(ours: Iterable[FigureRow], others: Iterable[FigureRow]) -> Iterator[FigureRow]:
    """Yield `abs(ours / other)` of each compared figure that both methods have; None if the other's value is 0."""
    other_values = {row.keys: row.value for row in others}
    for row in ours:
        other = other_values.get(row.keys)
        if row.keys[0] in COMPARED and row.value is not None and other is not None:
            yield FigureRow(row.keys, abs(row.value / other) if other else None)


def nested(rows: Iterable[FigureRow]) -> dict[str, Any]:
    """Return the values of rows by their keys, for JSON."""
    found: dict[str, Any] = {}
    for row in rows:
        place = found
        for key in row.keys[:-1]:
            place = place.setdefault(key, {})
        place[row.keys[-1]] = row.value
    return found

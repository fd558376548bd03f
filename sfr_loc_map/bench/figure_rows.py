"""Figures of a benchmark as rows: figures of a pass, medians over the passes, and ratios of two methods."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from sfr_loc_map.tables.model import Column

ACCURACY, TIME, MEMORY = "accuracy", "time_s", "memory_bytes"
COMPARED = (ACCURACY, TIME, MEMORY)
"""First keys of the figures for which ratios of our method to the others are reported."""


class FigureRow(NamedTuple):
    """A figure of a pass, a median over the passes, or a ratio."""

    keys: tuple[str, ...]  #: Keys of the value in the JSON of a method, such as `accuracy`, `distance=5`, `position_m`.
    value: float | None  #: None if unknown.
    column: Column | None = None  #: Column of the table that shows the figure; None if no column does.


def medians(passes: Sequence[Iterable[FigureRow]]) -> list[FigureRow]:
    """Return the median of each figure over the passes in which its value is known."""
    of_figure: dict[tuple[str, ...], list[FigureRow]] = {}
    for rows in passes:
        for row in rows:
            of_figure.setdefault(row.keys, []).append(row)
    return [_median(rows) for rows in of_figure.values()]


def _median(rows: Sequence[FigureRow]) -> FigureRow:
    """Return the median of one figure in several passes."""
    known = [row.value for row in rows if row.value is not None]
    return rows[0]._replace(value=float(np.median(known)) if known else None)


def ratios(ours: Iterable[FigureRow], others: Iterable[FigureRow]) -> Iterator[FigureRow]:
    """Yield `abs(ours / other)` of each compared figure that both methods have; None if the other's value is 0."""
    other_values = {row.keys: row.value for row in others}
    for row in ours:
        other = other_values.get(row.keys)
        if row.keys[0] in COMPARED and row.value is not None and other is not None:
            yield row._replace(value=abs(row.value / other) if other else None)


def nested(rows: Iterable[FigureRow]) -> dict[str, Any]:
    """Return the values of rows by their keys, for JSON."""
    found: dict[str, Any] = {}
    for row in rows:
        place = found
        for key in row.keys[:-1]:
            place = place.setdefault(key, {})
        place[row.keys[-1]] = row.value
    return found

"""The rows of the table of figures, and how they are found by figure, subject, condition and part."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from sfr_loc_map.configuration.parameters import suggestion
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import KINDS, Content, clause_of, unit_of_row
from sfr_loc_map.metrics.figures.row_part import ANY, Place, RowPart
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import STATISTICS, Statistics
from sfr_loc_map.metrics.statistics.intervals import Interval, chi2_interval95


class RowNumbers(Statistics, frozen=True, kw_only=True):
    """The numbers of a row: the statistics of its values and other numbers."""

    independent: float | None = None  #: Number of independent values: n divided by the overlap of sub-trajectories.
    low95: float | None = None  #: Lower bound of the 95 % interval of mean + 3 sigma; of NEES, see `value`.
    high95: float | None = None  #: Upper bound of this interval.
    #: The value of a count, fraction or peak. Of normalised errors (NEES), `value` is the mean that a consistent
    #: covariance has, and 95 % of the means of a consistent covariance lie between `low95` and `high95`.
    value: float | None = None


class Figure(RowNumbers, frozen=True):
    """One row of the table of figures: its keys, then its numbers. Numbers that are undefined are null."""

    subject: Subject  #: What the figure is about.
    figure: str  #: Name of the figure.
    unit: str  #: `m`, `deg`, `px`, `s`, `bytes`; `1` for counts and fractions.
    clause: str = ""  #: Clause of the specification that defines the figure; empty if the specification does not.
    condition: str | None = None  #: Condition that ends the sub-trajectories [4.1.1], as on the command line.
    #: Part of the figure: the reading (`pose`, `displacement`, `position`), an axis or direction (`x`,
    #: `along`), a range (`0-4 m`), a pair (`pair 0`), a kind or stage of calls, a distance (`5 m`), the number of items
    #: instead of their fraction (`count`), or other errors than the judged ones (`moving`, `other frames`, `pooled`).
    #: The part of calls that were not measured on the host begins with `target` or `stated`.
    part: RowPart | None = None

    @property
    def keys(self) -> tuple[str | None, ...]:
        """Subject, figure, condition and part, which no two rows of a table have in common."""
        return self.subject, self.figure, self.condition, self.part

    @property
    def place(self) -> Place:
        """Where the calls of the row were measured."""
        return Place.HOST if self.part is None else self.part.place

    @property
    def call(self) -> CallKind | None:
        """Kind of call that the row is about, None if the row is not about calls."""
        if self.figure in [*CallKind]:
            return CallKind(self.figure)
        return None if self.part is None else self.part.call

    @property
    def interval(self) -> Interval | None:
        """Both bounds of the 95 % interval, None if it is undefined."""
        return None if self.low95 is None or self.high95 is None else (self.low95, self.high95)

    @property
    def expected(self) -> float | None:
        """Expected mean NEES of a consistent covariance; None for other figures."""
        return None if self.mean is None else self.value

    @property
    def is_defined(self) -> bool:
        """Whether the row has a value: the one number of its figure, or the statistics of at least two values."""
        if self.is_one_number:
            return self.value is not None
        return self.mean is not None and (self.n or 0) > 1

    @property
    def is_one_number(self) -> bool:
        """Whether the row has a single number, according to its numbers, or to its figure if it has no numbers."""
        if self.value is not None or self.mean is not None:
            return self.mean is None
        return self.figure in KINDS and KINDS[self.figure].content is not Content.STATISTICS

    @property
    def label(self) -> str:
        """Figure, condition and part, the name of the row in messages."""
        return " ".join(filter(None, (self.figure, self.condition, self.part)))

    def statistic(self, name: str) -> float | None:
        """Return the value in a column; ConfigError if there is no numeric column of this name."""
        if name not in RowNumbers.__struct_fields__:
            raise ConfigError(f"there is no statistic '{name}'{suggestion(name, RowNumbers.__struct_fields__)}")
        found: float | None = getattr(self, name)
        return found

    def as_dict(self) -> dict[str, Any]:
        """Return all columns by name."""
        return msgspec.structs.asdict(self)


COLUMNS = tuple(Figure.__struct_fields__)
NUMBERS = (*STATISTICS, "value")
"""Columns that a view shows: the statistics, then the value of figures with a single number."""


def figure_row(
    figure: str,
    condition: str | None = None,
    part: str | None = None,
    statistics: Statistics | None = None,
    **numbers: float | None,
) -> Figure:
    """Return the row of a figure of the catalogue, with its clause, its subject and its unit."""
    kind = KINDS[figure]
    of_row = RowPart.of(part)
    row: dict[str, Any] = {} if statistics is None else msgspec.structs.asdict(statistics)
    for name, value in numbers.items():
        row[name] = None if value is None else int(value) if name == "n" else float(value)
    return Figure(
        clause=clause_of(kind.name, of_row),
        subject=kind.subject,
        condition=condition,
        part=of_row,
        figure=kind.name,
        unit=unit_of_row(kind.name, of_row),
        **row,
    )


def nees_row(
    figure: str,
    squares: FloatArray,
    degrees: int,
    condition: str | None = None,
    part: str | None = None,
    p50: float | None = None,
) -> Figure:
    """Return the row of the mean of normalised squared errors `(n,)`, each with this number of degrees of freedom.

    If the covariance is consistent, n times the mean has a chi-squared distribution (Bar-Shalom, Li, Kirubarajan 2001,
    section 5.4), which gives `value`, `low95` and `high95` (`RowNumbers`).
    """
    count = len(squares)
    low, high = chi2_interval95(degrees * count, count) if count else (None, None)
    mean = float(np.mean(squares)) if count else None
    return figure_row(figure, condition, part, n=count, mean=mean, low95=low, high95=high, p50=p50, value=degrees)


def find_rows(
    figures: tuple[Figure, ...],
    figure: str = ANY,
    *,
    subject: str = ANY,
    condition: str | Condition | None = ANY,
    part: str | None = ANY,
) -> Iterator[Figure]:
    """Yield the rows that have these keys, in the order of the table.

    ConfigError if neither the catalogue nor a row has this figure, and MetricsError if the condition is invalid.
    """
    if figure != ANY and figure not in KINDS and not any(row.figure == figure for row in figures):
        raise ConfigError(f"there is no figure '{figure}'{suggestion(figure, KINDS)}: give one that exists")
    if isinstance(condition, Condition):
        condition = condition.setting
    elif condition is not None and condition != ANY:
        condition = Condition.parse(str(condition)).setting
    for row in figures:
        fits = (
            figure in (ANY, row.figure),
            subject in (ANY, row.subject),
            condition in (ANY, row.condition),
            part in (ANY, row.part),
        )
        if all(fits):
            yield row


def number_text(value: float | None) -> str:
    """Return a number of a row as the text of a message."""
    return "null" if value is None else f"{value:.9g}"

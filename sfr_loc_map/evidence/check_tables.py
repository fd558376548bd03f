"""Tables of a check without a ground truth (`sfr check`), from its figures: one for each kind of evidence.

`evidence.kinds` states what the numbers of each table show and what they hide. Each line of a table shows the figures
with the same condition and part (`Item`). A cell with a number also contains the path of this number in the JSON, such
as `figures.3.value`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence import kinds
from sfr_loc_map.evidence.kinds import EvidenceKind
from sfr_loc_map.evidence.localiser_runs import AT_REVISITED_PLACES, OWN_COMPARISONS
from sfr_loc_map.mapping.multiview.projection import SHIFT_PX
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.catalogue import REVISITED_PLACES
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.tables.model import METRE, NONE, PERCENT, Cell, Column, Table, Unit, fitting
from sfr_loc_map.tables.typed import RowColumn, heads, table_of, words

CALIBRATION_NAMES = {
    "right_camera": "right camera, ",
    "right_camera_spread": "difference between the runs, ",
    "depth_error": "error of depth ",
    "calibration_cost": "shift of positions by correction of ",
}
"""Figures of the calibration table and the prefixes of their names."""


# ---- lines and columns


class Item(NamedTuple):
    """One line of a table: the figures that have the same condition and part."""

    condition: str | None
    part: str | None
    rows: dict[str, Figure]  #: Rows by the name of their figure.
    indices: dict[str, int]  #: Index of each row in the figures of the check, by the name of the figure.

    def row(self, figure: str) -> Figure:
        """Return the row of a figure; InputError if the check, which may come from a file, does not have it."""
        if figure not in self.rows:
            line = ", ".join(filter(None, (self.condition, self.part)))
            raise InputError(f"the check has no figure '{figure}' for '{line}': give a file of sfr check")
        return self.rows[figure]

    def number(self, figure: str, name: str = "value") -> float | None:
        """Return a number of a figure."""
        return self.row(figure).statistic(name)

    def cell(self, figure: str, name: str = "value", unit: Unit = NONE) -> Cell:
        """Return a statistic of a figure as a table cell."""
        value = self.number(figure, name)
        return Cell.number(value, f"figures.{self.indices[figure]}.{name}", unit)


def items_with(figure: str, figures: Sequence[Figure]) -> list[Item]:
    """Return the items that have a figure, in the order of the figures of a check.

    InputError if two rows have the same figure, condition and part, because one line cannot show both.
    """
    items: dict[tuple[str | None, str | None], Item] = {}
    for index, row in enumerate(figures):
        item = items.setdefault((row.condition, row.part), Item(row.condition, row.part, {}, {}))
        if row.figure in item.rows:
            raise InputError(f"two figures of the check have the name '{row.label}': unique names are required")
        item.rows[row.figure] = row
        item.indices[row.figure] = index
    return [item for item in items.values() if figure in item.rows]


def numbers(title: str, figure: str, name: str = "value", unit: Unit = NONE) -> RowColumn[Item]:
    """Return the column of a statistic of a figure."""
    return RowColumn(Column(title, unit), lambda item: item.cell(figure, name, unit))


def intervals(title: str, figure: str, unit: Unit) -> RowColumn[Item]:
    """Return the column of the 95 % interval of a figure."""
    return RowColumn(
        Column(title, unit),
        lambda item: Cell.interval(item.row(figure).interval, f"figures.{item.indices[figure]}", unit),
    )


class Length(NamedTuple):
    """A statistic of a figure in metres, which is displayed in a unit that suits its line of the table."""

    title: str
    figure: str
    name: str = "value"  #: Name of the statistic.


def lengths(*shown: Length) -> tuple[RowColumn[Item], ...]:
    """Return the column of the unit, which all lengths in a line of the table have, and one column for each length."""

    def unit_of(item: Item) -> Unit:
        return fitting(METRE, *(item.number(length.figure, length.name) for length in shown))

    def column_of(length: Length) -> RowColumn[Item]:
        return RowColumn(Column(length.title), lambda item: item.cell(length.figure, length.name, unit_of(item)))

    units: RowColumn[Item] = RowColumn(Column("unit"), lambda item: Cell(unit_of(item).symbol))
    return units, *map(column_of, shown)


def parts(title: str) -> RowColumn[Item]:
    """Return the column with the names of the lines of the table."""
    return heads(title, lambda item: item.part or "")


OVER: RowColumn[Item] = words("over", lambda item: label_of(item.condition))


# ---- the tables


class CheckTable(NamedTuple):
    """The table of a kind of evidence."""

    kind: EvidenceKind
    figure: str  #: Figure that each line of the table has.
    columns: tuple[RowColumn[Item], ...]
    parts: Collection[str] | None = None  #: Parts of the figures that the table shows; None for all.

    def of(self, figures: Sequence[Figure]) -> Table:
        """Return the table of the figures of a check."""
        items = items_with(self.figure, figures)
        if self.parts is not None:
            items = [item for item in items if item.part in self.parts]
        return table_of(self.kind.name, self.kind.title, self.columns, items, self.kind.note)


AGREEMENT_TABLE = CheckTable(
    kinds.AGREEMENT,
    "difference",
    (
        parts("runs"),
        words("over", lambda item: REVISITED_PLACES if item.part == AT_REVISITED_PLACES else label_of(item.condition)),
        *lengths(Length("difference, rmse", "difference", "rmse"), Length("minimum error of a run", "error_at_least")),
        numbers("n", "difference", "n"),
        numbers("NEES", "difference_nees", "mean"),
        numbers("expected below", "difference_nees", "high95"),
        numbers("independent", "difference_nees", "n"),
        numbers("p", "agreement"),
    ),
    parts=OWN_COMPARISONS,
)
REVISITED_TABLE = CheckTable(
    kinds.REVISITED,
    "misclosure",
    (
        parts("revisited place"),
        numbers("path", "revisited_path", unit=METRE),
        *lengths(Length("misclosure", "misclosure")),
        numbers("of the path", "misclosure_of_path", unit=PERCENT),
        numbers("NEES", "misclosure_nees"),
    ),
)
PREDICTED_TABLE = CheckTable(
    kinds.PREDICTED,
    "predicted",
    (
        parts("source"),
        OVER,
        numbers("fraction of the mean square", "predicted_share", unit=PERCENT),
        *lengths(Length("position, rms", "predicted")),
        numbers("attitude, rms", "predicted_attitude", unit=Unit("deg")),
        numbers("n", "predicted", "n"),
    ),
)
SCALE_TABLE = CheckTable(
    kinds.SCALE,
    "scale",
    (
        parts("runs"),
        OVER,
        *lengths(Length("difference, rmse", "difference", "rmse"), Length("minimum error of a run", "error_at_least")),
        numbers("excess of length", "scale", unit=PERCENT),
        intervals("95 % interval", "scale", PERCENT),
        numbers("n", "scale", "n"),
        numbers("independent", "scale", "independent"),
    ),
)
HAT_TABLE = CheckTable(
    kinds.HAT,
    "hat_sigma",
    (parts("estimate"), OVER, *lengths(Length("sigma", "hat_sigma")), numbers("n", "hat_sigma", "n")),
)
OVERLAP_TABLE = CheckTable(
    kinds.OVERLAP,
    "overlap",
    (
        parts("maps"),
        numbers("overlap", "overlap", unit=PERCENT),
        *lengths(Length("range difference, rms", "overlap_difference")),
        numbers("ratio to the expected difference", "overlap_ratio"),
        numbers(f"ratio to the grey difference {SHIFT_PX} px away", "overlap_grey"),
        numbers("points", "overlap", "n"),
    ),
)


def check_tables(figures: Sequence[Figure], advice: Mapping[str, str]) -> list[Table]:
    """Return the tables of the figures of a check; tables without rows are omitted.

    `advice` is the advice of the check for each angle of the right camera (roll, pitch, yaw).
    """
    of_drive = (AGREEMENT_TABLE, REVISITED_TABLE, PREDICTED_TABLE, SCALE_TABLE, HAT_TABLE)
    tables = (*(item.of(figures) for item in of_drive), calibration_table(figures, advice), OVERLAP_TABLE.of(figures))
    return [table for table in tables if table.rows]


@dataclass(frozen=True, slots=True)
class OffsetRow:
    """A figure of the calibration table."""

    figure: Figure
    index: int  #: Index of the figure in the figures of the check.
    advice: str | None  #: Recommended action for the calibration file.

    @property
    def name(self) -> str:
        """Displayed name of the figure."""
        over = f" over {label_of(self.figure.condition)}" if self.figure.condition else ""
        return f"{CALIBRATION_NAMES[self.figure.figure]}{self.figure.part}{over}"

    @property
    def unit(self) -> Unit:
        """Displayed unit."""
        return fitting(Unit(self.figure.unit), self.figure.value)

    def cell(self, name: str, unit: Unit = NONE) -> Cell:
        """Return a number of the figure as a table cell."""
        return Cell.number(self.figure.statistic(name), f"figures.{self.index}.{name}", unit)


OFFSETS: tuple[RowColumn[OffsetRow], ...] = (
    heads("calibration", lambda row: row.name),
    RowColumn(Column("unit"), lambda row: Cell(row.unit.symbol)),
    RowColumn(Column("value"), lambda row: row.cell("value", row.unit)),
    RowColumn(Column("n"), lambda row: row.cell("n")),
    words("calibration file", lambda row: row.advice),
)


def calibration_table(figures: Sequence[Figure], advice: Mapping[str, str]) -> Table:
    """Return the offsets of the right camera as a table. `advice` is the advice of the check for each angle."""
    rows = [
        OffsetRow(figure, index, advice.get(figure.part or "") if figure.figure == "right_camera" else None)
        for index, figure in enumerate(figures)
        if figure.figure in CALIBRATION_NAMES
    ]
    kind = kinds.CALIBRATION
    return table_of(kind.name, kind.title, OFFSETS, rows, kind.note)

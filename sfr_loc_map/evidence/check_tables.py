"""Tables of a check without a ground truth (`sfr check`), from its figures: one for each kind of evidence.

`evidence.kinds` states what the numbers of each table show and what they hide. Each line of a table shows the figures
with the same condition and part. The cell of a number has its key in the JSON.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence import kinds
from sfr_loc_map.evidence.kinds import EvidenceKind
from sfr_loc_map.mapping.multiview.projection import SHIFT_PX
from sfr_loc_map.metrics.config import label_of
from sfr_loc_map.metrics.table.catalogue import REVISITED_PLACES
from sfr_loc_map.metrics.table.rows import Figure
from sfr_loc_map.tables.model import ABSENT, METRE, NONE, PERCENT, Cell, Column, Row, Table, Unit, fitting

CALIBRATION_NAMES = {
    "right_camera": "right camera, ",
    "right_camera_spread": "difference between the runs, ",
    "depth_error": "error of depth ",
    "calibration_cost": "shift of positions by correction of ",
}
"""Figures of the calibration table and the prefixes of their names."""


def check_tables(figures: Sequence[Figure], advice: Mapping[str, str]) -> list[Table]:
    """Return the tables of the figures of a check and of its advice by angle; tables without rows are omitted."""
    tables = (
        agreement_table(figures),
        closure_table(figures),
        predicted_table(figures),
        scale_table(figures),
        hat_table(figures),
        calibration_table(figures, advice),
        overlap_table(figures),
    )
    return [table for table in tables if table.rows]


def _table(kind: EvidenceKind, columns: Sequence[Column], rows: Sequence[Row]) -> Table:
    return Table(kind.name, kind.title, tuple(columns), tuple(rows), kind.note)


def agreement_table(figures: Sequence[Figure]) -> Table:
    """Return the comparisons as a table, one line each."""
    rows = []
    for item in items_with("difference", figures):
        unit = fitting(METRE, item.number("difference", "rmse"), item.number("error_at_least"))
        rows.append(
            (
                Cell.head(item.part or ""),
                Cell(label_of(item.condition) or REVISITED_PLACES),
                Cell(unit.symbol),
                item.cell("difference", "rmse", unit),
                item.cell("error_at_least", unit=unit),
                item.cell("difference", "n"),
                item.cell("difference_nees", "mean"),
                item.cell("difference_nees", "high95"),
                item.cell("difference_nees", "n"),
                item.cell("agreement"),
            )
        )
    columns = (
        Column("runs", words=True),
        Column("over", words=True),
        Column("unit"),
        Column("difference, rmse"),
        Column("minimum error of a run"),
        Column("n"),
        Column("NEES"),
        Column("expected below"),
        Column("independent"),
        Column("p"),
    )
    return _table(kinds.AGREEMENT, columns, rows)


def closure_table(figures: Sequence[Figure]) -> Table:
    """Return the revisited places as a table."""
    rows = []
    for item in items_with("misclosure", figures):
        unit = fitting(METRE, item.number("misclosure"))
        rows.append(
            (
                Cell.head(item.part or ""),
                item.cell("revisited_path", unit=METRE),
                Cell(unit.symbol),
                item.cell("misclosure", unit=unit),
                item.cell("misclosure_of_path", unit=PERCENT),
                item.cell("misclosure_nees"),
            )
        )
    columns = (
        Column("revisited place", words=True),
        Column("path", METRE),
        Column("unit"),
        Column("misclosure"),
        Column("of the path", PERCENT),
        Column("NEES"),
    )
    return _table(kinds.REVISITED, columns, rows)


def predicted_table(figures: Sequence[Figure]) -> Table:
    """Return the predicted error by source as a table."""
    rows = []
    for item in items_with("predicted", figures):
        unit = fitting(METRE, item.number("predicted"))
        rows.append(
            (
                Cell.head(item.part or ""),
                Cell(label_of(item.condition)),
                item.cell("predicted_share", unit=PERCENT),
                Cell(unit.symbol),
                item.cell("predicted", unit=unit),
                item.cell("predicted_attitude"),
                item.cell("predicted", "n"),
            )
        )
    columns = (
        Column("source", words=True),
        Column("over", words=True),
        Column("fraction of the mean square", PERCENT),
        Column("unit"),
        Column("position, rms"),
        Column("attitude, rms", Unit("deg")),
        Column("n"),
    )
    return _table(kinds.PREDICTED, columns, rows)


def scale_table(figures: Sequence[Figure]) -> Table:
    """Return the excess of length over other estimates as a table."""
    rows = []
    for index, row in enumerate(figures):
        if row.figure == "scale":
            cells = (
                Cell.head(row.part or ""),
                Cell(label_of(row.condition)),
                Cell.number(row.value, f"figures.{index}.value", PERCENT),
                Cell.interval(row.interval, f"figures.{index}", PERCENT),
                Cell.number(row.n, f"figures.{index}.n"),
                Cell.number(row.independent, f"figures.{index}.independent", undefined=ABSENT),
            )
            rows.append(cells)
    columns = (
        Column("runs", words=True),
        Column("over", words=True),
        Column("excess of length", PERCENT),
        Column("95 % interval", PERCENT),
        Column("n"),
        Column("independent"),
    )
    return _table(kinds.SCALE, columns, rows)


def hat_table(figures: Sequence[Figure]) -> Table:
    """Return the sigmas of three estimates as a table."""
    rows = []
    for index, row in enumerate(figures):
        if row.figure == "hat_sigma":
            unit = fitting(METRE, row.value)
            sigma = Cell.number(row.value, f"figures.{index}.value", unit)
            count = Cell.number(row.n, f"figures.{index}.n")
            rows.append((Cell.head(row.part or ""), Cell(label_of(row.condition)), Cell(unit.symbol), sigma, count))
    columns = (Column("estimate", words=True), Column("over", words=True), Column("unit"), Column("sigma"), Column("n"))
    return _table(kinds.HAT, columns, rows)


def calibration_table(figures: Sequence[Figure], advice: Mapping[str, str]) -> Table:
    """Return the offsets of the right camera as a table, with the advice of the check by angle."""
    rows = []
    for index, row in enumerate(figures):
        if row.figure in CALIBRATION_NAMES:
            unit = fitting(Unit(row.unit), row.value)
            over = f" over {label_of(row.condition)}" if row.condition else ""
            action = advice.get(row.part or "") if row.figure == "right_camera" else None
            cells = (
                Cell.head(f"{CALIBRATION_NAMES[row.figure]}{row.part}{over}"),
                Cell(unit.symbol),
                Cell.number(row.value, f"figures.{index}.value", unit),
                Cell.number(row.n, f"figures.{index}.n"),
                Cell(ABSENT if action is None else str(action)),
            )
            rows.append(cells)
    columns = (
        Column("calibration", words=True),
        Column("unit"),
        Column("value"),
        Column("n"),
        Column("calibration file", words=True),
    )
    return _table(kinds.CALIBRATION, columns, rows)


def overlap_table(figures: Sequence[Figure]) -> Table:
    """Return the overlaps of maps as a table."""
    rows = []
    for item in items_with("overlap", figures):
        unit = fitting(METRE, item.number("overlap_difference"))
        rows.append(
            (
                Cell.head(item.part or ""),
                item.cell("overlap", unit=PERCENT),
                Cell(unit.symbol),
                item.cell("overlap_difference", unit=unit),
                item.cell("overlap_ratio"),
                item.cell("overlap_grey"),
                item.cell("overlap", "n"),
            )
        )
    columns = (
        Column("maps", words=True),
        Column("overlap", PERCENT),
        Column("unit"),
        Column("range difference, rms"),
        Column("ratio to the expected difference"),
        Column(f"grey difference over that {SHIFT_PX} px away"),
        Column("points"),
    )
    return _table(kinds.OVERLAP, columns, rows)


class Item(NamedTuple):
    """One line of a table: the figures that have the same condition and part."""

    condition: str | None
    part: str | None
    rows: dict[str, Figure]  #: Rows by the name of their figure.
    indices: dict[str, int]  #: Index of each row in the figures of the check, by the name of the figure.

    def number(self, figure: str, name: str = "value") -> float | None:
        """Return a number of a figure."""
        return self.rows[figure].statistic(name)

    def cell(self, figure: str, name: str = "value", unit: Unit = NONE) -> Cell:
        """Return a statistic of a figure as a table cell."""
        return Cell.number(self.number(figure, name), f"figures.{self.indices[figure]}.{name}", unit)


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

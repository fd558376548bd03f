"""Detection of the columns of stamps, positions and attitudes in a text table, and of their units.

Columns that the user names have priority (`user_columns`). Otherwise a header that names columns determines them, with
or without a comment sign (`header_columns`). Without a header, they are those of the only layout that the rows fit
(`row_layouts`). If several layouts fit, or none, the error message lists them and asks the user to name the columns.
"""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.stamps.stamp_checks import check_fractions_are_padded, check_no_times_of_day
from sfr_loc_map.io.stamps.time_units import TimeUnit, UnitOrigin, inferred_time_unit
from sfr_loc_map.io.tables.checks.column_checks import (
    check_are_complete,
    check_comments_state_metres,
    check_units_are_supported,
)
from sfr_loc_map.io.tables.checks.position_checks import check_positions_are_lengths, check_titles_are_lengths
from sfr_loc_map.io.tables.checks.quaternion_order import check_order_of_quaternions
from sfr_loc_map.io.tables.columns.header_columns import columns_of_header
from sfr_loc_map.io.tables.columns.pose_columns import STAMP, PoseColumns, StatedColumns, TrajectoryFormat
from sfr_loc_map.io.tables.columns.row_layouts import columns_of_layout
from sfr_loc_map.io.tables.columns.table_head import TableHead
from sfr_loc_map.io.tables.columns.user_columns import columns_of_user, columns_text


def detect_columns(lines: Sequence[str], name: str, given: str, option: str) -> PoseColumns:
    """Return the columns of a table that begins with these lines.

    `given` are the columns that the user names, or empty; `option` names them in messages. InputError if neither a
    header nor a unique layout determines the columns, or if a check contradicts the columns or their units.
    """
    head = TableHead.of(lines, name, option)
    stated = columns_of_user(head, given) if given else _columns_of_table(head)
    check_are_complete(head, stated)
    check_units_are_supported(head, stated)
    columns = PoseColumns(stated, _time_unit(head, stated), len(head.before))
    check_comments_state_metres(head, columns)
    if not given:
        check_order_of_quaternions(head, columns)
        check_positions_are_lengths(head, stated)
    return columns


def _columns_of_table(head: TableHead) -> StatedColumns:
    """Return the columns that the table itself states: by its header, or by its layout."""
    named = columns_of_header(head)
    if named is not None:
        return named
    check_titles_are_lengths(head)
    return columns_of_layout(head)


def _time_unit(head: TableHead, stated: StatedColumns) -> TimeUnit | None:
    """Return the unit of the column `t`, which is inferred from the stamps if it is not given; None without `t`.

    InputError if several units are possible, or if the stamps are probably not times in a unit.
    """
    if STAMP not in stated:
        return None
    column = stated.index_of[STAMP]
    texts = [cells[column] for cells in head.rows if len(cells) > column]
    check_fractions_are_padded(texts, head.name)
    check_no_times_of_day(texts, head.name)
    if unit := stated.units.get(STAMP):
        is_stated = stated.are_named and not stated.has_order_of(TrajectoryFormat.CSV)
        return TimeUnit(unit, UnitOrigin.STATED if is_stated else UnitOrigin.PRESCRIBED)
    is_seconds = stated.has_order_of(TrajectoryFormat.TUM)
    unit = inferred_time_unit(texts, is_seconds=is_seconds)
    if not unit:
        raise InputError(
            f"{head.name}: the unit of the stamps {', '.join(texts[:3])} is ambiguous: replace UNIT by s, ms, us or "
            f"ns in {head.option_with(columns_text(stated.index_of, {**stated.units, STAMP: 'UNIT'}))}"
        )
    is_prescribed = is_seconds and unit == "s"
    return TimeUnit(unit, UnitOrigin.PRESCRIBED if is_prescribed else UnitOrigin.INFERRED)

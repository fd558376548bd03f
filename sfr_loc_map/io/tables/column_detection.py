"""Detection of the columns of stamps, positions and attitudes in a text table, and of their units.

Columns that the user names have priority (`user_columns`). Otherwise a header that names columns determines them, with
or without a comment sign (`header_columns`). Without a header, they are those of the only layout that the rows fit
(`row_layouts`). If several layouts fit, or none, the error message lists them and asks the user to name the columns.
The detected columns must be complete and have supported units, and the numbers in them must be possible.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.stamps.stamp_checks import check_fractions_are_padded, check_no_times_of_day
from sfr_loc_map.io.stamps.stamp_text import TIMES, UTC_UNIT
from sfr_loc_map.io.stamps.time_units import UnitOrigin, inferred_time_unit
from sfr_loc_map.io.tables.header_columns import columns_of_header, unknown_header, without_names
from sfr_loc_map.io.tables.length_units import METRES, unit_in_comment
from sfr_loc_map.io.tables.motion_checks import (
    check_order_of_quaternions,
    check_positions_are_lengths,
    check_titles_are_lengths,
)
from sfr_loc_map.io.tables.pose_columns import (
    DOWN,
    FRAME,
    MATRIX,
    NANOSECONDS,
    POSITION,
    QUATERNION,
    SECONDS,
    STAMP,
    PoseColumns,
    TrajectoryFormat,
)
from sfr_loc_map.io.tables.row_layouts import columns_of_layout
from sfr_loc_map.io.tables.table_head import TableHead
from sfr_loc_map.io.tables.titles import named_positions
from sfr_loc_map.io.tables.user_columns import columns_of_user, columns_text
from sfr_loc_map.message_stamps import NS_PER_S

REQUIRED = ((STAMP, SECONDS, FRAME), ("x",), ("y",), ("z", DOWN))
"""Columns of a stamped position, as groups of alternatives; one column of each group is required."""


def detect_columns(lines: Sequence[str], name: str, given: str, option: str) -> PoseColumns:
    """Return the columns of a table that begins with these lines.

    `given` are the columns that the user names, or empty; `option` names them in messages. InputError if neither a
    header nor a unique layout determines the columns, or if a check contradicts the columns or their units.
    """
    head = TableHead.of(lines, name, option)
    columns = columns_of_user(head, given) if given else _columns_of_table(head)
    _check_are_complete(head, columns)
    _check_units_are_supported(head, columns)
    columns = _with_unit_of_stamps(head, columns)
    _check_comments_state_metres(head, columns)
    if not given:
        check_order_of_quaternions(head, columns)
        check_positions_are_lengths(head, columns)
    return columns


def _columns_of_table(head: TableHead) -> PoseColumns:
    """Return the columns that the table itself states: by its header, or by its layout."""
    named = columns_of_header(head)
    if named is not None:
        return named
    check_titles_are_lengths(head)
    return columns_of_layout(head)


def _with_unit_of_stamps(head: TableHead, columns: PoseColumns) -> PoseColumns:
    """Return the columns with the unit of the column `t`, which is inferred from the stamps unless it is stated.

    InputError if several units are possible, or if the stamps are probably not times in a unit.
    """
    if STAMP not in columns:
        return columns
    column = columns.index_of[STAMP]
    texts = [cells[column] for cells in head.rows if len(cells) > column]
    check_fractions_are_padded(texts, head.name)
    check_no_times_of_day(texts, head.name)
    if STAMP in columns.units:
        is_stated = columns.are_named and not columns.has_order_of(TrajectoryFormat.CSV)
        return replace(columns, unit_origin=UnitOrigin.STATED if is_stated else UnitOrigin.PRESCRIBED)
    is_seconds = columns.has_order_of(TrajectoryFormat.TUM)
    unit = inferred_time_unit(texts, is_seconds=is_seconds)
    if not unit:
        raise InputError(
            f"{head.name}: the unit of the stamps {', '.join(texts[:3])} is ambiguous:",
            f"replace UNIT by s, ms, us or "
            f"ns in {head.option_with(columns_text(columns.index_of, {**columns.units, STAMP: 'UNIT'}))}",
        )
    origin = UnitOrigin.PRESCRIBED if is_seconds and unit == "s" else UnitOrigin.INFERRED
    return replace(columns, units={**columns.units, STAMP: unit}, unit_origin=origin)


# ---- checks of the columns


def _check_are_complete(head: TableHead, columns: PoseColumns) -> None:
    """Raise InputError if a column of `REQUIRED`, or a part of a matrix or of a quaternion, is missing."""
    for parts, complete, of_what in (
        (MATRIX, MATRIX, "a matrix"),
        (QUATERNION, ("x", "y", "z", *QUATERNION), "a quaternion"),
    ):
        named = [key for key in parts if key in columns]
        if 0 < len(named) < len(parts):
            raise InputError(
                f"{head.name} has only the columns {', '.join(named)} of {of_what}: either {', '.join(complete)}, or "
                f"only x, y, z are required;",
                head.named_by_number(complete),
            )
    missing = [] if columns.is_matrix else [keys[0] for keys in REQUIRED if not any(key in columns for key in keys)]
    if missing:
        raise without_names(head, unknown_header(head) or 0, f"{', '.join(missing)} not found")


def _check_units_are_supported(head: TableHead, columns: PoseColumns) -> None:
    """Raise InputError if a unit is not supported, or if only some components of the position have a unit."""
    scaled = [key for key in columns.position_keys if METRES.get(columns.units.get(key, ""), 1.0) != 1.0]
    without_unit = [key for key in columns.position_keys if key in columns and not columns.units.get(key)]
    if scaled and without_unit:
        raise InputError(
            f"{head.name}: {scaled[0]} is in {columns.units[scaled[0]]}, but {without_unit[0]} has no unit:",
            f"add this unit to the header, or {head.named_by('t=...,x=...[mm],y=...[mm],z=...[mm]')}",
        )
    fractions = [unit for unit, unit_ns in TIMES.items() if unit_ns < NS_PER_S]
    supported = {STAMP: (*TIMES, UTC_UNIT, ""), NANOSECONDS: (*fractions, "")}
    supported[SECONDS] = ("s", "") if NANOSECONDS in columns else supported[STAMP]
    supported |= dict.fromkeys((*POSITION, DOWN), tuple(METRES))
    for key, unit in columns.units.items():
        if key in supported and unit not in supported[key]:
            units = ", ".join(unit for unit in supported[key] if unit)
            raise InputError(
                f"{head.name}: the unit of {key} is '{unit[:20]}', which is not supported:",
                f"convert the column to one of {units}",
            )


def _check_comments_state_metres(head: TableHead, columns: PoseColumns) -> None:
    """Raise InputError if a line before the rows states a unit of lengths, and the columns have no unit."""
    if any(columns.units.get(key) for key in columns.position_keys):
        return
    units = ((number, unit_in_comment(_without_other_units(line, head))) for number, line in enumerate(head.before, 1))
    number, unit = next(((number, unit) for number, unit in units if unit), (0, ""))
    if not unit:
        return
    advice = "convert the positions to metres"
    if not columns.is_matrix and unit in METRES:
        with_unit = {**columns.units, **dict.fromkeys(columns.position_keys, unit)}
        advice = head.named_by(columns_text(columns.index_of, with_unit))
    raise InputError(
        f"{head.name} line {number} states the unit {unit}, but the columns of the position have no unit:", advice
    )


def _without_other_units(line: str, head: TableHead) -> str:
    """If the titles of a line name a position, return the line without the units in brackets of other columns.

    A cell that is only a unit in brackets belongs to the title before it.
    """
    cells = head.cells_of(line)
    positions = named_positions(cells)
    if not positions:
        return line
    of_position = {index for position in positions for index in position.values()}
    of_position |= {index + 1 for index in of_position if "".join(cells[index + 1 : index + 2]).startswith(("[", "("))}
    titles = (
        cell if index in of_position else re.sub(r"\[[^\]]*\]|\([^)]*\)", "", cell) for index, cell in enumerate(cells)
    )
    return ", ".join(titles)

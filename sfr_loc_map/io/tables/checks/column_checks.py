"""Checks that the columns of a table are complete and have supported units."""

from __future__ import annotations

import re

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.stamps.stamp_text import TIMES, UTC_UNIT
from sfr_loc_map.io.tables.columns.header_columns import unknown_header, without_names
from sfr_loc_map.io.tables.columns.length_units import METRES, unit_in_comment
from sfr_loc_map.io.tables.columns.pose_columns import (
    DOWN,
    FRAME,
    MATRIX,
    NANOSECONDS,
    POSITION,
    QUATERNION,
    SECONDS,
    STAMP,
    PoseColumns,
    StatedColumns,
)
from sfr_loc_map.io.tables.columns.table_head import TableHead
from sfr_loc_map.io.tables.columns.titles import named_positions
from sfr_loc_map.io.tables.columns.user_columns import columns_text
from sfr_loc_map.message_stamps import NS_PER_S

REQUIRED = ((STAMP, SECONDS, FRAME), ("x",), ("y",), ("z", DOWN))
"""Columns of a stamped position, as groups of alternatives; one column of each group is required."""


def check_are_complete(head: TableHead, stated: StatedColumns) -> None:
    """Raise InputError if a column of `REQUIRED`, or a part of a matrix or of a quaternion, is missing."""
    for parts, complete, of_what in (
        (MATRIX, MATRIX, "a matrix"),
        (QUATERNION, ("x", "y", "z", *QUATERNION), "a quaternion"),
    ):
        named = [key for key in parts if key in stated]
        if 0 < len(named) < len(parts):
            raise InputError(
                f"{head.name} has only the columns {', '.join(named)} of {of_what}: either {', '.join(complete)}, or "
                f"only x, y, z are required; {head.named_by_number(complete)}"
            )
    missing = [] if stated.is_matrix else [keys[0] for keys in REQUIRED if not any(key in stated for key in keys)]
    if missing:
        raise without_names(head, unknown_header(head) or 0, f"{', '.join(missing)} not found")


def check_units_are_supported(head: TableHead, stated: StatedColumns) -> None:
    """Raise InputError if a unit is not supported, or if only some components of the position have a unit."""
    scaled = [key for key in stated.position_keys if METRES.get(stated.units.get(key, ""), 1.0) != 1.0]
    without_unit = [key for key in stated.position_keys if key in stated and not stated.units.get(key)]
    if scaled and without_unit:
        raise InputError(
            f"{head.name}: {scaled[0]} is in {stated.units[scaled[0]]}, but {without_unit[0]} has no unit: add this "
            f"unit to the header, or {head.named_by('t=...,x=...[mm],y=...[mm],z=...[mm]')}"
        )
    fractions = [unit for unit, unit_ns in TIMES.items() if unit_ns < NS_PER_S]
    supported = {STAMP: (*TIMES, UTC_UNIT, ""), NANOSECONDS: (*fractions, "")}
    supported[SECONDS] = ("s", "") if NANOSECONDS in stated else supported[STAMP]
    supported |= dict.fromkeys((*POSITION, DOWN), tuple(METRES))
    for key, unit in stated.units.items():
        if key in supported and unit not in supported[key]:
            units = ", ".join(unit for unit in supported[key] if unit)
            raise InputError(
                f"{head.name}: the unit of {key} is '{unit[:20]}', which is not supported: convert the column to "
                f"one of {units}"
            )


def check_comments_state_metres(head: TableHead, columns: PoseColumns) -> None:
    """Raise InputError if a line before the rows states a unit of lengths, and the columns have no unit."""
    stated = columns.stated
    if any(stated.units.get(key) for key in stated.position_keys):
        return
    units = ((number, unit_in_comment(_without_other_units(line, head))) for number, line in enumerate(head.before, 1))
    number, unit = next(((number, unit) for number, unit in units if unit), (0, ""))
    if not unit:
        return
    advice = "convert the positions to metres"
    if not stated.is_matrix and unit in METRES:
        with_unit = {**columns.units, **dict.fromkeys(stated.position_keys, unit)}
        advice = head.named_by(columns_text(stated.index_of, with_unit))
    raise InputError(
        f"{head.name} line {number} states the unit {unit}, but the columns of the position have no unit: {advice}"
    )


def _without_other_units(line: str, head: TableHead) -> str:
    """Return a line without the units in brackets of other columns if its titles name a position.

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

"""Detection of the columns of stamps, positions and attitudes in a text table, and of their units.

Columns that the user names have priority (`column_names`). Otherwise a header that names columns determines them, with
or without a comment sign. Without a header, they are those of the only layout that the rows fit (`row_layouts`). If
several layouts fit, or none, the error message lists them and asks the user to name the columns.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.tables.column_names import (
    check_is_not_geographic,
    columns_by_number,
    columns_of_header,
    columns_of_user,
    named_positions,
    unknown_header,
    without_names,
)
from sfr_loc_map.io.tables.length_units import METRES, unit_in_comment
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
from sfr_loc_map.io.tables.quaternion_order import check_order_of_quaternions
from sfr_loc_map.io.tables.row_layouts import check_height_is_no_heading, columns_of_layout
from sfr_loc_map.io.tables.stamps import TIMES, UTC_UNIT, check_is_no_time_of_day, check_padded, time_unit
from sfr_loc_map.io.tables.table_head import TableHead, is_number, is_time
from sfr_loc_map.message_stamps import NS_PER_S

REQUIRED = ((STAMP, SECONDS, FRAME), ("x",), ("y",), ("z", DOWN))
"""Columns of a stamped position, as groups of alternatives; one column of each group is required."""


def detect_columns(lines: Sequence[str], name: str, columns: str, option: str) -> PoseColumns:
    """Return the columns of a table that begins with these lines.

    `columns` is given by the user and may be empty; `option` names it in messages. InputError if neither a header nor
    a unique layout determines the columns.
    """
    head = TableHead.of(lines, name, option)
    found = columns_of_user(head, columns) if columns else columns_of_header(head)
    if found is None:
        check_is_not_geographic(head.before, name)
        found = columns_of_layout(head)
    if not columns:
        check_order_of_quaternions(head, found)
        check_height_is_no_heading(head, found)
    _check_complete(found, head)
    _check_units(found, head)
    found = _with_time_unit(found, head)
    _check_commented_unit(found, head)
    return replace(found, skip=len(head.before))


def _check_complete(found: PoseColumns, head: TableHead) -> None:
    """Raise InputError if a column of `REQUIRED`, or a part of a matrix or of a quaternion, is missing."""
    for parts, complete, of_what in (
        (MATRIX, MATRIX, "a matrix"),
        (QUATERNION, ("x", "y", "z", *QUATERNION), "a quaternion"),
    ):
        named = [key for key in parts if key in found]
        if 0 < len(named) < len(parts):
            raise InputError(
                f"{head.name} has only the columns {', '.join(named)} of {of_what}: either {', '.join(complete)}, or "
                f"only x, y, z are required; {head.named_by_number(complete)}"
            )
    missing = [] if found.is_matrix else [keys[0] for keys in REQUIRED if not any(key in found for key in keys)]
    if missing:
        raise without_names(head, unknown_header(head.before) or 0, f"{', '.join(missing)} not found")


def _check_units(found: PoseColumns, head: TableHead) -> None:
    """Raise InputError if a unit is not supported, or if only some components of the position have a unit."""
    scaled = [key for key in found.position_keys if METRES.get(found.units.get(key, ""), 1.0) != 1.0]
    without_unit = [key for key in found.position_keys if key in found and not found.units.get(key)]
    if scaled and without_unit:
        raise InputError(
            f"{head.name}: {scaled[0]} is in {found.units[scaled[0]]}, but {without_unit[0]} has no unit: add this "
            f"unit to the header, or {head.named_by('t=...,x=...[mm],y=...[mm],z=...[mm]')}"
        )
    fractions = [unit for unit, unit_ns in TIMES.items() if unit_ns < NS_PER_S]
    known = {STAMP: (*TIMES, UTC_UNIT, ""), NANOSECONDS: (*fractions, "")}
    known[SECONDS] = ("s", "") if NANOSECONDS in found else known[STAMP]
    known |= dict.fromkeys((*POSITION, DOWN), tuple(METRES))
    for key, unit in found.units.items():
        if key in known and unit not in known[key]:
            units = ", ".join(unit for unit in known[key] if unit)
            raise InputError(
                f"{head.name}: the unit of {key} is '{unit[:20]}', which is not supported: convert the column to "
                f"one of {units}"
            )


def _check_commented_unit(found: PoseColumns, head: TableHead) -> None:
    """Raise InputError if a line before the rows states a unit of lengths, and the columns have no unit."""
    if any(found.units.get(key) for key in found.position_keys):
        return
    stated = (
        (number, unit_in_comment(_without_units_of_titles(line, head))) for number, line in enumerate(head.before, 1)
    )
    number, unit = next(((number, unit) for number, unit in stated if unit), (0, ""))
    if not unit:
        return
    advice = "convert the positions to metres"
    if not found.is_matrix and unit in METRES:
        units = {**found.units, **dict.fromkeys(found.position_keys, unit)}
        advice = head.named_by(columns_by_number(found.index_of, units))
    raise InputError(
        f"{head.name} line {number} states the unit {unit}, but the columns of the position have no unit: {advice}"
    )


def _without_units_of_titles(line: str, head: TableHead) -> str:
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


def _with_time_unit(found: PoseColumns, head: TableHead) -> PoseColumns:
    """Return the columns with the unit of the stamps, which is inferred from their magnitude if it is not given."""
    if STAMP not in found:
        return found
    column = found.index_of[STAMP]
    texts = [cells[column] for cells in head.rows if len(cells) > column]
    check_padded(texts, head.name)
    check_is_no_time_of_day(texts, head.name)
    if found.units.get(STAMP):
        return replace(found, states_time_unit=found.by_header and found.format is not TrajectoryFormat.CSV)
    if texts and not is_number(texts[0]) and is_time(texts[0]):
        return replace(found, units={**found.units, STAMP: UTC_UNIT}, inferred=UTC_UNIT)
    is_seconds = found.format is TrajectoryFormat.TUM
    unit = time_unit(texts, is_seconds=is_seconds)
    if not unit:
        raise InputError(
            f"{head.name}: the unit of the stamps {', '.join(texts[:3])} is ambiguous: replace UNIT by s, ms, us or "
            f"ns in {head.option_with(columns_by_number(found.index_of, {**found.units, STAMP: 'UNIT'}))}"
        )
    return replace(found, units={**found.units, STAMP: unit}, inferred="" if unit == "s" and is_seconds else unit)

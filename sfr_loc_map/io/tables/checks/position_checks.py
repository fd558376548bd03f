"""Checks that the columns of a position are lengths: neither latitude and longitude, nor a heading as height."""

from __future__ import annotations

import re

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import plausible_positions
from sfr_loc_map.io.tables.checks.vehicle_motion import are_degrees, unit_of_headings
from sfr_loc_map.io.tables.columns.pose_columns import POSITION, STAMP, StatedColumns
from sfr_loc_map.io.tables.columns.table_head import TableHead, header_cells, separator_in
from sfr_loc_map.io.tables.columns.titles import split_unit

_DEGREES = ({"lat", "latitude"}, {"lon", "long", "lng", "longitude"})
"""Names of the two columns of a geographic position, in lower case."""


def check_titles_are_lengths(head: TableHead) -> None:
    """Raise InputError if a line before the rows names latitude and longitude, because these are not lengths."""
    for number, line in enumerate(head.before, 1):
        titles = {re.sub(r"[^a-z]", "", split_unit(cell)[0].lower()) for cell in header_cells(line, separator_in(line))}
        if all(titles & names for names in _DEGREES):
            raise InputError(
                f"{head.name} line {number} names latitude and longitude: positions in metres are required; convert "
                "them to columns east, north and height"
            )


def check_positions_are_lengths(head: TableHead, stated: StatedColumns) -> None:
    """Raise InputError if the position of `t x y z` is probably latitude and longitude, or has a heading as height."""
    if STAMP not in stated or stated.value_keys != POSITION:
        return
    columns = [stated.index_of[key] for key in (STAMP, *POSITION)]
    rows = _stamped_positions(head.numbers(max(columns) + 1)[:, columns])
    if not stated.are_named and are_degrees(rows[:, 1:3]):
        raise InputError(
            f"{head.name} has four columns and no header, and the second and the third are probably latitude and "
            "longitude in degrees: positions in metres are required; convert them, or "
            f"{head.named_by(f't[{head.time_unit}],x,y,z')}"
        )
    column = columns[-1]
    unit = unit_of_headings(rows[:, 1:3], rows[:, 3]) if _may_be_heading(head, stated, column) else ""
    if unit:
        raise InputError(
            f"{head.name}: column #{column + 1} is the heading of the path in {unit}, not a height: a position "
            f"with a height is required; add a column of heights, and {head.named_by_number()}"
        )


def _may_be_heading(head: TableHead, stated: StatedColumns, column: int) -> bool:
    """Return whether the column of z has no title, or the title `h`, which may be that of a heading."""
    titles = [cells[column].lower() for line in head.before if len(cells := head.cells_of(line)) > column]
    return not stated.are_named or "h" in titles


def _stamped_positions(rows: FloatArray) -> FloatArray:
    """Return the rows t, x, y, z `(N, 4)` that are positions, in the order of their stamps."""
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[plausible_positions(rows[:, 1:])]
    return rows[np.argsort(rows[:, 0], kind="stable")]

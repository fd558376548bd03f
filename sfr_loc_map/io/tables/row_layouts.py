"""Columns of a table without a header: the only one of `LAYOUTS` that its rows fit.

Rows fit a layout by their number of columns, unit quaternions, orthonormal rotations and increasing stamps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.plausibility import plausible_attitudes, plausible_positions, plausible_rotations
from sfr_loc_map.io.tables.column_names import unknown_header, without_names
from sfr_loc_map.io.tables.pose_columns import (
    FRAME,
    LAST_ROW,
    MATRIX,
    NANOSECONDS,
    POSITION,
    QUATERNION,
    SCALAR_FIRST,
    SECONDS,
    STAMP,
    PoseColumns,
)
from sfr_loc_map.io.tables.table_head import TableHead
from sfr_loc_map.io.tables.vehicle_motion import are_degrees, unit_of_headings
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import alternatives


@dataclass(frozen=True, slots=True)
class Layout:
    """A layout of lines without a header."""

    name: str  #: Name in messages.
    keys: tuple[str, ...]  #: Content of the first columns.
    separator: str = ""  #: Required separator: "," (or semicolon), " " (or tab); empty: any.
    widths: tuple[int, ...] = ()  #: Allowed numbers of columns; empty: at least the number of keys.
    unit: str = ""  #: Unit of the stamps; empty: inferred from their magnitude.


_POSE = (*POSITION, *QUATERNION)
_POSE_SCALAR_FIRST = (*POSITION, *SCALAR_FIRST)
_BY_COLUMNS = tuple(f"m{row}{column}" for column in (1, 2, 3, 4) for row in (1, 2, 3))
_BY_COLUMNS_4 = tuple(f"m{row}{column}" for column in (1, 2, 3, 4) for row in (1, 2, 3, 4))
LAYOUTS = (
    Layout("TUM (t x y z qx qy qz qw)", (STAMP, *_POSE), " "),
    Layout("TUM with commas (t,x,y,z,qx,qy,qz,qw)", (STAMP, *_POSE), ",", (8,)),
    Layout("EuRoC (t,x,y,z,qw,qx,qy,qz)", (STAMP, *_POSE_SCALAR_FIRST), ",", (8,), "ns"),
    Layout("EuRoC (t,x,y,z,qw,qx,qy,qz, velocity, biases)", (STAMP, *_POSE_SCALAR_FIRST), ",", (11, 17), "ns"),
    Layout("sec nsec x y z qx qy qz qw", (SECONDS, NANOSECONDS, *_POSE), "", (9,)),
    Layout("KITTI (3 x 4 matrix)", MATRIX, "", (12,)),
    Layout("KITTI-360 (frame and 3 x 4 matrix)", (FRAME, *MATRIX), "", (13,)),
    Layout("KITTI-360 (frame and 4 x 4 matrix)", (FRAME, *MATRIX, *LAST_ROW), "", (17,)),
    Layout("MulRan (t and 3 x 4 matrix)", (STAMP, *MATRIX), "", (13,)),
    Layout("t and 4 x 4 matrix", (STAMP, *MATRIX, *LAST_ROW), "", (17,)),
    Layout("t and 3 x 4 matrix, column by column", (STAMP, *_BY_COLUMNS), "", (13,)),
    Layout("t and 4 x 4 matrix, column by column", (STAMP, *_BY_COLUMNS_4), "", (17,)),
    Layout("t x y z", (STAMP, *POSITION), "", (4,)),
)
"""All supported layouts without a header; docs/formats.md contains the same table."""
MAX_FRAME = 1e7  #: Integers below are frame numbers; larger integers are stamps.
FIT = 0.9  #: Minimum fraction of rows that must fit a layout; the others are invalid rows.
HALF_FIT = 0.5  #: Minimum fraction if no layout reaches `FIT`, so that error messages can name the invalid rows.


def columns_of_layout(head: TableHead) -> PoseColumns:
    """Return the columns of the only layout that the rows fit; InputError if no layout or several layouts fit."""
    header = unknown_header(head.before)
    if header is not None:
        raise without_names(head, header)
    rows = head.rows
    has_empty_end = all(len(cells) > 1 and not cells[-1] for cells in rows)  # a separator after the last number
    widths = sorted(len(cells) - has_empty_end for cells in rows)
    width = widths[len(widths) // 2]
    table = head.numbers(width)
    layout = _only_layout(head, table)
    _check_are_no_degrees(head, layout, table)
    index_of = {key: index for index, key in enumerate(layout.keys)}
    ignored = tuple(f"#{number + 1}" for number in range(len(layout.keys), width))
    units = {STAMP: layout.unit} if layout.unit and STAMP in index_of else {}
    return PoseColumns(layout.name, head.separator, index_of, units, width + has_empty_end, ignored=ignored)


def _only_layout(head: TableHead, table: FloatArray) -> Layout:
    """Return the only layout that the numbers in the rows `(N, K)` fit; InputError if no layout or several fit."""
    separator = "," if head.separator in (",", ";") else " "
    fraction = {layout: _fit(layout, table, separator) for layout in LAYOUTS}
    fitting = [layout for layout in LAYOUTS if fraction[layout] >= FIT]
    fitting = fitting or [layout for layout in LAYOUTS if fraction[layout] >= HALF_FIT]
    if len(fitting) > 1:  # rows of matrices near the identity look like unit quaternions
        fitting = [layout for layout in fitting if MATRIX[0] in layout.keys] or fitting
    if len(fitting) == 1:
        return fitting[0]
    problem = f", and fits no layout of: {'; '.join(layout.name for layout in LAYOUTS)}"
    stamp = f"t[{head.time_unit}]"
    columns = f"{stamp},x,y,z" if table.shape[1] < len(_POSE) + 1 else ",".join((stamp, *_POSE))
    advice = head.named_by(columns)
    if table.shape[1] <= len(POSITION):
        advice = "a stamp and three coordinates are required in each row"
    if fitting:
        problem = f"; possible layouts are {alternatives(layout.name for layout in fitting)}"
        columns_of = (f"{layout.keys[0]}[UNIT],{','.join(layout.keys[1:])}" for layout in fitting)
        advice = f"name the columns: {alternatives(map(head.option_with, columns_of))}"
    raise InputError(
        f"{head.name} has {table.shape[1]} columns and no header{problem} (line {len(head.before) + 1}: "
        f"'{head.first_row[:60]}'): {advice}"
    )


def _fit(layout: Layout, table: FloatArray, separator: str) -> float:
    """Return the fraction of rows `(N, K)` that fit a layout; `separator`: "," or " "."""
    keys, width = layout.keys, table.shape[1]
    if (layout.separator and layout.separator != separator) or width < len(keys):
        return 0.0
    if layout.widths and width not in layout.widths:
        return 0.0
    rows = table[np.isfinite(table[:, : len(keys)]).all(axis=1)]
    if not len(rows) or (keys[0] == STAMP and not _are_stamps(layout, rows[:, 0], width)):
        return 0.0
    return float(_fitting_rows(keys, rows).mean())


def _are_stamps(layout: Layout, stamps: FloatArray, width: int) -> bool:
    """Return whether the first column `(N,)` can be the stamps of a layout that begins with stamps."""
    are_integers = bool(_is_integer(stamps).all())
    if layout.unit == "ns" and not are_integers:
        return False
    if MATRIX[0] in layout.keys and are_integers and float(stamps.max()) < MAX_FRAME:  # numbers of frames
        return False
    steps = np.diff(stamps)
    increasing, decreasing = (float(np.mean(steps * sign >= 0.0)) if len(steps) else 1.0 for sign in (1.0, -1.0))
    if layout.keys == (STAMP, *POSITION) and max(increasing, decreasing) < FIT:  # such as the rows of a 4 x 4 matrix
        return False
    has_extra_columns = width > len(layout.keys)  # the first columns of a matrix look like a stamp and a quaternion
    return not has_extra_columns or bool(len(steps) and np.mean(steps > 0.0) >= FIT)


def _fitting_rows(keys: Sequence[str], rows: FloatArray) -> Mask:
    """Return which rows `(N, K)` have a valid attitude, fraction of a second and frame number, if a layout has them."""
    index_of = {key: index for index, key in enumerate(keys)}
    fitting = np.ones(len(rows), np.bool_)
    if "qw" in index_of:
        fitting &= plausible_attitudes(rows[:, [index_of[key] for key in QUATERNION]])
    if MATRIX[0] in index_of:
        matrices = rows[:, [index_of[key] for key in MATRIX]].reshape(-1, 3, 4)
        fitting &= plausible_rotations(matrices[:, :, :3])
    if LAST_ROW[0] in index_of:
        fitting &= (rows[:, [index_of[key] for key in LAST_ROW]] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    if NANOSECONDS in index_of:
        fraction = rows[:, index_of[NANOSECONDS]]
        fitting &= (fraction >= 0.0) & (fraction < NS_PER_S) & _is_integer(fraction) & _is_integer(rows[:, 0])
    if FRAME in index_of:
        frames = rows[:, index_of[FRAME]]
        fitting &= _is_integer(frames) & (frames >= 0.0) & (frames < MAX_FRAME)
    return fitting


def _is_integer(numbers: FloatArray) -> Mask:
    return np.asarray(numbers == np.floor(numbers))


# ---- four numbers that are not a position


def check_height_is_no_heading(head: TableHead, found: PoseColumns) -> None:
    """Raise InputError if the height of `t x y z` is the heading of a planar pose, in radians or degrees.

    The height has no name, or the name `h`, which may be that of a heading.
    """
    keys = (STAMP, *POSITION)
    if tuple(found.value_keys) != POSITION or not set(keys) <= found.index_of.keys():
        return
    indices = [found.index_of[key] for key in keys]
    titles = [cells[indices[3]] for line in head.before if len(cells := head.cells_of(line)) > indices[3]]
    if found.by_header and "h" not in map(str.lower, titles):
        return
    rows = _stamped_positions(head.numbers(max(indices) + 1)[:, indices])
    if unit := unit_of_headings(rows[:, 1:3], rows[:, 3]):
        raise InputError(
            f"{head.name}: column #{indices[3] + 1} is the heading of the path in {unit}, not a height: a position "
            f"with a height is required; add a column of heights, and {head.named_by_number()}"
        )


def _check_are_no_degrees(head: TableHead, layout: Layout, table: FloatArray) -> None:
    """Raise InputError if the positions of `t x y z` are latitude and longitude, deg."""
    if layout.keys == (STAMP, *POSITION) and are_degrees(_stamped_positions(table)[:, 1:3]):
        raise InputError(
            f"{head.name} has four columns and no header, and the second and the third are probably latitude and "
            "longitude in degrees: positions in metres are required; convert them, or "
            f"{head.named_by(f't[{head.time_unit}],x,y,z')}"
        )


def _stamped_positions(table: FloatArray) -> FloatArray:
    """Return the rows t, x, y, z `(N, 4)` of a table that are positions, in the order of their stamps."""
    rows = table[np.isfinite(table[:, :4]).all(axis=1), :4]
    rows = rows[plausible_positions(rows[:, 1:])]
    return rows[np.argsort(rows[:, 0], kind="stable")]

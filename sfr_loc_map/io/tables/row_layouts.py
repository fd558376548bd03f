"""Columns of a table without a header: the only one of `LAYOUTS` that its rows fit.

Rows fit a layout by their number of columns, unit quaternions, orthonormal rotations and increasing stamps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.plausibility import plausible_attitudes, plausible_rotations
from sfr_loc_map.inputs import MAX_INVALID
from sfr_loc_map.io.tables.header_columns import unknown_header, without_names
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
from sfr_loc_map.io.tables.user_columns import columns_text
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import alternatives


@dataclass(frozen=True, slots=True)
class RowLayout:
    """A layout of lines without a header."""

    name: str  #: Name in messages.
    keys: tuple[str, ...]  #: Content of the first columns.
    separator: str = ""  #: Required separator: "," (or semicolon), " " (or tab); empty: any.
    widths: tuple[int, ...] = ()  #: Allowed numbers of columns; empty: at least the number of keys.
    unit: str = ""  #: Unit of the stamps; empty: inferred from their magnitude.

    @property
    def index_of(self) -> dict[str, int]:
        """The column of each key, from 0."""
        return {key: index for index, key in enumerate(self.keys)}


_POSE = (*POSITION, *QUATERNION)
_POSE_SCALAR_FIRST = (*POSITION, *SCALAR_FIRST)
_BY_COLUMNS = tuple(f"m{row}{column}" for column in (1, 2, 3, 4) for row in (1, 2, 3))
_BY_COLUMNS_4 = tuple(f"m{row}{column}" for column in (1, 2, 3, 4) for row in (1, 2, 3, 4))
LAYOUTS = (
    RowLayout("TUM (t x y z qx qy qz qw)", (STAMP, *_POSE), " "),
    RowLayout("TUM with commas (t,x,y,z,qx,qy,qz,qw)", (STAMP, *_POSE), ",", (8,)),
    RowLayout("EuRoC (t,x,y,z,qw,qx,qy,qz)", (STAMP, *_POSE_SCALAR_FIRST), ",", (8,), "ns"),
    RowLayout("EuRoC (t,x,y,z,qw,qx,qy,qz, velocity, biases)", (STAMP, *_POSE_SCALAR_FIRST), ",", (11, 17), "ns"),
    RowLayout("sec nsec x y z qx qy qz qw", (SECONDS, NANOSECONDS, *_POSE), "", (9,)),
    RowLayout("KITTI (3 x 4 matrix)", MATRIX, "", (12,)),
    RowLayout("KITTI-360 (frame and 3 x 4 matrix)", (FRAME, *MATRIX), "", (13,)),
    RowLayout("KITTI-360 (frame and 4 x 4 matrix)", (FRAME, *MATRIX, *LAST_ROW), "", (17,)),
    RowLayout("MulRan (t and 3 x 4 matrix)", (STAMP, *MATRIX), "", (13,)),
    RowLayout("t and 4 x 4 matrix", (STAMP, *MATRIX, *LAST_ROW), "", (17,)),
    RowLayout("t and 3 x 4 matrix, column by column", (STAMP, *_BY_COLUMNS), "", (13,)),
    RowLayout("t and 4 x 4 matrix, column by column", (STAMP, *_BY_COLUMNS_4), "", (17,)),
    RowLayout("t x y z", (STAMP, *POSITION), "", (4,)),
)
"""All supported layouts without a header; docs/formats.md contains the same table."""
SMALLEST_STAMP = 1e7  #: Smaller integers are frame numbers, without a unit.
FIT = 1.0 - MAX_INVALID  #: Minimum fraction of rows that must fit a layout; the others are invalid rows.
HALF_FIT = 0.5  #: Minimum fraction if no layout reaches `FIT`, so that error messages can name the invalid rows.


def columns_of_layout(head: TableHead) -> PoseColumns:
    """Return the columns of the only layout that the rows fit; InputError if no layout or several layouts fit."""
    header = unknown_header(head)
    if header is not None:
        raise without_names(head, header)
    rows = head.rows
    has_empty_end = all(len(cells) > 1 and not cells[-1] for cells in rows)  # a separator after the last number
    widths = sorted(len(cells) - has_empty_end for cells in rows)
    width = widths[len(widths) // 2]
    table = head.numbers(width)
    layout = _only_layout(head, table)
    return PoseColumns(
        layout.name,
        head.separator,
        len(head.before),
        width + has_empty_end,
        layout.index_of,
        {STAMP: layout.unit} if layout.unit else {},
        are_named=False,
        ignored=tuple(f"#{number + 1}" for number in range(len(layout.keys), width)),
    )


def _only_layout(head: TableHead, table: FloatArray) -> RowLayout:
    """Return the only layout that the numbers in the rows `(N, K)` fit; InputError if no layout or several fit."""
    separator = "," if head.separator in (",", ";") else " "
    fraction = {layout: _fit(layout, table, separator) for layout in LAYOUTS}
    fitting = [layout for layout in LAYOUTS if fraction[layout] >= FIT]
    fitting = fitting or [layout for layout in LAYOUTS if fraction[layout] >= HALF_FIT]
    if len(fitting) > 1:  # rows of matrices near the identity look like unit quaternions
        fitting = [layout for layout in fitting if MATRIX[0] in layout.keys] or fitting
    if len(fitting) != 1:
        raise _without_layout(head, table.shape[1], fitting)
    return fitting[0]


def _without_layout(head: TableHead, width: int, fitting: Sequence[RowLayout]) -> InputError:
    """Return the error for rows of `width` columns that fit no layout or several layouts."""
    if fitting:
        problem = f"; possible layouts are {alternatives(layout.name for layout in fitting)}"
        options = (head.option_with(columns_text(layout.index_of, {STAMP: "UNIT"})) for layout in fitting)
        advice = f"name the columns: {alternatives(options)}"
    else:
        problem = f", and fits no layout of: {'; '.join(layout.name for layout in LAYOUTS)}"
        keys = POSITION if width <= len(_POSE) else _POSE
        advice = head.named_by(",".join((f"{STAMP}[{head.time_unit}]", *keys)))
        if width <= len(POSITION):
            advice = "a stamp and three coordinates are required in each row"
    return InputError(
        f"{head.name} has {width} columns and no header{problem} (line {len(head.before) + 1}: "
        f"'{head.first_row[:60]}'):",
        advice,
    )


def _fit(layout: RowLayout, table: FloatArray, separator: str) -> float:
    """Return the fraction of rows `(N, K)` that fit a layout; `separator`: "," or " "."""
    keys, width = layout.keys, table.shape[1]
    if (layout.separator and layout.separator != separator) or width < len(keys):
        return 0.0
    if layout.widths and width not in layout.widths:
        return 0.0
    rows = table[np.isfinite(table[:, : len(keys)]).all(axis=1)]
    if not len(rows) or (keys[0] == STAMP and not _are_stamps(layout, rows[:, 0], width)):
        return 0.0
    return float(_fitting_rows(layout.index_of, rows).mean())


def _are_stamps(layout: RowLayout, stamps: FloatArray, width: int) -> bool:
    """Return whether the first column `(N,)` can be the stamps of a layout that begins with stamps."""
    are_integers = bool(_is_integer(stamps).all())
    if layout.unit == "ns" and not are_integers:
        return False
    if MATRIX[0] in layout.keys and are_integers and float(stamps.max()) < SMALLEST_STAMP:  # numbers of frames
        return False
    steps = np.diff(stamps)
    increasing, decreasing = (float(np.mean(steps * sign >= 0.0)) if len(steps) else 1.0 for sign in (1.0, -1.0))
    if layout.keys == (STAMP, *POSITION) and max(increasing, decreasing) < FIT:  # such as the rows of a 4 x 4 matrix
        return False
    has_extra_columns = width > len(layout.keys)  # the first columns of a matrix look like a stamp and a quaternion
    return not has_extra_columns or bool(len(steps) and np.mean(steps > 0.0) >= FIT)


def _fitting_rows(index_of: Mapping[str, int], rows: FloatArray) -> Mask:
    """Return which rows `(N, K)` have a valid attitude, fraction of a second and frame number, if a layout has them."""
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
        fitting &= _is_integer(frames) & (frames >= 0.0) & (frames < SMALLEST_STAMP)
    return fitting


def _is_integer(numbers: FloatArray) -> Mask:
    return np.asarray(numbers == np.floor(numbers))

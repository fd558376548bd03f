"""Checks of the order of quaternions, scalar first or last: against comments, and against the motion of the vehicle."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import plausible_attitudes, plausible_positions
from sfr_loc_map.io.tables.checks.vehicle_motion import contradicts_order, problem_of_order
from sfr_loc_map.io.tables.columns.pose_columns import (
    NANOSECONDS,
    POSITION,
    QUATERNION,
    SCALAR_FIRST,
    SECONDS,
    STAMP,
    PoseColumns,
    StatedColumns,
)
from sfr_loc_map.io.tables.columns.table_head import TableHead
from sfr_loc_map.io.tables.columns.user_columns import columns_text

_ORDERS: dict[tuple[str, ...], str] = {QUATERNION: "last", SCALAR_FIRST: "first"}
"""Place of the scalar by the order of the columns."""
_COMMENTS: dict[tuple[str, ...], re.Pattern[str]] = {
    QUATERNION: re.compile(r"\bq?_?x\W+q?_?y\W+q?_?z\W+q?_?w\b|\bxyzw\b", re.IGNORECASE),
    SCALAR_FIRST: re.compile(r"\bq?_?w\W+q?_?x\W+q?_?y\W+q?_?z\b|\bwxyz\b", re.IGNORECASE),
}
"""Patterns of comments that state an order."""


def check_order_of_quaternions(head: TableHead, columns: PoseColumns) -> None:
    """Raise InputError if a comment or the motion contradicts the order of quaternions in columns.

    Nothing is checked unless the quaternions are four consecutive columns with the scalar first or last. The column
    titles of the suite's own csv (`att_q_DsToRb_1`) number the components, so that their order is not checked either.
    """
    stated = columns.stated
    if not {*POSITION, *QUATERNION} <= stated.index_of.keys() or stated.is_conjugated:
        return
    indices = sorted(stated.index_of[key] for key in QUATERNION)
    order = tuple(sorted(QUATERNION, key=stated.index_of.__getitem__))
    if order not in _ORDERS or indices[-1] - indices[0] != len(QUATERNION) - 1:
        return
    options = {each: head.option_with(_columns_text(columns, indices[0], each)) for each in _ORDERS}
    if not stated.are_named:
        _check_comments(head, stated, order, options)
    _check_motion(head, stated, order, options)


def _columns_text(columns: PoseColumns, first: int, order: tuple[str, ...]) -> str:
    """Return the columns as the user names them, with another order of the quaternions from the column `first`."""
    quaternion = {key: first + number for number, key in enumerate(order)}
    return columns_text({**columns.stated.index_of, **quaternion}, columns.units)


def _check_comments(
    head: TableHead, stated: StatedColumns, order: tuple[str, ...], options: Mapping[tuple[str, ...], str]
) -> None:
    """Raise InputError if the last comment that states an order of quaternions contradicts the given order."""
    comments = [
        (number, other)
        for number, line in enumerate(head.before, 1)
        for other, pattern in _COMMENTS.items()
        if pattern.search(line)
    ]
    number, other = comments[-1] if comments else (0, order)
    if other != order:
        raise InputError(
            f"{head.name} line {number} states that quaternions have the scalar {_ORDERS[other]}, unlike "
            f"{stated.name}: name the columns: {options[other]}"
        )


def _check_motion(
    head: TableHead, stated: StatedColumns, order: tuple[str, ...], options: Mapping[tuple[str, ...], str]
) -> None:
    """Raise InputError if the attitudes describe a vehicle only in the other order of quaternions."""
    positions, quats = _poses(head, stated)
    to_other = [1, 2, 3, 0] if order == QUATERNION else [3, 0, 1, 2]
    others = quats[:, to_other]
    if stated.are_named:
        origin = "a header that names its columns"
        problem = "not along the path" if contradicts_order(positions, quats, others) else ""
    else:
        origin = "no header"
        problem = problem_of_order(positions, quats, others)
    if not problem:
        return
    other = next(place for each, place in _ORDERS.items() if each != order)
    raise InputError(
        f"{head.name} has {origin}, and its attitudes are {problem} if read as {stated.name}, but level and along the "
        f"path if the scalar of the quaternions is {other}: name the columns by {options[SCALAR_FIRST]} if it is "
        f"first, or by {options[QUATERNION]} if it is last"
    )


def _poses(head: TableHead, stated: StatedColumns) -> tuple[FloatArray, FloatArray]:
    """Return the valid positions `(N, 3)` and quaternions `(N, 4)` of the first rows, in the order of their stamps."""
    stamps = [key for key in (STAMP, SECONDS, NANOSECONDS) if key in stated]
    columns = [stated.index_of[key] for key in (*stamps, *POSITION, *QUATERNION)]
    rows = head.numbers(max(columns) + 1)[:, columns]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if stamps:
        rows = rows[np.lexsort([rows[:, column] for column in reversed(range(len(stamps)))])]
    positions, quats = rows[:, len(stamps) : -4], rows[:, -4:]
    is_valid = plausible_positions(positions) & plausible_attitudes(quats)
    return positions[is_valid], quats[is_valid]

"""Checks of the order of quaternions, scalar first or last: against comments, and against the motion of the vehicle."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import plausible_attitudes, plausible_positions
from sfr_loc_map.io.tables.pose_columns import (
    NANOSECONDS,
    POSITION,
    QUATERNION,
    SCALAR_FIRST,
    SECONDS,
    STAMP,
    PoseColumns,
)
from sfr_loc_map.io.tables.table_head import TableHead
from sfr_loc_map.io.tables.vehicle_motion import contradicts_order, problem_of_order

_ORDERS: dict[tuple[str, ...], str] = {QUATERNION: "last", SCALAR_FIRST: "first"}
"""Place of the scalar by the order of the columns."""
_COMMENTS: dict[tuple[str, ...], re.Pattern[str]] = {
    QUATERNION: re.compile(r"\bq?_?x\W+q?_?y\W+q?_?z\W+q?_?w\b|\bxyzw\b", re.IGNORECASE),
    SCALAR_FIRST: re.compile(r"\bq?_?w\W+q?_?x\W+q?_?y\W+q?_?z\b|\bwxyz\b", re.IGNORECASE),
}
"""Patterns of comments that state an order."""


def check_order_of_quaternions(head: TableHead, found: PoseColumns) -> None:
    """Raise InputError if a comment or the motion contradicts the order of quaternions in columns.

    Nothing is checked unless the quaternions are four consecutive columns with the scalar first or last. The numbers in
    the titles of the suite (`att_q_DsToRb_1`) state their order.
    """
    if not {*POSITION, *QUATERNION} <= found.index_of.keys() or found.is_conjugated:
        return
    indices = sorted(found.index_of[key] for key in QUATERNION)
    order = tuple(sorted(QUATERNION, key=found.index_of.__getitem__))
    if order not in _ORDERS or indices[-1] - indices[0] != len(QUATERNION) - 1:
        return
    if not found.by_header:
        _check_comments(head, found, order)
    _check_motion(head, found, order)


def _check_comments(head: TableHead, found: PoseColumns, order: tuple[str, ...]) -> None:
    """Raise InputError if the last comment that states an order of quaternions states another order."""
    stated = [
        (number, other)
        for number, line in enumerate(head.before, 1)
        for other, pattern in _COMMENTS.items()
        if pattern.search(line)
    ]
    number, other = stated[-1] if stated else (0, order)
    if other != order:
        raise InputError(
            f"{head.name} line {number} states that quaternions have the scalar {_ORDERS[other]}, unlike {found.name}: "
            f"{head.named_by(_columns_with(head, found, other))}"
        )


def _check_motion(head: TableHead, found: PoseColumns, order: tuple[str, ...]) -> None:
    """Raise InputError if the attitudes describe a vehicle only in the other order of quaternions."""
    positions, quats = _poses(head, found)
    to_other = [1, 2, 3, 0] if order == QUATERNION else [3, 0, 1, 2]
    others = quats[:, to_other]
    if found.by_header:
        origin = "a header that names its columns"
        problem = "not along the path" if contradicts_order(positions, quats, others) else ""
    else:
        origin = "no header"
        problem = problem_of_order(positions, quats, others)
    if not problem:
        return
    other = next(place for each, place in _ORDERS.items() if each != order)
    first, last = (head.option_with(_columns_with(head, found, each)) for each in (SCALAR_FIRST, QUATERNION))
    raise InputError(
        f"{head.name} has {origin}, and its attitudes are {problem} if read as {found.name}, but level and along the "
        f"path if the scalar of the quaternions is {other}: name the columns by {first} if it is first, or by {last} "
        "if it is last"
    )


def _poses(head: TableHead, found: PoseColumns) -> tuple[FloatArray, FloatArray]:
    """Return the valid positions `(N, 3)` and quaternions `(N, 4)` of the first rows, in the order of their stamps."""
    stamps = [key for key in (STAMP, SECONDS, NANOSECONDS) if key in found.index_of]
    keys = (*stamps, *POSITION, *QUATERNION)
    columns = [found.index_of[key] for key in keys]
    rows = head.numbers(max(columns) + 1)[:, columns]
    rows = rows[np.isfinite(rows).all(axis=1)]
    if stamps:
        rows = rows[np.lexsort([rows[:, column] for column in reversed(range(len(stamps)))])]
    positions, quats = rows[:, len(stamps) : -4], rows[:, -4:]
    is_valid = plausible_positions(positions) & plausible_attitudes(quats)
    return positions[is_valid], quats[is_valid]


def _columns_with(head: TableHead, found: PoseColumns, order: Sequence[str]) -> str:
    """Return the columns for `--columns` with another order of quaternions, by number if a header has their units."""
    if not found.by_header:
        return ",".join((f"t[{head.time_unit}]", *POSITION, *order))
    first = min(found.index_of[key] for key in QUATERNION)
    index_of = {**found.index_of, **{key: first + number for number, key in enumerate(order)}}
    columns = sorted(index_of.items(), key=lambda item: item[1])
    return ",".join(f"{key}=#{index + 1}" for key, index in columns)

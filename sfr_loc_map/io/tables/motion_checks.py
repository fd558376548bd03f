"""Checks of the columns of a table by the numbers in them: they must be those of a vehicle's motion.

Positions are lengths, neither latitude and longitude nor a heading in place of a height. The order of quaternions,
scalar first or last, must not be contradicted by comments or by the motion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import plausible_attitudes, plausible_positions
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.io.tables.pose_columns import (
    NANOSECONDS,
    POSITION,
    QUATERNION,
    SCALAR_FIRST,
    SECONDS,
    STAMP,
    PoseColumns,
)
from sfr_loc_map.io.tables.table_head import TableHead, header_cells, separator_in
from sfr_loc_map.io.tables.titles import split_unit
from sfr_loc_map.io.tables.user_columns import columns_text

LEVEL = 0.5  #: Smallest vertical component of the upward axis of a level vehicle: a tilt of 60 deg.
FORWARD = 0.5  #: Smallest mean component of the forward axis along the path, for a vehicle that drives forward.
FEWEST_POSITIONS = 3  #: Smallest number of positions that show a path.
FEWEST_POSES = 20  #: Smallest number of poses that can contradict a header.
CLOSE_TO_PATH = 0.9
"""Smallest mean component of the forward axis along the path if quaternions are read in the order that is not named."""
CLOSER_TO_PATH = 0.1  #: Smallest difference between this component and the component in the named order.
CHORDS = 50  #: Number of parts of a path; their chords are longer than the position noise.
HEADING_FIT = 0.1  #: Largest deviation of headings from the path, as a fraction of the deviation of a straight line.
LARGEST_DEG = 180.0  #: Largest longitude, deg.
KILOMETRE_DEG = 0.01  #: One kilometre on the ground, deg of latitude.
FAR_EXTENTS = 1000.0  #: Smallest distance from the origin of a path in degrees, as a multiple of its extent.
LEVEL_IN_OTHER = 0.9
"""Smallest fraction of level poses of a vehicle if quaternions are read in the order that is not named."""
LEVEL_AS_READ = 0.5
"""Smallest fraction of level poses of a vehicle in the order of the header or the layout. The fraction is smaller than
`LEVEL_IN_OTHER`, because this order is stated."""
_DEGREES = ({"lat", "latitude"}, {"lon", "long", "lng", "longitude"})
"""Names of the two columns of a geographic position, in lower case."""
_ORDERS: dict[tuple[str, ...], str] = {QUATERNION: "last", SCALAR_FIRST: "first"}
"""Place of the scalar by the order of the columns."""
_COMMENTS: dict[tuple[str, ...], re.Pattern[str]] = {
    QUATERNION: re.compile(r"\bq?_?x\W+q?_?y\W+q?_?z\W+q?_?w\b|\bxyzw\b", re.IGNORECASE),
    SCALAR_FIRST: re.compile(r"\bq?_?w\W+q?_?x\W+q?_?y\W+q?_?z\b|\bwxyz\b", re.IGNORECASE),
}
"""Patterns of comments that state an order."""


# ---- positions


def check_titles_are_lengths(head: TableHead) -> None:
    """Raise InputError if a line before the rows names latitude and longitude, because these are not lengths."""
    for number, line in enumerate(head.before, 1):
        titles = {re.sub(r"[^a-z]", "", split_unit(cell)[0].lower()) for cell in header_cells(line, separator_in(line))}
        if all(titles & names for names in _DEGREES):
            raise InputError(
                f"{head.name} line {number} names latitude and longitude: positions in metres are required;",
                "convert them to columns east, north and height",
            )


def check_positions_are_lengths(head: TableHead, columns: PoseColumns) -> None:
    """Raise InputError if the position of `t x y z` is probably latitude and longitude, or has a heading as height."""
    if STAMP not in columns or columns.value_keys != POSITION:
        return
    indices = [columns.index_of[key] for key in (STAMP, *POSITION)]
    rows = _stamped_rows(head, indices, 1)
    rows = rows[plausible_positions(rows[:, 1:])]
    if len(rows) < FEWEST_POSITIONS:
        return
    if not columns.are_named and _are_degrees(rows[:, 1:3]):
        raise InputError(
            f"{head.name} has four columns and no header, and the second and the third are probably latitude and "
            "longitude in degrees: positions in metres are required;",
            f"convert them, or {head.named_by(f't[{head.time_unit}],x,y,z')}",
        )
    column = indices[-1]
    unit = _unit_of_headings(rows[:, 1:3], rows[:, 3]) if _may_be_heading(head, columns, column) else ""
    if unit:
        raise InputError(
            f"{head.name}: column #{column + 1} is the heading of the path in {unit}, not a height: a position "
            f"with a height is required;",
            f"add a column of heights, and {head.named_by_number()}",
        )


def _may_be_heading(head: TableHead, columns: PoseColumns, column: int) -> bool:
    """Return whether the column of z has no title, or the title `h`, which may be that of a heading."""
    titles = [cells[column].lower() for line in head.before if len(cells := head.cells_of(line)) > column]
    return not columns.are_named or "h" in titles


def _stamped_rows(head: TableHead, indices: Sequence[int], stamps: int) -> FloatArray:
    """Return the finite numbers of the first rows in these columns, in the order of the first columns, the `stamps`.

    Dates are not numbers; their rows are in the order of the file.
    """
    rows = head.numbers(max(indices) + 1)[:, indices]
    if not np.isfinite(rows[:, :stamps]).any():
        rows[:, :stamps] = np.arange(len(rows))[:, None]
    rows = rows[np.isfinite(rows).all(axis=1)]
    return rows[np.lexsort([rows[:, column] for column in reversed(range(stamps))])] if stamps else rows


# ---- order of quaternions


def check_order_of_quaternions(head: TableHead, columns: PoseColumns) -> None:
    """Raise InputError if a comment or the motion contradicts the order of quaternions in columns.

    Nothing is checked unless the quaternions are four consecutive columns with the scalar first or last. The column
    titles of the suite's own csv (`att_q_DsToRb_1`) number the components, so that their order is not checked either.
    """
    if not {*POSITION, *QUATERNION} <= columns.index_of.keys() or columns.is_conjugated:
        return
    indices = sorted(columns.index_of[key] for key in QUATERNION)
    order = tuple(sorted(QUATERNION, key=columns.index_of.__getitem__))
    if order not in _ORDERS or indices[-1] - indices[0] != len(QUATERNION) - 1:
        return
    options = {each: head.option_with(_columns_text(columns, indices[0], each)) for each in _ORDERS}
    if not columns.are_named:
        _check_comments(head, columns, order, options)
    _check_motion(head, columns, order, options)


def _columns_text(columns: PoseColumns, first: int, order: tuple[str, ...]) -> str:
    """Return the columns as the user names them, with another order of the quaternions from the column `first`."""
    quaternion = {key: first + number for number, key in enumerate(order)}
    return columns_text({**columns.index_of, **quaternion}, columns.units)


def _check_comments(
    head: TableHead, columns: PoseColumns, order: tuple[str, ...], options: Mapping[tuple[str, ...], str]
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
            f"{columns.name}:",
            f"name the columns: {options[other]}",
        )


def _check_motion(
    head: TableHead, columns: PoseColumns, order: tuple[str, ...], options: Mapping[tuple[str, ...], str]
) -> None:
    """Raise InputError if the attitudes describe a vehicle only in the other order of quaternions."""
    positions, quats = _poses(head, columns)
    to_other = [1, 2, 3, 0] if order == QUATERNION else [3, 0, 1, 2]
    others = quats[:, to_other]
    if columns.are_named:
        origin = "a header that names its columns"
        problem = "not along the path" if _contradicts_order(positions, quats, others) else ""
    else:
        origin = "no header"
        problem = _problem_of_order(positions, quats, others)
    if not problem:
        return
    other = next(place for each, place in _ORDERS.items() if each != order)
    raise InputError(
        f"{head.name} has {origin}, and its attitudes are {problem} if read as {columns.name}, but level and along the "
        f"path if the scalar of the quaternions is {other}:",
        f"name the columns by {options[SCALAR_FIRST]} if it is first, or by {options[QUATERNION]} if it is last",
    )


def _poses(head: TableHead, columns: PoseColumns) -> tuple[FloatArray, FloatArray]:
    """Return the valid positions `(N, 3)` and quaternions `(N, 4)` of the first rows, in the order of their stamps."""
    stamps = [key for key in (STAMP, SECONDS, NANOSECONDS) if key in columns]
    indices = [columns.index_of[key] for key in (*stamps, *POSITION, *QUATERNION)]
    rows = _stamped_rows(head, indices, len(stamps))
    positions = rows[:, len(stamps) : -4]
    quats = rows[:, -4:]
    is_valid = plausible_positions(positions) & plausible_attitudes(quats)
    return positions[is_valid], quats[is_valid]


# ---- motion of a vehicle


def _problem_of_order(positions: FloatArray, quats_xyzw: FloatArray, other_xyzw: FloatArray) -> str:
    """Return why attitudes `(N, 4)` at positions `(N, 3)` are implausible as read; empty if they are plausible.

    `other_xyzw` are the attitudes in the other order of quaternions, scalar first in place of last or vice versa. The
    attitudes are implausible only if this other order gives a level vehicle. If both orders give a level vehicle, the
    forward axis as read must also point against the path, and that of the other order along the path. As read, the axes
    may also be those of a camera, whose y-axis points down and whose z-axis points forward.
    """
    if not quats_xyzw.any():  # positions without attitude
        return ""
    of_other = matrix_from_quat(other_xyzw)
    if np.mean(of_other[:, 2, 2] > LEVEL) < LEVEL_IN_OTHER:
        return ""
    axes = _forward_and_upward(matrix_from_quat(quats_xyzw))
    forward = [axis for axis, upward in axes if np.mean(upward > LEVEL) >= LEVEL_AS_READ]
    if not forward:
        return "not level"
    is_placeholder = not np.ptp(quats_xyzw, axis=0).any()
    is_opposite = all(_along_path(axis, positions) < 0.0 for axis in forward)
    if is_placeholder or not is_opposite or _along_path(of_other[:, :, 0], positions) < FORWARD:
        return ""
    return "opposite to the path"


def _contradicts_order(positions: FloatArray, quats_xyzw: FloatArray, other_xyzw: FloatArray) -> bool:
    """Return whether attitudes `(N, 4)` contradict the order of quaternions that a header names, at positions `(N, 3)`.

    In the other order (`other_xyzw`), they describe a level vehicle whose forward axis points along the path, and in
    the named order no axis of the body, forwards or backwards, is as close to the path. Bodies may have any axes.
    """
    if len(positions) < FEWEST_POSES or not np.ptp(quats_xyzw, axis=0).any():
        return False
    of_other = matrix_from_quat(other_xyzw)
    along_other = _along_path(of_other[:, :, 0], positions)
    if np.mean(of_other[:, 2, 2] > LEVEL) < LEVEL_IN_OTHER or along_other < CLOSE_TO_PATH:
        return False
    as_read = matrix_from_quat(quats_xyzw)
    closest = max(abs(_along_path(as_read[:, :, axis], positions)) for axis in range(3))
    return closest < along_other - CLOSER_TO_PATH


def _unit_of_headings(path: FloatArray, values: FloatArray) -> str:
    """Return the unit of values `(N,)` that are the headings of a path `(N, 2)`: radians or degrees; empty otherwise.

    A heading points along the path. A height does not, except for a straight path.
    """
    curvature = 1.0 - _straightness(path)
    for unit, heading_rad in (("radians", values), ("degrees", np.radians(values))):
        axis = np.stack((np.cos(heading_rad), np.sin(heading_rad)), axis=1)
        if 1.0 - _along_path(axis, path) < HEADING_FIT * curvature:
            return unit
    return ""


def _are_degrees(path: FloatArray) -> bool:
    """Return whether the coordinates `(N, 2)` of a smooth path are probably latitude and longitude.

    In degrees, a drive of less than 1 km is small compared with its distance from the equator and the meridian. In
    metres, so small an extent would be that of a stationary body, whose noise is not smooth.
    """
    if float(np.abs(path).max()) > LARGEST_DEG:
        return False
    extent = float(np.ptp(path, axis=0).max())
    steps = np.diff(path, axis=0)
    length, bends = (float(np.linalg.norm(part, axis=1).sum()) for part in (steps, np.diff(steps, axis=0)))
    is_far = 0.0 < extent < min(KILOMETRE_DEG, float(np.abs(np.median(path, axis=0)).max()) / FAR_EXTENTS)
    return is_far and bends < length


def _straightness(path: FloatArray) -> float:
    """Return the length of the mean direction of a path `(N, 2)`: 1 for a straight path, 0 for a closed path."""
    ends = _ends_of_chords(path)
    chords = np.diff(path[ends], axis=0)
    length = np.linalg.norm(chords, axis=1).sum()
    return float(np.linalg.norm(chords.sum(axis=0)) / length) if length > 0.0 else 1.0


def _ends_of_chords(positions: FloatArray) -> IntArray:
    """Return the rows of positions `(N, K)` that divide a path into at most `CHORDS` chords."""
    return np.unique(np.linspace(0, len(positions) - 1, CHORDS + 1).astype(np.int64))


def _forward_and_upward(rotations: FloatArray) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return the forward axis `(N, 3)` and the vertical component of the upward axis `(N,)`, of a body and a camera."""
    return (rotations[:, :, 0], rotations[:, 2, 2]), (rotations[:, :, 2], -rotations[:, 2, 1])


def _along_path(axis: FloatArray, positions: FloatArray) -> float:
    """Return the mean component of an axis `(N, K)` along a path `(N, K)`: -1 to 1, and 0 for a stationary body."""
    ends = _ends_of_chords(positions)
    chords = np.diff(positions[ends], axis=0)
    length = np.linalg.norm(chords, axis=1).sum()
    return float(np.sum(axis[ends[:-1]] * chords) / length) if length > 0.0 else 0.0

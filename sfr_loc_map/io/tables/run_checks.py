"""Checks that the stamped poses of a table are one run of one body."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.inputs import MAX_INVALID

MAX_EQUAL = 2  #: Largest mean number of poses with one stamp; some tools write each pose twice.
SAME_PLACE_M = 0.01  #: Largest distance of positions at equal stamps that may be noise, m.
APART_STEPS = 5.0  #: Smallest distance of two bodies, as a multiple of the median step between different stamps.
NEXT_ROWS = 6  #: Number of following rows in which the next row of the same body is searched.
GRID_STEPS = 4.0  #: Smallest distance of two bodies, as a multiple of the grid to which the positions are rounded.
SMALLEST_GRID_M = 1e-6  #: Smallest difference of two coordinates that is not a rounding error of the numbers, m.
RUN_ROWS = 10  #: Smallest number of rows of a run; rows in random order have shorter runs.


def check_one_run_of_one_body(name: str, lines: IntArray, stamps_ns: IntArray, positions: FloatArray) -> None:
    """Raise InputError unless the positions `(N, 3)`, m, of a table are those of one run of one body.

    `lines` `(N,)` are the line numbers of the rows, for messages.
    """
    _check_stamps_differ(name, stamps_ns)
    _check_one_run(name, lines, stamps_ns)
    _check_one_body(name, lines, stamps_ns, positions)
    _check_not_alternating(name, stamps_ns, positions)


def _check_stamps_differ(name: str, stamps_ns: IntArray) -> None:
    """Raise InputError if a stamp has more than `MAX_EQUAL` poses on average, as when its last digits are missing."""
    ascending_ns = np.sort(stamps_ns)  # hundred times as fast as `np.unique`, which hashes integers
    count, different = len(ascending_ns), 1 + np.count_nonzero(np.diff(ascending_ns))
    if count > MAX_EQUAL * different:
        raise InputError(
            f"{name}: the number of different stamps is {different} for {count} poses: one stamp for each pose "
            "is required;",
            "write the stamps with all their digits",
        )


def _check_one_run(name: str, lines: IntArray, stamps_ns: IntArray) -> None:
    """Raise InputError if a table has several runs over the same time, for example because the clock was restarted.

    A run is a part of the table with increasing stamps. A table may be sorted in descending order, consist of runs
    whose times do not overlap, in any order, or have stray rows anywhere.
    """
    steps = np.diff(stamps_ns)
    is_downwards = np.count_nonzero(steps < 0) > np.count_nonzero(steps > 0)
    if is_downwards:
        lines, stamps_ns = lines[::-1], stamps_ns[::-1]
    starts = np.append(0, np.flatnonzero(np.diff(stamps_ns) < 0) + 1)
    counts = np.diff(starts, append=len(stamps_ns))
    starts, counts = starts[counts >= RUN_ROWS], counts[counts >= RUN_ROWS]
    margins = np.maximum(counts // 10, 1)  # a stray stamp may begin or end a run
    first_ns, last_ns = stamps_ns[starts + margins], stamps_ns[starts + counts - 1 - margins]
    order = np.argsort(first_ns, kind="stable")
    overlaps = first_ns[order][1:] < np.maximum.accumulate(last_ns[order])[:-1]
    if overlaps.any():
        row = int(starts[order][1:][overlaps].max())
        raise InputError(
            f"{name} line {lines[row]}: the stamps begin again within the time of other rows: one run is required;",
            "give each run a file of its own",
        )


def _check_one_body(name: str, lines: IntArray, stamps_ns: IntArray, positions: FloatArray) -> None:
    """Raise InputError if positions `(N, 3)` with equal stamps are apart, as those of two bodies.

    Up to `MAX_INVALID` of the poses may have the stamp of another pose.
    """
    order = np.argsort(stamps_ns, kind="stable")
    is_equal = np.diff(stamps_ns[order]) == 0
    if np.count_nonzero(is_equal) <= MAX_INVALID * len(order):
        return
    ordered = positions[order]
    apart_m = np.linalg.norm(np.diff(ordered, axis=0), axis=1)[is_equal]
    first_of_stamp = ordered[np.append(True, ~is_equal)]
    steps_m = np.linalg.norm(np.diff(first_of_stamp, axis=0), axis=1)
    typical_m = float(np.median(apart_m))
    if typical_m > max(SAME_PLACE_M, APART_STEPS * float(np.median(steps_m)) if len(steps_m) else 0.0):
        line = lines[order[1:][is_equal][0]]
        raise InputError(
            f"{name} line {line} and {len(apart_m) - 1} more have the stamp of another line, but positions that "
            f"are typically {typical_m:.3g} m apart: the poses of one body are required;",
            "give each body a file of its own",
        )


def _check_not_alternating(name: str, stamps_ns: IntArray, positions: FloatArray) -> None:
    """Raise InputError if the path `(N, 3)` alternates between places.

    A path alternates if its rows belong to several bodies that have their own stamps. A row is then near the next row
    of the same body, but far from the row that follows in time. White noise of a stationary body has steps of at most
    about three times the smallest distance to the following rows. A stationary body whose positions are rounded may
    alternate between two places, so the bodies are also required to move by more than their distance. The rounded
    positions of a slow body alternate between neighbouring points of the grid while the body moves on, so the distance
    is also required to exceed `GRID_STEPS` times the grid.
    """
    ordered = positions[np.argsort(stamps_ns, kind="stable")]
    count = len(ordered) - NEXT_ROWS
    if count < RUN_ROWS:
        return
    to_next_m = np.linalg.norm(ordered[1 : count + 1] - ordered[:count], axis=1)
    nearest_m = to_next_m
    for later in range(2, NEXT_ROWS + 1):
        nearest_m = np.minimum(nearest_m, np.linalg.norm(ordered[later : later + count] - ordered[:count], axis=1))
    is_away = to_next_m > np.maximum(SAME_PLACE_M, APART_STEPS * nearest_m)
    if np.mean(is_away) <= MAX_INVALID:
        return
    typical_m = float(np.median(to_next_m[is_away]))
    extent_m = float(np.linalg.norm(np.ptp(ordered, axis=0)))
    is_far = extent_m > 2.0 * typical_m > 2.0 * GRID_STEPS * _grid_m(ordered)
    if to_next_m.mean() > APART_STEPS * nearest_m.mean() and is_far:
        raise InputError(
            f"{name}: {np.count_nonzero(is_away)} of {count} steps lead to another place and back, typically "
            f"{typical_m:.3g} m away: the poses of one body are required;",
            "give each body a file of its own",
        )


def _grid_m(positions: FloatArray) -> float:
    """Return the grid to which positions `(N, 3)` are rounded, m: the smallest difference of two coordinates."""
    differences = np.diff(np.sort(positions, axis=0), axis=0)
    return float(np.min(differences, initial=np.inf, where=differences > SMALLEST_GRID_M))

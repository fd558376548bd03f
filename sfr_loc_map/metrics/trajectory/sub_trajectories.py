"""Sub-trajectories: where they start and where they end [4.1.1].

Starts are every `spacing` frames from the first. A sub-trajectory ends at the first frame at which its condition holds:
the truth's path length summed over the frames (>= with a tolerance of 1e-9 m), elapsed time (>=, on nanoseconds) or
number of frames. A start whose condition is never met gives none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.small_linalg import copy_row
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.condition import ConditionKind

DISTANCE_TOLERANCE_M = 1e-9
"""A path this much shorter than the distance is long enough."""
DISTANCE, TIME, FRAMES = range(3)
"""Kinds of conditions in compiled code."""
KINDS = {ConditionKind.DISTANCE: DISTANCE, ConditionKind.TIME: TIME, ConditionKind.FRAMES: FRAMES}


class Progress(NamedTuple):
    """How far along the drive some frames are.

    Attributes:
        frames: `(N,)` their numbers.
        stamps_ns: `(N,)` their stamps.
        lengths: `(N, 2)` path lengths, see `path_lengths`.
    """

    frames: IntArray
    stamps_ns: IntArray
    lengths: FloatArray


@jit
def path_lengths(positions: FloatArray, last: FloatArray, length: FloatArray) -> FloatArray:
    """Return the path length `(N, 2)` up to each frame, as a sum of two numbers so that no step is lost to rounding.

    Args:
        positions: `(N, 3)`, metres.
        last: `(3,)` position before the first; NaN if there is none. Changed to the last position.
        length: `(2,)` path length up to `last`. Changed to the path length up to the last position.
    """
    out = np.empty((len(positions), 2))
    for i in range(len(positions)):
        dx, dy, dz = positions[i, 0] - last[0], positions[i, 1] - last[1], positions[i, 2] - last[2]
        step = np.sqrt(dx * dx + dy * dy + dz * dz)
        if step == step:  # not NaN: there is a position before
            total = length[0] + step  # Neumaier 1974
            if length[0] >= step:
                length[1] += (length[0] - total) + step
            else:
                length[1] += (step - total) + length[0]
            length[0] = total
        copy_row(positions[i], last)
        copy_row(length, out[i])
    return out


@jit
def find_ends(starts: Progress, rows: Progress, kind: int, threshold: float) -> IntArray:
    """Return for each start the row of its end, or the number of rows if the condition is not met by the last.

    Both go up, so that one walk through the rows finds all.

    Args:
        starts: Starts `(M,)`.
        rows: Consecutive frames `(N,)`.
        kind: `DISTANCE`, `TIME` or `FRAMES`.
        threshold: Metres, nanoseconds or frames.
    """
    count = len(rows.frames)
    ends = np.full(len(starts.frames), count, dtype=np.int64)
    row = 0
    for i in range(len(starts.frames)):
        row = max(row, starts.frames[i] + 1 - rows.frames[0])
        while row < count:
            if kind == DISTANCE:
                path = (rows.lengths[row, 0] - starts.lengths[i, 0]) + (rows.lengths[row, 1] - starts.lengths[i, 1])
                met = path >= threshold - DISTANCE_TOLERANCE_M
            elif kind == TIME:
                met = rows.stamps_ns[row] - starts.stamps_ns[i] >= threshold
            else:
                met = rows.frames[row] - starts.frames[i] >= threshold
            if met:
                break
            row += 1
        if row >= count:
            break
        ends[i] = row
    return ends

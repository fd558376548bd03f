"""Sub-trajectories: where they start and where they end [4.1.1].

Starts are every `spacing` frames from the first. A sub-trajectory ends at the first frame at which its condition holds:
the truth's path length summed over the frames (>= with a tolerance of 1e-9 m), elapsed time (>=, on nanoseconds) or
number of frames; of several conditions that have to hold at once the first frame at which all do. A start whose
condition is never met gives none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.config import ConditionKind

DISTANCE_TOLERANCE_M = 1e-9  #: A path this much shorter than the distance is long enough.
DISTANCE, TIME, FRAMES = range(3)  #: Kinds of conditions in compiled code.
KINDS = {ConditionKind.DISTANCE: DISTANCE, ConditionKind.TIME: TIME, ConditionKind.FRAMES: FRAMES}
"""What only grows along a drive, so that it holds from its end on."""


class Progress(NamedTuple):
    """How far along the drive the frames are: stamps `(N,)`, ns, and path lengths `(N, 2)`, see `path_lengths`."""

    stamps_ns: IntArray
    lengths: FloatArray


@jit
def path_lengths(positions: FloatArray) -> FloatArray:
    """Return the path length `(N, 2)` up to each of the positions `(N, 3)`, m.

    Each is a sum of two numbers, so that no step is lost to rounding (Neumaier 1974).
    """
    out = np.zeros((len(positions), 2))
    length, rest = 0.0, 0.0
    for i in range(1, len(positions)):
        dx, dy = positions[i, 0] - positions[i - 1, 0], positions[i, 1] - positions[i - 1, 1]
        dz = positions[i, 2] - positions[i - 1, 2]
        step = np.sqrt(dx * dx + dy * dy + dz * dz)
        total = length + step
        if length >= step:
            rest += (length - total) + step
        else:
            rest += (step - total) + length
        length = total
        out[i, 0], out[i, 1] = length, rest
    return out


@jit
def find_ends(starts: IntArray, progress: Progress, kind: int, threshold: float) -> IntArray:
    """Return for each start the frame of its end, or the number of frames if the condition is not met by the last.

    Both go up, so that one walk through the frames finds all. The threshold is in metres, nanoseconds or frames.
    """
    stamps_ns, lengths = progress
    count = len(stamps_ns)
    ends = np.full(len(starts), count, dtype=np.int64)
    row = 0
    for i in range(len(starts)):
        start = starts[i]
        row = max(row, start + 1)
        while row < count:
            if kind == DISTANCE:
                path = (lengths[row, 0] - lengths[start, 0]) + (lengths[row, 1] - lengths[start, 1])
                met = path >= threshold - DISTANCE_TOLERANCE_M
            elif kind == TIME:
                met = stamps_ns[row] - stamps_ns[start] >= threshold
            else:
                met = row - start >= threshold
            if met:
                break
            row += 1
        if row >= count:
            break
        ends[i] = row
    return ends


@jit
def find_apart(
    starts: IntArray, ends: IntArray, positions: FloatArray, quats: FloatArray, metres: float, turn_rad: float
) -> IntArray:
    """Return for each start the first frame from its end on that is so far away, and turned by so much."""
    half_turn_cosine = np.cos(0.5 * turn_rad) + 1e-12  # of a turn of exactly so much
    count = len(positions)
    for i in range(len(starts)):
        start, row = starts[i], ends[i]
        while row < count:
            x, y = positions[row, 0] - positions[start, 0], positions[row, 1] - positions[start, 1]
            z = positions[row, 2] - positions[start, 2]
            dot = 0.0
            for k in range(4):
                dot += quats[row, k] * quats[start, k]
            if np.sqrt(x * x + y * y + z * z) >= metres - DISTANCE_TOLERANCE_M and abs(dot) <= half_turn_cosine:
                break
            row += 1
        ends[i] = row
    return ends

"""Sub-trajectories: where they start and where they end [4.1.1].

Starts are every `spacing` frames from the first. A sub-trajectory ends at the first frame at which its condition holds:
the truth's path length summed over the frames (>= with a tolerance of 1e-9 m), elapsed time (>=, on nanoseconds) or
number of frames. A start whose condition is never met gives none.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit

DISTANCE_TOLERANCE_M = 1e-9
"""A path this much shorter than asked for is long enough."""


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
        last[:] = positions[i]
        out[i] = length
    return out


@jit
def find_ends(
    start_lengths: FloatArray,
    start_stamps: IntArray,
    start_frames: IntArray,
    lengths: FloatArray,
    stamps: IntArray,
    first_frame: int,
    kind: int,
    value: float,
) -> IntArray:
    """Return for each start the row of its end, or the number of rows if the condition is not met by the last.

    Both go up, so that one walk through the rows finds all.

    Args:
        start_lengths: `(M, 2)` path lengths at the starts.
        start_stamps: `(M,)` stamps of the starts.
        start_frames: `(M,)` frame numbers of the starts.
        lengths: `(N, 2)` path lengths of the rows.
        stamps: `(N,)` stamps of the rows.
        first_frame: Frame number of the first row.
        kind: 0 distance, 1 time, 2 frames.
        value: Metres, nanoseconds or frames.
    """
    ends = np.full(len(start_frames), len(stamps), dtype=np.int64)
    row = 0
    for i in range(len(start_frames)):
        row = max(row, start_frames[i] + 1 - first_frame)
        while row < len(stamps):
            if kind == 0:
                path = (lengths[row, 0] - start_lengths[i, 0]) + (lengths[row, 1] - start_lengths[i, 1])
                met = path >= value - DISTANCE_TOLERANCE_M
            elif kind == 1:
                met = stamps[row] - start_stamps[i] >= value
            else:
                met = first_frame + row - start_frames[i] >= value
            if met:
                break
            row += 1
        if row >= len(stamps):
            break
        ends[i] = row
    return ends

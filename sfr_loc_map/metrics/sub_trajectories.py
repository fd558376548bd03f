"""Sub-trajectories: where they start and where they end [4.1.1].

Starts are every `spacing` frames from the first. A sub-trajectory ends at the first frame at which its condition holds:
the truth's path length summed over the frames (>= with a tolerance of 1e-9 m), elapsed time (>=, on nanoseconds) or
number of frames. A start whose condition is never met gives none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit

DISTANCE_TOLERANCE_M = 1e-9
"""A path this much shorter than asked for is long enough."""
KINDS = {"distance": "distance_m", "time": "time_s", "frames": "frames"}
"""Word of each kind of condition, and its key in the score."""


@dataclass(frozen=True, slots=True)
class Condition:
    """What ends a sub-trajectory.

    Attributes:
        kind: `distance`, `time` or `frames`.
        value: Metres, seconds or number of frames, > 0.
    """

    kind: str
    value: float

    @classmethod
    def parse(cls, text: str) -> Condition:
        """Return the condition of a text such as `distance=5`, `time=60` or `frames=100`.

        Raises:
            MetricsError: If it is none.
        """
        kind, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = float("nan")
        whole = kind != "frames" or value == round(value)
        if kind not in KINDS or not np.isfinite(value) or value <= 0 or not whole:
            raise MetricsError(f"'{text}' is no condition: give distance=METRES, time=SECONDS or frames=NUMBER, > 0")
        return cls(kind, value)

    def as_dict(self) -> dict[str, float | int]:
        """Return it as in the score: `{"distance_m": 5.0}`."""
        return {KINDS[self.kind]: int(self.value) if self.kind == "frames" else self.value}

    def __str__(self) -> str:
        """Return it in words."""
        unit = {"distance": "m", "time": "s", "frames": "frames"}[self.kind]
        return f"{self.value:g} {unit}"


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

"""Meaning of numbers, inferred from a vehicle's motion: order of quaternions, and a heading in place of a height."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_quat

LEVEL = 0.5  #: Smallest vertical component of the upward axis of a level vehicle: a tilt of 60 deg.
FORWARD = 0.5  #: Smallest mean component along the path of the forward axis of a vehicle that drives forward.
CHORDS = 50  #: Number of parts of a path; their chords are longer than the position noise.
HEADING_FIT = 0.1  #: Largest deviation of headings from the path, as a fraction of the deviation of a straight line.
LEVEL_IF_FIRST = 0.9  #: Smallest fraction of level poses of a vehicle, read with the scalar first.
LEVEL_IF_LAST = 0.5  #: The same with the scalar last. It is smaller, because this order is that of the layout.


def problem_of_scalar_last(positions: FloatArray, quats_xyzw: FloatArray) -> str:
    """Return the problem of attitudes `(N, 4)` at positions `(N, 3)` that only the other order of quaternions avoids.

    The attitudes are read with the scalar last, but describe a vehicle if the scalar is read first. The text is empty
    if there is no such problem. A vehicle is level. If the vehicle is level in both orders, its forward axis decides,
    which points along the path. With the scalar last, the axes may also be those of a camera, whose y-axis points down
    and whose z-axis points forward.
    """
    if not quats_xyzw.any():  # positions without attitude
        return ""
    if_first = matrix_from_quat(quats_xyzw[:, [1, 2, 3, 0]])
    if np.mean(if_first[:, 2, 2] > LEVEL) < LEVEL_IF_FIRST:
        return ""
    axes = _forward_and_upward(matrix_from_quat(quats_xyzw))
    forward = [axis for axis, upward in axes if np.mean(upward > LEVEL) >= LEVEL_IF_LAST]
    if not forward:
        return "not level"
    is_placeholder = not np.ptp(quats_xyzw, axis=0).any()
    is_opposite = all(_along_path(axis, positions) < 0.0 for axis in forward)
    if is_placeholder or not is_opposite or _along_path(if_first[:, :, 0], positions) < FORWARD:
        return ""
    return "opposite to the path"


def unit_of_headings(path: FloatArray, values: FloatArray) -> str:
    """Return the unit of values `(N,)` that are the headings of a path `(N, 2)`: radians or degrees; empty otherwise.

    A heading points along the path. A height does not, except for a straight path.
    """
    curvature = 1.0 - _straightness(path)
    for unit, heading_rad in (("radians", values), ("degrees", np.radians(values))):
        axis = np.stack((np.cos(heading_rad), np.sin(heading_rad)), axis=1)
        if 1.0 - _along_path(axis, path) < HEADING_FIT * curvature:
            return unit
    return ""


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

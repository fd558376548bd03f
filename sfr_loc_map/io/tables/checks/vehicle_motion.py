"""Meaning of numbers, inferred from a vehicle's motion: order of quaternions, headings, and degrees."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_quat

LEVEL = 0.5  #: Smallest vertical component of the upward axis of a level vehicle: a tilt of 60 deg.
FORWARD = 0.5  #: Smallest mean component along the path of the forward axis of a vehicle that drives forward.
FEWEST_POSES = 20  #: Smallest number of poses that can contradict a header.
CLOSE_TO_PATH = 0.9  #: Smallest mean component along the path of the forward axis in the other order than that named.
CLOSER_TO_PATH = 0.1  #: Smallest difference of this component to those in the named order.
CHORDS = 50  #: Number of parts of a path; their chords are longer than the position noise.
HEADING_FIT = 0.1  #: Largest deviation of headings from the path, as a fraction of the deviation of a straight line.
LARGEST_DEG = 180.0  #: Largest longitude, deg.
KILOMETRE_DEG = 0.01  #: One kilometre on the ground, deg of latitude.
FAR_EXTENTS = 1000.0  #: Smallest distance from the origin of a path in degrees, as a multiple of its extent.
LEVEL_IN_OTHER = 0.9  #: Smallest fraction of level poses of a vehicle in the other order of quaternions.
LEVEL_AS_READ = 0.5
"""Smallest fraction of level poses of a vehicle in the order of the header or the layout. It is smaller than
`LEVEL_IN_OTHER`, because this order is stated."""


def problem_of_order(positions: FloatArray, quats_xyzw: FloatArray, other_xyzw: FloatArray) -> str:
    """Return the problem of attitudes `(N, 4)` at positions `(N, 3)` that only the other order of quaternions avoids.

    `other_xyzw` are the attitudes if the scalar, which was read as the first or the last number, is at the other end.
    They describe a vehicle. The text is empty if there is no such problem. A vehicle is level. If the vehicle is level
    in both orders, its forward axis decides, which points along the path. As read, the axes may also be those of a
    camera, whose y-axis points down and whose z-axis points forward.
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


def contradicts_order(positions: FloatArray, quats_xyzw: FloatArray, other_xyzw: FloatArray) -> bool:
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


def are_degrees(path: FloatArray) -> bool:
    """Return whether the coordinates `(N, 2)` of a smooth path are probably latitude and longitude.

    In degrees, a drive of less than 1 km is small compared with its distance from the equator and the meridian. In
    metres, so small an extent would be that of a stationary body, whose noise is not smooth.
    """
    if len(path) < 3 or float(np.abs(path).max()) > LARGEST_DEG:
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

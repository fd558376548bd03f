"""Errors of a sub-trajectory [4.1.2, 4.2.3].

The estimate is re-based at the start N: `T_gt(N) inv(T_est(N)) T_est(N+x)` is compared with `T_gt(N+x)`, so that error
from before N does not count. With `position` re-basing only the position offset at N is taken away. `displacement`
is the document to the letter: displacements from N to N+x in DS, not rotated [4.2.3.1], and the difference of the
changes of attitude and heading since N [4.1.1, 4.1.2].
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.quaternion_kernels import Quat, conjugate, product, rotated, row_difference, row_quat
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.config import Rebase

WHOLE_POSE, ONLY_POSITION, DISPLACEMENT = range(3)  #: Readings in compiled code.
READINGS = {Rebase.POSE: WHOLE_POSE, Rebase.POSITION: ONLY_POSITION, Rebase.DISPLACEMENT: DISPLACEMENT}
MANY = 10_000  #: Sub-trajectories from which on two threads share them.
PART = 1 << 17  #: So many errors are kept at a time: those of a million take 80 MB.
MIN_DIRECTION_M = 1e-6  #: A horizontal displacement shorter than this has no direction: the rover's heading is taken.


X, Y, Z, ATTITUDE, HEADING, CHORD, ALONG, CROSS, VERTICAL, TRAVELLED = range(10)
"""Columns of the errors of sub-trajectories."""
COLUMNS = (
    *("x_m", "y_m", "z_m", "attitude_deg", "heading_deg", "chord_m"),
    *("along_m", "cross_m", "vertical_m", "travelled_m"),
)
"""The same by the names of the score's rows: estimate less truth along the axes of DS; angle between both attitudes
[4.2.3.2]; heading, estimate less truth [4.2.3.3]; straight distance, estimate less truth; error along the horizontal
true displacement, to the left of it and along z of DS; length of the true path."""


class PoseRows(NamedTuple):
    """True and estimated poses side by side: `(N, 3)` metres, DS; `(N, 4)` of unit length; path lengths `(N, 2)`.

    Headings `(N,)` follow from the attitudes; they are computed once, not with each sub-trajectory.
    """

    gt_pos: FloatArray
    gt_quat: FloatArray
    est_pos: FloatArray
    est_quat: FloatArray
    lengths: FloatArray
    gt_heading: FloatArray
    est_heading: FloatArray


@jit
def heading_rad(q: Quat) -> float:
    """Return the heading [4.2.3.3]: angle in DS from x to the projection of the RB x-axis; `q` has unit length."""
    return float(np.arctan2(2.0 * (q[0] * q[1] + q[2] * q[3]), 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])))


@jit
def headings_rad(quats: FloatArray) -> FloatArray:
    """Return the headings of unit quaternions `(N, 4)`."""
    out = np.empty(len(quats))
    for i in range(len(quats)):
        out[i] = heading_rad(row_quat(quats, i))
    return out


@jit
def wrapped_deg(angle: float) -> float:
    """Return an angle in degrees wrapped to (-180, 180]."""
    return float(angle - 360.0 * np.ceil((angle - 180.0) / 360.0))


def sub_trajectory_errors(poses: PoseRows, starts: IntArray, ends: IntArray, reading: int) -> FloatArray:
    """Return the errors `(M, 10)` of sub-trajectories from rows to rows `(M,)` of the poses; `COLUMNS` names them.

    Row by row, so that the bits of a row do not depend on how many are computed at once, by one or by two threads.
    `reading` is one of `READINGS`.
    """
    out, half = np.empty((len(starts), 10)), len(starts) // 2
    if len(starts) <= MANY:
        _errors(poses, starts, ends, reading, out)
        return out
    with ThreadPoolExecutor(1) as other:
        first = other.submit(_errors, poses, starts[:half], ends[:half], reading, out[:half])
        _errors(poses, starts[half:], ends[half:], reading, out[half:])
        first.result()
    return out


@jit
def _errors(poses: PoseRows, starts: IntArray, ends: IntArray, reading: int, out: FloatArray) -> None:
    for m in range(len(starts)):
        i, j = starts[m], ends[m]
        true_move = row_difference(poses.gt_pos, j, poses.gt_pos, i)
        move = row_difference(poses.est_pos, j, poses.est_pos, i)
        chord = np.sqrt(move[0] * move[0] + move[1] * move[1] + move[2] * move[2])
        attitude = row_quat(poses.est_quat, j)
        if reading == WHOLE_POSE:
            correction = product(row_quat(poses.gt_quat, i), conjugate(row_quat(poses.est_quat, i)))
            move = rotated(correction, move)
            attitude = product(correction, attitude)
        error = (move[0] - true_move[0], move[1] - true_move[1], move[2] - true_move[2])
        turn = product(conjugate(row_quat(poses.gt_quat, j)), attitude)
        if reading == DISPLACEMENT:
            true_change = product(conjugate(row_quat(poses.gt_quat, i)), row_quat(poses.gt_quat, j))
            change = product(conjugate(row_quat(poses.est_quat, i)), attitude)
            turn = product(conjugate(true_change), change)
        sine = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
        true_heading = poses.gt_heading[j]
        level = true_move[0] * true_move[0] + true_move[1] * true_move[1]
        horizontal = np.sqrt(level)
        if horizontal >= MIN_DIRECTION_M:
            east, north = true_move[0] / horizontal, true_move[1] / horizontal
        else:
            east, north = np.cos(true_heading), np.sin(true_heading)
        path = (poses.lengths[j, 0] - poses.lengths[i, 0]) + (poses.lengths[j, 1] - poses.lengths[i, 1])
        out[m, X], out[m, Y], out[m, Z] = error[0], error[1], error[2]
        out[m, ATTITUDE] = np.degrees(2.0 * np.arctan2(sine, abs(turn[3])))
        heading = (heading_rad(attitude) if reading == WHOLE_POSE else poses.est_heading[j]) - true_heading
        if reading == DISPLACEMENT:
            heading -= poses.est_heading[i] - poses.gt_heading[i]
        out[m, HEADING] = wrapped_deg(np.degrees(heading))
        out[m, CHORD] = chord - np.sqrt(level + true_move[2] * true_move[2])
        out[m, ALONG] = error[0] * east + error[1] * north
        out[m, CROSS] = error[1] * east - error[0] * north
        out[m, VERTICAL] = error[2]
        out[m, TRAVELLED] = path

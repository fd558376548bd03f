"""Errors of a sub-trajectory [4.1.2, 4.2.3].

The estimate is re-based at the start N: `T_gt(N) inv(T_est(N)) T_est(N+x)` is compared with `T_gt(N+x)`, so that error
from before N does not count. With `position` re-basing only the position offset at N is taken away.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit

COLUMNS = ("x", "y", "z", "attitude", "heading", "along", "cross", "vertical", "travelled")
"""Columns of `sub_trajectory_errors`: metres in DS, degrees, degrees, metres, metres."""
MIN_DIRECTION_M = 1e-6
"""A horizontal displacement shorter than this has no direction: the rover's heading is taken."""


Quat = tuple[float, float, float, float]
Vector = tuple[float, float, float]


@jit
def _quat(rows: FloatArray, i: int) -> Quat:
    return rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]


@jit
def _difference(a: FloatArray, i: int, b: FloatArray, j: int) -> Vector:
    return a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]


@jit
def _conjugate(q: Quat) -> Quat:
    return -q[0], -q[1], -q[2], q[3]


@jit
def _product(a: Quat, b: Quat) -> Quat:
    """Return the Hamilton product `a b`, scalar last."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@jit
def _rotated(q: Quat, v: Vector) -> Vector:
    """Return `v` turned by the unit quaternion `q`."""
    x = 2.0 * (q[1] * v[2] - q[2] * v[1])
    y = 2.0 * (q[2] * v[0] - q[0] * v[2])
    z = 2.0 * (q[0] * v[1] - q[1] * v[0])
    return (
        v[0] + q[3] * x + q[1] * z - q[2] * y,
        v[1] + q[3] * y + q[2] * x - q[0] * z,
        v[2] + q[3] * z + q[0] * y - q[1] * x,
    )


@jit
def heading_rad(q: Quat) -> float:
    """Return the heading [4.2.3.3]: angle in DS from x to the projection of the RB x-axis; `q` has unit length."""
    return float(np.arctan2(2.0 * (q[0] * q[1] + q[2] * q[3]), 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])))


@jit
def wrapped_deg(angle: float) -> float:
    """Return an angle in degrees wrapped to (-180, 180]."""
    return float(angle - 360.0 * np.ceil((angle - 180.0) / 360.0))


@jit
def sub_trajectory_errors(
    start_gt_pos: FloatArray,
    start_gt_quat: FloatArray,
    start_est_pos: FloatArray,
    start_est_quat: FloatArray,
    start_lengths: FloatArray,
    starts: IntArray,
    end_gt_pos: FloatArray,
    end_gt_quat: FloatArray,
    end_est_pos: FloatArray,
    end_est_quat: FloatArray,
    end_lengths: FloatArray,
    ends: IntArray,
    whole_pose: bool,
) -> FloatArray:
    """Return the errors `(M, 9)` of sub-trajectories; `COLUMNS` names them.

    Row by row, so that the bits of a row do not depend on how many are computed at once.

    Args:
        start_gt_pos: `(K, 3)` true positions, metres, DS.
        start_gt_quat: `(K, 4)` unit quaternions, RB in DS.
        start_est_pos: `(K, 3)` estimated positions.
        start_est_quat: `(K, 4)` estimated attitudes.
        start_lengths: `(K, 2)` path lengths.
        starts: `(M,)` rows of the five above.
        end_gt_pos: `(L, 3)` as at the start.
        end_gt_quat: `(L, 4)`.
        end_est_pos: `(L, 3)`.
        end_est_quat: `(L, 4)`.
        end_lengths: `(L, 2)`.
        ends: `(M,)` rows of the five above.
        whole_pose: Re-base the whole pose; False for the position only.
    """
    out = np.empty((len(starts), 9))
    for m in range(len(starts)):
        i, j = starts[m], ends[m]
        true_move = _difference(end_gt_pos, j, start_gt_pos, i)
        move = _difference(end_est_pos, j, start_est_pos, i)
        attitude = _quat(end_est_quat, j)
        if whole_pose:
            correction = _product(_quat(start_gt_quat, i), _conjugate(_quat(start_est_quat, i)))
            move = _rotated(correction, move)
            attitude = _product(correction, attitude)
        error = (move[0] - true_move[0], move[1] - true_move[1], move[2] - true_move[2])
        turn = _product(_conjugate(_quat(end_gt_quat, j)), attitude)
        sine = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
        true_heading = heading_rad(_quat(end_gt_quat, j))
        horizontal = np.sqrt(true_move[0] * true_move[0] + true_move[1] * true_move[1])
        if horizontal >= MIN_DIRECTION_M:
            east, north = true_move[0] / horizontal, true_move[1] / horizontal
        else:
            east, north = np.cos(true_heading), np.sin(true_heading)
        out[m, 0], out[m, 1], out[m, 2] = error[0], error[1], error[2]
        out[m, 3] = np.degrees(2.0 * np.arctan2(sine, abs(turn[3])))
        out[m, 4] = wrapped_deg(np.degrees(heading_rad(attitude) - true_heading))
        out[m, 5] = error[0] * east + error[1] * north
        out[m, 6] = error[1] * east - error[0] * north
        out[m, 7] = error[2]
        out[m, 8] = (end_lengths[j, 0] - start_lengths[i, 0]) + (end_lengths[j, 1] - start_lengths[i, 1])
    return out

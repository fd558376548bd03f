"""Is the covariance honest? Normalised estimation error squared (NEES) of sub-trajectories, see docs/metrics.md.

Q, the covariance of the end given the start, comes from the steps between them. A step is the motion since the pose
before, with a covariance that is independent from step to step and a vector: one standard deviation of the error that
all steps have alike. Each pose has white noise N besides. An error of a pose moves what comes after it, by F of
`geometry.transform.propagation`, so with both sums taken to the origin of DS, C of `F S F^T` and G of `F g`, and W =
`F N F^T` likewise,

    Q(i, j) = F(p_j) (C_j - C_i + W_i + W_j + (G_j - G_i) (G_j - G_i)^T) F(p_j)^T

Where the steps are not known, Q is what the published covariance grew by, `P_end - F P_start F^T`; not usable where it
shrank, as when a calibration was learnt. Only sub-trajectories that share no frame are taken: they are independent.
The noise of the truth at both ends is added: `2 s^2` for positions, `s^2` for the attitude at the end and `F s^2 F^T`
for that at the start, which turns the displacement.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.quaternion_kernels import Quat, rotated, row_quat, unit_quats
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_multiply, quat_normalised, quat_rotate
from sfr_loc_map.geometry.small_linalg import copy_row
from sfr_loc_map.geometry.transform import propagated_covariance, propagation
from sfr_loc_map.inputs import LOST_VARIANCE
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.association import UPPER, Estimates, Frames, unique_rows
from sfr_loc_map.metrics.score import NeesPart, NeesScore
from sfr_loc_map.metrics.statistics import chi2_interval95

PARTS = (slice(0, 6), slice(0, 3), slice(3, 6))  #: Pose, position, attitude.
STEP_SIZE: Final = 48
"""Numbers of a step: upper triangle of its covariance, systematic errors, upper triangle of the noise of its pose."""
WITHOUT_NOISE: Final = 27  #: Of a step without the last of these.
SUMS_SIZE: Final = 109  #: Numbers of the sums up to a pose: C, G, count of unknown steps, W of the pose.
AXES: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def sums_of_steps(estimates: Estimates, steps: FloatArray, wanted: IntArray) -> dict[int, FloatArray]:
    """Return the sums `(109,)` of the steps `(E, 48)` of the estimates up to each that is wanted, by its row."""
    poses = estimates.trajectory
    rows = unique_rows(poses.stamps_ns)
    positions, quats = np.ascontiguousarray(poses.positions[rows]), unit_quats(poses.quats_xyzw[rows])
    wanted = wanted[np.argsort(poses.stamps_ns[wanted])]
    places = np.searchsorted(poses.stamps_ns[rows], poses.stamps_ns[wanted])
    sums = accumulated(steps[rows], estimates.lost[rows], positions, quats, places)
    return dict(zip(wanted.tolist(), sums, strict=True))


def nees_score(
    frames: Frames,
    covariances: FloatArray,
    sums: Mapping[int, FloatArray],
    starts: IntArray,
    ends: IntArray,
    truth_sigmas: tuple[float, float] = (0.0, 0.0),
) -> NeesScore | None:
    """Return the mean NEES of sub-trajectories from frames (going up) to frames, None where no covariance is known.

    The truth has standard deviations of position (m) and attitude (deg) along each axis.
    """
    of_position, of_attitude = truth_sigmas[0] ** 2, np.radians(truth_sigmas[1]) ** 2
    noise = np.diag([2.0 * of_position] * 3 + [of_attitude] * 3)
    totals = np.zeros(len(PARTS))
    count = from_steps = not_usable = free_from = 0
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if start < free_from:
            continue
        first, last = int(frames.est_rows[start]), int(frames.est_rows[end])
        before, after = matrices = np.empty((2, 6, 6))
        matrices[:, UPPER[0], UPPER[1]] = matrices[:, UPPER[1], UPPER[0]] = covariances[[first, last]]
        if not all(np.isfinite(matrix).all() and np.diag(matrix).max() < LOST_VARIANCE for matrix in matrices):
            continue
        free_from = end
        growth = relative_covariance(sums[first], sums[last], frames.est_pos[end]) if sums else None
        known = growth is not None
        if growth is None:
            growth = after - propagated_covariance(before, frames.est_pos[end] - frames.est_pos[start])
            growth = 0.5 * (growth + growth.T)
        if of_attitude or of_position:
            turned = np.diag([0.0] * 3 + [of_attitude] * 3)
            growth = growth + noise + propagated_covariance(turned, frames.est_pos[end] - frames.est_pos[start])
        error = relative_error(frames, start, end)
        try:
            whitened = [np.linalg.solve(np.linalg.cholesky(growth[part, part]), error[part]) for part in PARTS]
        except np.linalg.LinAlgError:
            not_usable += 1
            continue
        totals += [float(values @ values) for values in whitened]
        count += 1
        from_steps += known
    if not count and not not_usable:
        return None
    parts = {}
    for name, total, part in zip(("pose", "position", "attitude"), totals.tolist(), PARTS, strict=True):
        degrees, mean, interval, inside = part.stop - part.start, None, None, None
        if count:
            mean, interval = total / count, chi2_interval95(degrees * count, count)
            inside = interval[0] <= mean <= interval[1]
        parts[name] = NeesPart(mean=mean, expected=float(degrees), interval95=interval, consistent=inside)
    return NeesScore(count=count, not_usable=not_usable, from_steps=from_steps, **parts)


def relative_error(frames: Frames, start: int, end: int) -> FloatArray:
    """Return the error `(6,)` of position (m) and attitude (rad) over a sub-trajectory, in the estimate's DS."""
    to_estimate = quat_multiply(frames.est_quat[start], quat_conjugate(frames.gt_quat[start]))
    true_move = quat_rotate(to_estimate, frames.gt_pos[end] - frames.gt_pos[start])
    position = (frames.est_pos[end] - frames.est_pos[start]) - true_move
    true_quat = quat_multiply(to_estimate, frames.gt_quat[end])
    turn = quat_normalised(quat_multiply(frames.est_quat[end], quat_conjugate(true_quat)))
    turn = -turn if turn[3] < 0 else turn
    sine = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    scale = 2.0 if sine < 1e-9 else 2.0 * np.arctan2(sine, turn[3]) / sine
    return np.concatenate((position, scale * turn[:3]))


def relative_covariance(start: FloatArray, end: FloatArray, position: FloatArray) -> FloatArray | None:
    """Return the covariance `(6, 6)` of a pose at a position, from the sums at both; None where a step is unknown."""
    between = end - start
    if between[72] > 0.0:
        return None
    carried = propagation(position)
    systematic = carried @ between[36:72].reshape(6, 6)
    parts = between[:36] + start[73:] + end[73:]
    covariance = carried @ parts.reshape(6, 6) @ carried.T + systematic @ systematic.T
    return np.asarray(0.5 * (covariance + covariance.T))


@jit
def accumulated(
    steps: FloatArray, lost: Mask, positions: FloatArray, quats: FloatArray, wanted: IntArray
) -> FloatArray:
    """Return the sums `(W, 109)` at rows that go up, of steps `(N, 48)` to poses in the order of their stamps.

    Steps are NaN where not known; a lost pose repeats the one before and has none. Metres, DS; unit quaternions.
    """
    result, found = np.empty((len(wanted), SUMS_SIZE)), 0
    total, before = np.zeros(SUMS_SIZE), (0.0, 0.0, 0.0, 1.0)
    part, carried = np.empty((6, 6)), np.zeros((6, 6))
    for k in range(len(steps)):
        known = True
        for value in steps[k]:  # `.all()` would load the compiler's parts with the kernel
            known = known and np.isfinite(value)
        now = row_quat(quats, k)
        if not known and not lost[k]:
            total[72] += 1.0
        elif not lost[k]:
            _carry(before, positions[k], carried)
            _fill(part, steps[k], 0)
            _add(total, 0, carried, part)
            for i in range(6):
                for a in range(6):
                    total[36 + 6 * i + a] += carried[i, a] * steps[k, 21 + a]
        before = now
        if found < len(wanted) and wanted[found] == k:
            for i in range(73, len(total)):
                total[i] = 0.0
            if known and not lost[k]:
                _carry(now, positions[k], carried)
                _fill(part, steps[k], WITHOUT_NOISE)
                _add(total, 73, carried, part)
            copy_row(total, result[found])
            found += 1
    return result


@jit
def _carry(quat: Quat, position: FloatArray, carried: FloatArray) -> None:
    """Fill what takes an error at a position `(3,)`, in axes that a quaternion turns to DS, to the origin of DS."""
    x, y, z = position[0], position[1], position[2]
    for j in range(3):
        a, b, c = rotated(quat, AXES[j])
        carried[0, j], carried[1, j], carried[2, j] = a, b, c
        carried[3, j + 3], carried[4, j + 3], carried[5, j + 3] = a, b, c
        carried[0, j + 3], carried[1, j + 3], carried[2, j + 3] = y * c - z * b, z * a - x * c, x * b - y * a


@jit
def _fill(matrix: FloatArray, row: FloatArray, column: int) -> None:
    """Fill a symmetric matrix `(6, 6)` from its upper triangle in a row, from a column on."""
    for j in range(6):
        for i in range(j, 6):
            matrix[i, j] = matrix[j, i] = row[column]
            column += 1


@jit
def _add(total: FloatArray, first: int, carried: FloatArray, part: FloatArray) -> None:
    """Add `carried part carried^T` to the 36 totals from the first on."""
    for i in range(6):
        for j in range(6):
            value = 0.0
            for a in range(6):
                for b in range(6):
                    value += carried[i, a] * part[a, b] * carried[j, b]
            total[first + 6 * i + j] += value

"""Relative covariance of two estimated poses, from the covariances of the steps between them.

A step is the motion since the pose before, with a covariance that is independent from step to step and a vector: one
standard deviation of the error that all steps have alike. An error of a pose moves what comes after it, by F of
`geometry.transform.propagated_covariance`, so with both sums taken to the origin of DS, C of `F S F^T` and G of `F g`,

    Q(i, j) = F(p_j) (C_j - C_i + (G_j - G_i) (G_j - G_i)^T) F(p_j)^T

is the covariance of pose j given pose i. The sums take one addition a pose, whatever is compared later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.quaternion_kernels import Quat, rotated, row_quat
from sfr_loc_map.geometry.small_linalg import copy_row
from sfr_loc_map.geometry.transform import propagation
from sfr_loc_map.jit import jit, jit_inline

STEP_SIZE: Final = 27
"""Numbers of a step: upper triangle of its covariance, then the systematic vector."""
SUM_SIZE: Final = 43
"""Numbers of the sums: covariance, systematic vector, number of poses whose step is not known."""
AXES: Final = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class StepSums:
    """Sums up to a pose, and its attitude: where the sums of later poses begin.

    Attributes:
        sums: `(43,)` covariance, systematic vector, number of unknown steps.
        quat: `(4,)` of the pose.
    """

    sums: FloatArray
    quat: FloatArray

    @classmethod
    def none(cls) -> StepSums:
        """Return the sums before the first pose."""
        return cls(np.zeros(SUM_SIZE), np.array([0.0, 0.0, 0.0, 1.0]))


def accumulated(
    steps: FloatArray, lost: Mask, positions: FloatArray, quats: FloatArray, before: StepSums
) -> tuple[FloatArray, StepSums]:
    """Return the sums `(N, 43)` at poses in the order of their stamps, and where later ones begin.

    Args:
        steps: `(N, 27)` step to each, NaN where not known.
        lost: `(N,)` poses that repeat the one before: they have no step.
        positions: `(N, 3)` metres, DS.
        quats: `(N, 4)` of unit length.
        before: Sums of the poses before.
    """
    if not len(steps):
        return np.empty((0, SUM_SIZE)), before
    sums = _accumulate(steps, lost, positions, quats, before.sums, before.quat)
    return sums, StepSums(sums[-1].copy(), quats[-1].copy())


def unknown_sums(count: int) -> FloatArray:
    """Return sums `(N, 43)` of poses whose steps are not known."""
    return np.broadcast_to(np.nan, (count, SUM_SIZE))


def relative_covariance(start: FloatArray, end: FloatArray, position: FloatArray) -> FloatArray | None:
    """Return the covariance `(6, 6)` of a pose given another one, None where a step between is not known.

    Args:
        start: `(43,)` sums at the earlier pose.
        end: `(43,)` at the later one.
        position: `(3,)` of the later one.
    """
    between = end - start
    if np.isnan(between[42]) or between[42] > 0.0:
        return None
    carried = propagation(position)
    systematic = carried @ between[36:42]
    covariance = carried @ between[:36].reshape(6, 6) @ carried.T + np.outer(systematic, systematic)
    return np.asarray(0.5 * (covariance + covariance.T))


@jit
def _accumulate(
    steps: FloatArray, lost: Mask, positions: FloatArray, quats: FloatArray, sums: FloatArray, quat: FloatArray
) -> FloatArray:
    result = np.empty((len(steps), 43))
    total, before = sums.copy(), np.empty((1, 4))
    copy_row(quat, before[0])
    step, carried = np.empty((6, 6)), np.zeros((6, 6))
    for k in range(len(steps)):
        if not lost[k]:
            if _is_finite(steps, k):
                _unpack(steps, k, step)
                _to_origin(row_quat(before, 0), positions[k], carried)
                _add(total, carried, step, steps[k])
            else:
                total[42] += 1.0
        copy_row(quats[k], before[0])
        copy_row(total, result[k])
    return result


@jit_inline
def _is_finite(steps: FloatArray, k: int) -> bool:
    """Tell whether a row has finite values only; `.all()` would load the compiler's parts with the kernel."""
    for value in steps[k]:  # noqa: SIM110 - numba has no generators here
        if not np.isfinite(value):
            return False
    return True


@jit
def _unpack(steps: FloatArray, k: int, step: FloatArray) -> None:
    column = 0
    for i in range(6):
        for j in range(i, 6):
            step[i, j] = step[j, i] = steps[k, column]
            column += 1


@jit
def _to_origin(attitude: Quat, position: FloatArray, carried: FloatArray) -> None:
    """Write the matrix that takes an error at a position, in the axes of RB before, to the origin of DS."""
    x, y, z = position[0], position[1], position[2]
    for j in range(3):
        a, b, c = rotated(attitude, AXES[j])
        carried[0, j], carried[1, j], carried[2, j] = a, b, c
        carried[3, j + 3], carried[4, j + 3], carried[5, j + 3] = a, b, c
        carried[0, j + 3], carried[1, j + 3], carried[2, j + 3] = y * c - z * b, z * a - x * c, x * b - y * a


@jit
def _add(total: FloatArray, carried: FloatArray, step: FloatArray, row: FloatArray) -> None:
    for i in range(6):
        for j in range(6):
            value = 0.0
            for a in range(6):
                for b in range(6):
                    value += carried[i, a] * step[a, b] * carried[j, b]
            total[6 * i + j] += value
        systematic = 0.0
        for a in range(6):
            systematic += carried[i, a] * row[21 + a]
        total[36 + i] += systematic

"""The disagreement of estimate and truth, by which the hypotheses of a diagnosis are compared.

The disagreement of a sub-trajectory is `hypot(position error / path length, attitude error in radians)`. The estimate
is re-based by its complete pose, so that the disagreement does not depend on the world frame.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.formulas import pose_reading

MIN_POSES = 8  #: Minimum number of frames, because a sub-trajectory contains an eighth of the poses.
SUB_TRAJECTORIES = 400  #: Maximum number of sub-trajectories, which bounds the time of a diagnosis.
PoseArrays = tuple[FloatArray, FloatArray]  #: Positions `(N, 3)` and unit quaternions `(N, 4)`.


def disagreements(truth: PoseArrays, estimate: PoseArrays) -> FloatArray:
    """Return the disagreement of each sub-trajectory."""
    starts, ends = eighths(len(truth[0]))
    errors = pose_reading(formulas.Poses(*truth, *estimate), starts, ends)
    return disagreement_of(errors, path_lengths(truth[0][None], starts, ends)[0])


def disagreement_of(errors: formulas.SubTrajectoryErrors, lengths_m: FloatArray) -> FloatArray:
    """Return the disagreement of sub-trajectories with these errors and path lengths `(M,)`."""
    of_path = np.linalg.norm(errors.position_m, axis=1) / lengths_m
    return np.asarray(np.hypot(of_path, np.radians(errors.attitude_deg)))


def path_lengths(positions: FloatArray, starts: IntArray, ends: IntArray) -> FloatArray:
    """Return the path lengths `(K, M)` of the sub-trajectories of K paths `(K, N, 3)`, at least a tenth of the mean."""
    steps_m = np.linalg.norm(np.diff(positions, axis=1), axis=2)
    until_m = np.concatenate((np.zeros((len(positions), 1)), np.cumsum(steps_m, axis=1)), axis=1)
    lengths_m = until_m[:, ends] - until_m[:, starts]
    shortest_m = np.maximum(0.1 * lengths_m.mean(axis=1, keepdims=True), 1e-9)  # the rover may be stationary
    return np.asarray(np.maximum(lengths_m, shortest_m))


def eighths(count: int) -> tuple[IntArray, IntArray]:
    """Return starts and ends of sub-trajectories that contain an eighth of the poses each."""
    span = max(2, count // 8)
    starts = np.unique(np.linspace(0, count - 1 - span, SUB_TRAJECTORIES).astype(np.int64))
    return starts, starts + span

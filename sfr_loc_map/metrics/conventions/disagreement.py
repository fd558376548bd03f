"""The poses of estimate and truth that a diagnosis compares, and the disagreement of each sub-trajectory.

The disagreement of a sub-trajectory is `hypot(position error / path length, attitude error in radians)`. The estimate
is re-based by its complete pose, so that the disagreement does not depend on the world frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import unit_quats
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.formulas import pose_reading
from sfr_loc_map.metrics.frames.association import Rows, associate, taken, unique_rows

MAX_POSES = 20_000  #: Maximum number of estimates, which bounds the time of a diagnosis to about 0.1 s.
MIN_POSES = 8  #: Minimum number of frames, because a sub-trajectory contains an eighth of the poses.
SUB_TRAJECTORIES = 400  #: Maximum number of sub-trajectories, which bounds the time of a diagnosis.
PoseArrays = tuple[FloatArray, FloatArray]  #: Positions `(N, 3)` and unit quaternions `(N, 4)`.


class ComparedPoses(NamedTuple):
    """An estimate and a truth with attitudes, and their frames: the estimates that have a true pose."""

    estimate: Trajectory  #: In the order of the stamps, each stamp once.
    truth: Trajectory  #: In the order of the stamps, each stamp once.
    rows: Rows  #: Row of the estimate for each frame.
    true: PoseArrays  #: True poses of the frames.
    rig: StereoRig | None  #: Rig of the localisation cameras; None if it is unknown.

    @property
    def has_enough_frames(self) -> bool:
        """Whether the disagreement can be computed without an offset of the stamps."""
        return len(self.rows) >= MIN_POSES

    @property
    def found(self) -> PoseArrays:
        """Estimated poses of the frames."""
        return self.at_frames((self.estimate.positions, self.estimate.quats_xyzw))

    def at_frames(self, poses: PoseArrays) -> PoseArrays:
        """Return the poses of the frames, with unit quaternions, from poses of all estimates."""
        positions, quats = poses
        return taken(positions, self.rows), unit_quats(taken(quats, self.rows))


def compared_poses(
    estimate: Trajectory, truth: Trajectory, config: AssociationConfig, rig: StereoRig | None
) -> ComparedPoses:
    """Return the compared poses of an estimate and a truth that have attitudes. A long estimate is decimated."""
    estimate = _in_order(estimate, MAX_POSES)
    truth = _in_order(truth, len(truth))
    frames, _ = associate(estimate, truth, config)
    return ComparedPoses(estimate, truth, frames.estimate_rows, (frames.true_position, frames.true_attitude), rig)


def _in_order(poses: Trajectory, most: int) -> Trajectory:
    """Return the poses in the order of the stamps, each stamp once, decimated to at most `most` poses."""
    rows = unique_rows(poses.stamps_ns)
    rows = rows[:: max(math.ceil(len(rows) / max(most, 1)), 1)]
    return Trajectory(poses.stamps_ns[rows], poses.positions[rows], poses.quats_xyzw[rows])


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

"""The poses of estimate and truth that a diagnosis compares, and the disagreement of each sub-trajectory.

The disagreement of a sub-trajectory is `hypot(position error / path length, attitude error in radians)`. The estimate
is re-based by its complete pose, so that the disagreement does not depend on the world frame. If the truth has no
complete attitudes, the displacements of the estimate are rotated to the true ones by least squares, and the attitude
error is 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import unit_quats
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth, as_truth, at_point
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.formulas import pose_reading
from sfr_loc_map.metrics.frames.association import Rows, associate, taken, unique_rows
from sfr_loc_map.metrics.frames.true_attitudes import incomplete_attitudes

MAX_POSES = 20_000  #: Maximum number of estimates, which bounds the time of a diagnosis to about 0.1 s.
MIN_POSES = 8  #: Minimum number of frames, because a sub-trajectory contains an eighth of the poses.
SUB_TRAJECTORIES = 400  #: Maximum number of sub-trajectories, which bounds the time of a diagnosis.
ALIGNMENTS = 3  #: Number of fits of a rotation to displacements, each without the outliers of the previous fit.
OUTLIER = 3.0  #: Smallest error of a displacement that is an outlier of the alignment, as a multiple of the median.
PoseArrays = tuple[FloatArray, FloatArray]  #: Positions `(N, 3)` and unit quaternions `(N, 4)`.


class ComparedPoses(NamedTuple):
    """An estimate with attitudes and a truth, and their frames: the estimates that have a true pose."""

    estimate: Trajectory  #: In the order of the stamps, each stamp once; of the point whose true positions are known.
    truth: Truth  #: In the order of the stamps, each stamp once.
    rows: Rows  #: Row of the estimate for each frame.
    true: PoseArrays  #: True poses of the frames.
    rig: StereoRig | None  #: Rig of the localisation cameras; None if it is unknown.

    @property
    def has_enough_frames(self) -> bool:
        """Whether the disagreement can be computed without an offset of the stamps."""
        return len(self.rows) >= MIN_POSES

    @property
    def has_attitudes(self) -> bool:
        """Whether the true attitudes are complete; otherwise only positions are compared."""
        return incomplete_attitudes(self.truth) is None

    def disagreements(self, true: PoseArrays, found: PoseArrays) -> FloatArray:
        """Return the disagreement `(M,)` of each sub-trajectory of poses of the frames."""
        if self.has_attitudes:
            return disagreements(true, found)
        return np.asarray(disagreements_of_positions(true[0][None], found[0], has_height=self.truth.has_height)[0])

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
    """Return the compared poses of an estimate, which has attitudes, and a truth. A long estimate is decimated."""
    known = as_truth(truth)
    known = known.at_rows(_rows_in_order(known, len(known)))
    estimate = estimate.at_rows(_rows_in_order(estimate, MAX_POSES))
    estimate = estimate if known.has_attitude else at_point(estimate, known.lever_arm_m)
    frames, _ = associate(estimate, known, config)
    return ComparedPoses(estimate, known, frames.estimate_rows, (frames.true_position, frames.true_attitude), rig)


def _rows_in_order(poses: Trajectory, most: int) -> Rows:
    """Return the rows in the order of the stamps, each stamp once, decimated to at most `most` rows."""
    rows = unique_rows(poses.stamps_ns)
    return rows[:: max(math.ceil(len(rows) / max(most, 1)), 1)]


def disagreements(truth: PoseArrays, estimate: PoseArrays) -> FloatArray:
    """Return the disagreement of each sub-trajectory."""
    starts, ends = eighths(len(truth[0]))
    errors = pose_reading(formulas.Poses(*truth, *estimate), starts, ends)
    return disagreement_of(errors, path_lengths(truth[0][None], starts, ends)[0])


def disagreements_of_positions(true: FloatArray, found: FloatArray, *, has_height: bool) -> FloatArray:
    """Return the disagreement `(K, M)` of the sub-trajectories of positions `(N, 3)` with K true paths `(K, N, 3)`.

    The displacements are first rotated to those of each path (`aligned_moves`).
    """
    true_moves, moves = aligned_moves(true, found, has_height=has_height)
    path = true if has_height else true[..., :2]
    return np.asarray(np.linalg.norm(true_moves - moves, axis=2) / path_lengths(path, *eighths(len(found))))


def aligned_moves(true: FloatArray, found: FloatArray, *, has_height: bool) -> tuple[FloatArray, FloatArray]:
    """Return the displacements of K true paths `(K, N, 3)` and, rotated to them, those of positions `(N, 3)`.

    The results have the shape `(K, M, D)`. The rotation is fitted to the displacements by least squares (Kabsch 1976),
    and again without outliers. Without true heights, only the two horizontal components are compared.
    """
    dimensions = 3 if has_height else 2
    starts, ends = eighths(len(found))
    true_moves = (true[:, ends] - true[:, starts])[..., :dimensions]
    moves = np.broadcast_to((found[ends] - found[starts])[:, :dimensions], true_moves.shape)
    weights = np.ones(true_moves.shape[:2])
    for _ in range(ALIGNMENTS):
        u, _, vt = np.linalg.svd(np.swapaxes(true_moves, 1, 2) @ (weights[..., None] * moves))
        u[:, :, -1] *= np.sign(np.linalg.det(u @ vt))[:, None]
        aligned = moves @ np.swapaxes(u @ vt, 1, 2)
        errors_m = np.linalg.norm(true_moves - aligned, axis=2)
        weights = (errors_m <= OUTLIER * np.median(errors_m, axis=1, keepdims=True)).astype(np.float64)
    return true_moves, aligned


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

"""The poses of estimate and truth by which the hypotheses of a diagnosis are evaluated."""

from __future__ import annotations

import math
from typing import NamedTuple

from sfr_loc_map.geometry.rotation import unit_quats
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.diagnosis.disagreement import MIN_POSES, PoseArrays
from sfr_loc_map.metrics.frames.association import Rows, associate, taken, unique_rows

MAX_POSES = 20_000  #: Maximum number of estimates, which bounds the time of a diagnosis to about 0.1 s.


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
    """Return the compared poses of an estimate and a truth with attitudes. A long estimate is decimated."""
    estimate = _in_order(estimate, MAX_POSES)
    truth = _in_order(truth, len(truth))
    frames, _ = associate(estimate, truth, config)
    return ComparedPoses(estimate, truth, frames.estimate_rows, (frames.true_position, frames.true_attitude), rig)


def _in_order(poses: Trajectory, most: int) -> Trajectory:
    """Return the poses in the order of the stamps, each stamp once, decimated to at most `most` poses."""
    rows = unique_rows(poses.stamps_ns)
    rows = rows[:: max(math.ceil(len(rows) / max(most, 1)), 1)]
    return Trajectory(poses.stamps_ns[rows], poses.positions[rows], poses.quats_xyzw[rows])

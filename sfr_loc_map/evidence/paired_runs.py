"""Two runs over one recording at their common pairs: their poses, and the covariances of their motions.

Neither run is a ground truth. A backward run is returned in the order of the recording, so that all comparisons count
the frames in the same direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.evidence.variants import ComparedRun
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.rotation import unit_quats
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.errors.consistency import Span, StepSums, relative_covariance, sums_of_steps
from sfr_loc_map.metrics.frames.association import StampedPoses, associate

SPACING = 5  #: Number of frames between starts: half of the spacing of a score, for short recordings.


@dataclass(frozen=True, slots=True, eq=False)
class RunAtPairs:
    """A run, restricted to the pairs of another run, in the order of the recording. Frames are counted from 0."""

    run: ComparedRun
    rows: IntArray  #: Row of the estimates of the run for each frame.
    poses: StampedPoses

    @property
    def lost(self) -> Mask:
        """Whether the run is lost, for each frame."""
        return self.run.estimates.lost[self.rows]

    def sums_at(self, frames: IntArray) -> dict[int, StepSums]:
        """Return the sums of the steps up to frames, by frame; empty if the steps are unknown."""
        estimates = self.run.estimates
        if estimates.steps is None:
            return {}
        rows = self.rows[frames]
        sums = sums_of_steps(estimates, estimates.steps, rows)
        return {frame: sums[row] for frame, row in zip(frames.tolist(), rows.tolist(), strict=True)}

    def covariance_between(self, sums: dict[int, StepSums], start: int, end: int) -> FloatArray | None:
        """Return the covariance of the end given the start, in the axes of the run, without the errors of all steps.

        None if a step is unknown. The steps of a backward run give the covariance of the start given the end. The error
        of the end given the start is the negative of this error, propagated over the displacement.
        """
        position = self.poses.position
        if not self.run.is_backward:
            return random_covariance(sums[start], sums[end], position[end])
        reverse = random_covariance(sums[end], sums[start], position[start])
        return None if reverse is None else propagated_covariance(reverse, position[end] - position[start])


def paired(first: ComparedRun, other: ComparedRun) -> tuple[RunAtPairs, RunAtPairs]:
    """Return a forward run and another run at their common pairs, with the stamps of the other run."""
    frames, _ = associate(first.estimates.trajectory, as_forward(other), AssociationConfig(truth="match"))
    # `associate` calls its second argument the truth; here it is the other run
    rows_of_other = rows_at(other, frames.stamps_ns)
    return RunAtPairs(first, frames.estimate_rows, frames.estimate), RunAtPairs(other, rows_of_other, frames.truth)


def as_forward(run: ComparedRun) -> Trajectory:
    """Return the poses of a run at the stamps of the pairs, in forward order."""
    poses = run.estimates.trajectory
    if not run.is_backward:
        return poses
    return Trajectory(run.mirror_ns - poses.stamps_ns[::-1], poses.positions[::-1], poses.quats_xyzw[::-1])


def rows_at(run: ComparedRun, stamps_ns: IntArray) -> IntArray:
    """Return the rows of the estimates at the stamps of pairs."""
    return np.searchsorted(run.estimates.trajectory.stamps_ns, run.own_stamps(stamps_ns))


def poses_at(run: ComparedRun, rows: IntArray) -> StampedPoses:
    """Return the poses of a forward run that have the given row numbers."""
    poses = run.estimates.trajectory
    return StampedPoses(poses.stamps_ns[rows], poses.positions[rows], unit_quats(poses.quats_xyzw[rows]))


def random_covariance(start: StepSums, end: StepSums, position: FloatArray) -> FloatArray | None:
    """Return the covariance of the end given the start, without the errors that all steps share."""
    none = np.zeros_like(start.systematic)
    return relative_covariance(start._replace(systematic=none), end._replace(systematic=none), position)


def spans_of(starts: IntArray, ends: IntArray) -> list[Span]:
    """Return sub-trajectories as pairs of frames."""
    return list(zip(starts.tolist(), ends.tolist(), strict=True))

"""Two runs over one recording at their common pairs: differences of their motions, and the predicted covariances.

Neither run is a ground truth. A backward run is returned in the order of the recording, so that all comparisons count
the frames in the same direction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.evidence.localiser_runs import ComparedRun
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_quat, unit_quats
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.frames.association import StampedPoses
from sfr_loc_map.metrics.trajectory.consistency import (
    Span,
    StepSums,
    normalised_square,
    relative_covariance,
    relative_errors,
    sums_of_steps,
    without_overlap,
)
from sfr_loc_map.metrics.trajectory.trajectory_errors import select

SPACING = 5  #: Number of frames between starts: half of the spacing of a score, for short recordings.


@dataclass(frozen=True, slots=True, eq=False)
class RunAtPairs:
    """A run, restricted to the pairs of another run, in the order of the recording. Frames are counted from 0."""

    run: ComparedRun
    rows: IntArray  #: Row of the estimates of the run for each frame.
    poses: StampedPoses

    def is_tracked(self, start: int, end: int) -> bool:
        """Return whether no pose from one frame to another, both included, is lost or degraded.

        The covariance of a degraded pose is inflated and predicts no difference.
        """
        first, last = sorted((int(self.rows[start]), int(self.rows[end])))
        return not self.run.estimates.unreliable[first : last + 1].any()

    def sums_at(self, frames: IntArray) -> dict[int, StepSums]:
        """Return the sum of the steps up to each frame, by frame; empty if the steps are unknown."""
        estimates = self.run.estimates
        if estimates.steps is None:
            return {}
        rows = self.rows[frames]
        sums = sums_of_steps(estimates, estimates.steps, rows)
        return {frame: sums[row] for frame, row in zip(frames.tolist(), rows.tolist(), strict=True)}

    def covariance_between(self, sums: dict[int, StepSums], start: int, end: int) -> FloatArray | None:
        """Return the covariance of the end given the start, in the axes of the run, without errors common to all steps.

        None if a step is unknown. The steps of a backward run give the covariance of the start given the end. The error
        of the end given the start is the negative of this error, propagated over the displacement.
        """
        position = self.poses.position
        if not self.run.is_backward:
            return random_covariance(sums[start], sums[end], position[end])
        reverse = random_covariance(sums[end], sums[start], position[start])
        return None if reverse is None else propagated_covariance(reverse, position[end] - position[start])


class PairedRuns(NamedTuple):
    """Two runs at their common pairs, in the order of the recording; `ours` is not the backward run."""

    ours: RunAtPairs
    theirs: RunAtPairs

    def errors(self, starts: IntArray, ends: IntArray) -> FloatArray:
        """Return the differences `(n, 6)` over sub-trajectories: position, m, and attitude, rad, in axes of `ours`."""
        return relative_errors(self.ours.poses, self.theirs.poses, starts, ends)

    def squares(self, starts: IntArray, ends: IntArray) -> list[float]:
        """Return the normalised squares of the differences over sub-trajectories that do not overlap.

        Sub-trajectories with a lost or degraded pose, or with a covariance that is unknown or not usable, are skipped.
        """
        compared = np.unique(np.concatenate((starts, ends)))
        our_sums, their_sums = self.ours.sums_at(compared), self.theirs.sums_at(compared)
        if not our_sums or not their_sums:
            return []
        covariances: dict[Span, FloatArray] = {}
        for start, end in spans_of(starts, ends):
            if not self.ours.is_tracked(start, end) or not self.theirs.is_tracked(start, end):
                continue
            our_covariance = self.ours.covariance_between(our_sums, start, end)
            their_covariance = self.theirs.covariance_between(their_sums, start, end)
            if our_covariance is not None and their_covariance is not None:
                theirs_in_our_axes = in_axes_of(self.ours.poses, self.theirs.poses, start, their_covariance)
                covariances[start, end] = our_covariance + theirs_in_our_axes
        squares = []
        for start, end in without_overlap(covariances):
            (difference,) = self.errors(np.array([start]), np.array([end]))
            squares.append(normalised_square(difference, covariances[start, end]))
        return [square for square in squares if square is not None]


def paired(first: ComparedRun, other: ComparedRun) -> PairedRuns:
    """Return two runs at the pairs that both have, by exactly equal stamps of the pairs.

    `first` must not be the backward run.
    """
    _, rows, other_rows = np.intersect1d(first.pair_stamps_ns, other.pair_stamps_ns, return_indices=True)
    return PairedRuns(
        RunAtPairs(first, rows, poses_at(first, rows)), RunAtPairs(other, other_rows, poses_at(other, other_rows))
    )


def rows_at(run: ComparedRun, stamps_ns: IntArray) -> IntArray:
    """Return the rows of the estimates at the stamps of pairs; MetricsError if a pair has no estimate.

    `run` must not be the backward run.
    """
    known_ns = run.pair_stamps_ns
    rows = np.searchsorted(known_ns, stamps_ns)
    is_missing = known_ns[np.minimum(rows, len(known_ns) - 1)] != stamps_ns
    if is_missing.any():
        missing_ns = stamps_ns[is_missing][0]
        raise MetricsError(
            f"the run '{run.name}' has no pose at stamp {missing_ns} ns: a pose at each pair is required"
        )
    return rows


def poses_at(run: ComparedRun, rows: IntArray) -> StampedPoses:
    """Return the poses of a run in the given rows, with the stamps of their pairs."""
    poses = run.estimates.trajectory
    return StampedPoses(run.pair_stamps_ns[rows], poses.positions[rows], unit_quats(poses.quats_xyzw[rows]))


def in_axes_of(ours: StampedPoses, theirs: StampedPoses, start: int, covariance: FloatArray) -> FloatArray:
    """Return the covariance `(6, 6)` of a motion of `theirs` in axes of `ours`, by the attitudes at the start."""
    turn = matrix_from_quat(ours.attitude[start]) @ matrix_from_quat(theirs.attitude[start]).T
    return propagated_covariance(covariance, np.zeros(3), turn)


def random_covariance(start: StepSums, end: StepSums, position: FloatArray) -> FloatArray | None:
    """Return the covariance of the end pose given the start pose, without the errors that all steps share."""
    none = np.zeros_like(start.systematic)
    return relative_covariance(start._replace(systematic=none), end._replace(systematic=none), position)


def sub_trajectories_of(poses: StampedPoses, condition: Condition) -> tuple[IntArray, IntArray]:
    """Return the frames at which the sub-trajectories of a condition start, and those at which they end."""
    return select(condition, SPACING, poses, formulas.path_length_m(poses.position))


def spans_of(starts: IntArray, ends: IntArray) -> list[Span]:
    """Return sub-trajectories as pairs of frames."""
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def count_without_overlap(starts: IntArray, ends: IntArray) -> int:
    """Return the number of sub-trajectories that do not overlap."""
    return len(list(without_overlap(spans_of(starts, ends))))

"""Which estimate belongs to which truth: one to one, on integer nanoseconds.

Definitions (docs/metrics.md says why):

- Both are sorted by stamp, stably. Of several poses with one stamp the last given counts; the others are left out.
- `match`: an estimate belongs to the truth of the same stamp; an estimate left over to the nearest truth left over
  within the tolerance. Frames are the truth's poses that have an estimate.
- `interpolate`: as `match`, and an estimate still left over gets truth interpolated at its own stamp (position
  linearly, attitude along the shortest rotation) if the true poses around it are not farther apart than allowed.
- `auto`: looks at the first stamps, until both have 16 in their common span; `match` if a quarter of the rarer kind
  coincide, `interpolate` otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.constants import LOST_VARIANCE, NS_PER_S
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.quaternion_kernels import slerp, unit_quats
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.modes import AssociationMode
from sfr_loc_map.metrics.score import AssociationCounts
from sfr_loc_map.metrics.trajectory.relative_covariance import SUM_SIZE, StepSums, accumulated
from sfr_loc_map.metrics.trajectory.stamp_matching import (
    bracketed,
    count_unordered,
    decide_mode,
    match_stamps,
    tolerance_ns,
    unique_rows,
)

UPPER = np.triu_indices(6)
"""Places of the upper triangle of a 6 x 6 covariance, row by row."""
COVARIANCE_SIZE = len(UPPER[0])


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimated poses with what is known about each.

    Attributes:
        trajectory: Estimated poses of RB in DS, in any order.
        lost: `(N,)` bool, pose was repeated because the localiser was lost.
        degraded: `(N,)` bool, the localiser had a reason to doubt the pose.
        covariance: `(N, 21)` float64, upper triangle of the covariance, ROS order (m^2, rad^2), NaN where not known;
            None if it is known of none.
        steps: `(N, 27)` float64, step to each pose (see `relative_covariance`), NaN where not known; None if it is
            known of none.
        sums: `(N, 43)` float64, sums of the steps at the rows that were summed; None where there are none.
    """

    trajectory: Trajectory
    lost: Mask
    degraded: Mask
    covariance: FloatArray | None
    steps: FloatArray | None = None
    sums: FloatArray | None = None

    def summed(self, rows: NDArray[np.intp], before: StepSums) -> tuple[Estimates, StepSums]:
        """Return the estimates with the sums of their steps, and where later ones begin.

        Args:
            rows: Rows in the order of their stamps, without duplicates.
            before: Sums of the poses before.
        """
        if self.steps is None:
            return self, before
        quats = unit_quats(self.trajectory.quats_xyzw[rows])
        positions = np.ascontiguousarray(self.trajectory.positions[rows])
        found, after = accumulated(self.steps[rows], self.lost[rows], positions, quats, before)
        sums = np.full((len(self.trajectory), SUM_SIZE), np.nan)
        sums[rows] = found
        return replace(self, sums=sums), after

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        lost: Mask | None = None,
        degraded: Mask | None = None,
        covariance: FloatArray | None = None,
        steps: FloatArray | None = None,
    ) -> Estimates:
        """Return estimates, by default none of them lost or degraded and without covariances.

        Raises:
            MetricsError: If the numbers of rows differ.
        """
        count = len(trajectory)
        nowhere = np.zeros(count, np.bool_)
        lost, degraded = (nowhere if flags is None else np.asarray(flags, np.bool_) for flags in (lost, degraded))
        shape = (count, COVARIANCE_SIZE) if covariance is None else covariance.shape
        if {lost.shape, degraded.shape} != {(count,)} or shape != (count, COVARIANCE_SIZE):
            raise MetricsError(
                f"{count} estimates need as many flags and covariances of {COVARIANCE_SIZE} numbers: "
                f"got {lost.shape}, {degraded.shape} and {shape}"
            )
        return cls(trajectory, lost, degraded, covariance, steps)


def lost_by_covariance(covariance: FloatArray) -> Mask:
    """Tell for which covariances `(N, 21)` the pose is not known: 9999 on the whole diagonal."""
    diagonal = np.flatnonzero(UPPER[0] == UPPER[1])
    return np.asarray((covariance[:, diagonal] >= LOST_VARIANCE).all(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Estimated and true poses side by side, in time order; quaternions are of unit length.

    Attributes:
        stamps_ns: `(N,)` int64, of the truth, or of the estimate where the truth is interpolated.
        gt_pos: `(N, 3)` float64, metres, DS.
        gt_quat: `(N, 4)` float64, RB in DS, scalar last.
        est_pos: `(N, 3)` float64, metres, DS.
        est_quat: `(N, 4)` float64.
        lost: `(N,)` bool.
        degraded: `(N,)` bool.
        covariance: `(N, 21)` float64, or None.
        sums: `(N, 43)` float64, sums of the steps up to each estimate, or None.
    """

    stamps_ns: IntArray
    gt_pos: FloatArray
    gt_quat: FloatArray
    est_pos: FloatArray
    est_quat: FloatArray
    lost: Mask
    degraded: Mask
    covariance: FloatArray | None
    sums: FloatArray | None

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.stamps_ns)

    def rows(self, which: slice | NDArray[np.intp]) -> Frames:
        """Return some of the frames."""
        return Frames(
            self.stamps_ns[which],
            self.gt_pos[which],
            self.gt_quat[which],
            self.est_pos[which],
            self.est_quat[which],
            self.lost[which],
            self.degraded[which],
            None if self.covariance is None else self.covariance[which],
            None if self.sums is None else self.sums[which],
        )


def associate(
    estimates: Estimates, truth: Trajectory, config: AssociationConfig
) -> tuple[Frames, AssociationCounts, AssociationMode]:
    """Return the frames, what became of every pose, and how it was done: match or interpolate."""
    portions, counts, mode = associate_in_portions(estimates, truth, config, max(len(estimates.trajectory), 1))
    return next(portions), counts, mode


def associate_in_portions(
    estimates: Estimates, truth: Trajectory, config: AssociationConfig, size: int
) -> tuple[Iterator[Frames], AssociationCounts, AssociationMode]:
    """Return the same with the frames in portions of a size, at least one; each is made when it is asked for."""
    est_rows, gt_rows = unique_rows(estimates.trajectory.stamps_ns), unique_rows(truth.stamps_ns)
    stamps = estimates.trajectory.stamps_ns[est_rows], truth.stamps_ns[gt_rows]
    mode = decide_mode(*stamps, config)
    estimates, _ = estimates.summed(est_rows, StepSums.none())
    given = AssociationCounts(
        estimate_poses=len(estimates.trajectory),
        truth_poses=len(truth),
        estimate_duplicates=len(estimates.trajectory) - len(est_rows),
        truth_duplicates=len(truth) - len(gt_rows),
        estimate_unordered=count_unordered(estimates.trajectory.stamps_ns),
        truth_unordered=count_unordered(truth.stamps_ns),
    )
    if mode is AssociationMode.INTERPOLATE:
        frames, counts = join(estimates, est_rows, truth, gt_rows, config, mode)
        return (frames.rows(part) for part in _parts(len(frames), size)), counts + given, mode
    est, gt = _rows_of(match_stamps(*stamps, tolerance_ns(config)), est_rows, gt_rows)
    counts = _counts(estimates, est, truth, gt)
    portions = (_side_by_side(estimates, est[part], truth, gt[part]) for part in _parts(len(est), size))
    return portions, counts + given, mode


def _parts(count: int, size: int) -> list[slice]:
    return [slice(first, first + size) for first in range(0, max(count, 1), size)]


def join(
    estimates: Estimates,
    est_rows: NDArray[np.intp],
    truth: Trajectory,
    gt_rows: NDArray[np.intp],
    config: AssociationConfig,
    mode: AssociationMode,
) -> tuple[Frames, AssociationCounts]:
    """Return the frames of rows that are in order and without duplicates; counts of the frames only."""
    est_stamps, gt_stamps = estimates.trajectory.stamps_ns[est_rows], truth.stamps_ns[gt_rows]
    partner = match_stamps(est_stamps, gt_stamps, tolerance_ns(config))
    est, gt = _rows_of(partner, est_rows, gt_rows)
    frames, counts = _side_by_side(estimates, est, truth, gt), _counts(estimates, est, truth, gt)
    if mode is AssociationMode.INTERPOLATE:
        between, after = bracketed(est_stamps, gt_stamps, partner, round(config.max_gap_s * NS_PER_S))
        rows = gt_rows[after - 1], gt_rows[after]
        frames = _merge(frames, _interpolated(estimates, est_rows[between], truth, *rows))
        gaps = truth.stamps_ns[rows[1]] - truth.stamps_ns[rows[0]]
        lost, degraded = (int(np.count_nonzero(flags)) for flags in (frames.lost, frames.degraded))
        counts = replace(counts, interpolated=len(between), lost=lost, degraded=degraded)
        counts = replace(counts, largest_gap_ns=int(gaps.max(initial=0)))
    return frames, counts


def _rows_of(
    partner: NDArray[np.intp], est_rows: NDArray[np.intp], gt_rows: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of the estimates that have a partner, and of their partners."""
    matched = np.flatnonzero(partner >= 0)
    return est_rows[matched], gt_rows[partner[matched]]


def _counts(
    estimates: Estimates, est_rows: NDArray[np.intp], truth: Trajectory, gt_rows: NDArray[np.intp]
) -> AssociationCounts:
    """Return the counts of rows that belong together."""
    difference = np.abs(estimates.trajectory.stamps_ns[est_rows] - truth.stamps_ns[gt_rows])
    return AssociationCounts(
        exact=int(np.count_nonzero(difference == 0)),
        near=int(np.count_nonzero(difference)),
        largest_difference_ns=int(difference.max(initial=0)),
        lost=int(np.count_nonzero(estimates.lost[est_rows])),
        degraded=int(np.count_nonzero(estimates.degraded[est_rows])),
    )


def _side_by_side(
    estimates: Estimates, est_rows: NDArray[np.intp], truth: Trajectory, gt_rows: NDArray[np.intp]
) -> Frames:
    est, of_est, of_gt = estimates.trajectory, _span_or(est_rows), _span_or(gt_rows)
    return Frames(
        truth.stamps_ns[of_gt],
        truth.positions[of_gt],
        unit_quats(truth.quats_xyzw[of_gt]),
        est.positions[of_est],
        unit_quats(est.quats_xyzw[of_est]),
        estimates.lost[of_est],
        estimates.degraded[of_est],
        None if estimates.covariance is None else estimates.covariance[of_est],
        None if estimates.sums is None else estimates.sums[of_est],
    )


def _span_or(rows: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Return rows; those that follow each other as a slice, for which nothing is copied."""
    first = int(rows[0]) if len(rows) else 0
    span = slice(first, first + len(rows))
    return span if np.array_equal(rows, np.arange(span.start, span.stop)) else rows


def _interpolated(
    estimates: Estimates,
    est_rows: NDArray[np.intp],
    truth: Trajectory,
    before: NDArray[np.intp],
    after: NDArray[np.intp],
) -> Frames:
    stamps = estimates.trajectory.stamps_ns[est_rows]
    frames = _side_by_side(estimates, est_rows, truth, before)
    step = truth.stamps_ns[after] - truth.stamps_ns[before]
    share = (stamps - truth.stamps_ns[before]) / step
    positions = truth.positions[before] + share[:, None] * (truth.positions[after] - truth.positions[before])
    quats = slerp(frames.gt_quat, unit_quats(truth.quats_xyzw[after]), share)
    return replace(frames, stamps_ns=stamps, gt_pos=positions, gt_quat=quats)


def _merge(first: Frames, second: Frames) -> Frames:
    covariances, sums = (
        [values for frames in (first, second) if (values := getattr(frames, name)) is not None]
        for name in ("covariance", "sums")
    )
    both = Frames(
        np.concatenate((first.stamps_ns, second.stamps_ns)),
        np.concatenate((first.gt_pos, second.gt_pos)),
        np.concatenate((first.gt_quat, second.gt_quat)),
        np.concatenate((first.est_pos, second.est_pos)),
        np.concatenate((first.est_quat, second.est_quat)),
        np.concatenate((first.lost, second.lost)),
        np.concatenate((first.degraded, second.degraded)),
        np.concatenate(covariances) if covariances else None,
        np.concatenate(sums) if sums else None,
    )
    return both.rows(np.argsort(both.stamps_ns, kind="stable"))

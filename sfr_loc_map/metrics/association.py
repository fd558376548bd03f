"""Which estimate belongs to which truth: one to one, on integer nanoseconds.

docs/metrics.md, "From poses to frames", says what `match`, `interpolate` and `auto` mean, and why.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.rotation import slerp, unit_quats
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import LOST_VARIANCE, NS_PER_S
from sfr_loc_map.metrics.config import AssociationConfig, AssociationMode
from sfr_loc_map.metrics.score import Association

Rows = NDArray[np.intp]
Number = TypeVar("Number", bound=np.generic)
UPPER = np.triu_indices(6)  #: Places of the upper triangle of a 6 x 6 covariance, row by row.
COVARIANCE_SIZE = len(UPPER[0])
AUTO_STAMPS = 16  #: Stamps of each kind in the common span that `auto` looks at.


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimated poses with what is known about each."""

    trajectory: Trajectory  #: Estimated poses of RB in DS, in any order.
    lost: Mask  #: `(N,)` bool, pose was repeated because the localiser was lost.
    degraded: Mask  #: `(N,)` bool, the localiser had a reason to doubt the pose.
    #: `(N, 21)` float64, upper triangle, ROS order (m^2, rad^2), NaN where not known; None if known of none.
    covariance: FloatArray | None
    #: `(N, 48)` float64, step to each pose (see `metrics.consistency`), alike.
    steps: FloatArray | None = None

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        lost: Mask | None = None,
        degraded: Mask | None = None,
        covariance: FloatArray | None = None,
        steps: FloatArray | None = None,
    ) -> Estimates:
        """Return estimates, by default none of them lost or degraded and without covariances."""
        nowhere = np.zeros(len(trajectory), np.bool_)
        lost, degraded = (nowhere if flags is None else np.asarray(flags, np.bool_) for flags in (lost, degraded))
        return cls(trajectory, lost, degraded, covariance, steps)


def lost_by_covariance(covariance: FloatArray) -> Mask:
    """Tell for which covariances `(N, 21)` the pose is not known: 9999 on the whole diagonal."""
    return np.asarray((covariance[:, UPPER[0] == UPPER[1]] >= LOST_VARIANCE).all(axis=1))


class Frames(NamedTuple):
    """Estimated and true poses side by side, in time order; metres, DS; unit quaternions; which estimate each is."""

    stamps_ns: IntArray
    gt_pos: FloatArray
    gt_quat: FloatArray
    est_pos: FloatArray
    est_quat: FloatArray
    est_rows: Rows


def associate(estimate: Trajectory, truth: Trajectory, config: AssociationConfig) -> tuple[Frames, Association]:
    """Return the frames, and how they were found: by which mode, and what became of every pose.

    MetricsError for an estimate without attitudes.
    """
    if not estimate.has_attitude:
        raise MetricsError("the estimate has positions alone: give one with attitudes (unit quaternions)")
    both = estimate.stamps_ns, truth.stamps_ns
    est_rows, gt_rows = map(unique_rows, both)
    est_stamps, gt_stamps = map(taken, both, (est_rows, gt_rows))
    tolerance = round(config.tolerance_s * NS_PER_S)
    mode = AssociationMode(config.truth)
    if mode is AssociationMode.AUTO:
        mode, first_of = AssociationMode.MATCH, AUTO_STAMPS - 1
        low = max(est_stamps[0], gt_stamps[0]) - tolerance if len(est_stamps) and len(gt_stamps) else 0
        est, gt = est_stamps[est_stamps >= low], gt_stamps[gt_stamps >= low]
        if len(est) and len(gt):
            until = max(est[min(first_of, len(est) - 1)], gt[min(first_of, len(gt) - 1)])
            until = min(until, est[-1], gt[-1]) + tolerance
            est, gt = est[est <= until], gt[gt <= until]  # one is empty if its stamps lie between two of the other
            near = np.searchsorted(gt, est - tolerance, "left") < np.searchsorted(gt, est + tolerance, "right")
            if not len(est) or not len(gt) or 4 * np.count_nonzero(near) < min(len(est), len(gt)):
                mode = AssociationMode.INTERPOLATE
    partner = np.full(len(est_stamps), -1, dtype=np.intp)
    if len(gt_stamps):
        at = np.minimum(np.searchsorted(gt_stamps, est_stamps), len(gt_stamps) - 1)
        equal = gt_stamps[at] == est_stamps
        partner[equal] = at[equal]
    if tolerance and np.count_nonzero(partner >= 0) < min(len(est_stamps), len(gt_stamps)):
        match_nearest(partner, est_stamps, gt_stamps, tolerance)
    matched = np.flatnonzero(partner >= 0)
    est, gt = est_rows[matched], gt_rows[partner[matched]]
    stamps, positions = taken(truth.stamps_ns, gt), taken(truth.positions, gt)
    quats = unit_quats(taken(truth.quats_xyzw, gt))
    difference = np.abs(taken(estimate.stamps_ns, est) - stamps)
    gaps = np.empty(0, np.int64)
    if mode is AssociationMode.INTERPOLATE:  # those left over between two true poses that are not too far apart
        alone = np.flatnonzero(partner < 0)
        after = np.searchsorted(gt_stamps, est_stamps[alone])
        inside = (after > 0) & (after < len(gt_stamps))
        alone, after = alone[inside], after[inside]
        near = gt_stamps[after] - gt_stamps[after - 1] <= round(config.max_gap_s * NS_PER_S)
        alone, before, later = est_rows[alone[near]], gt_rows[after[near] - 1], gt_rows[after[near]]
        gaps = truth.stamps_ns[later] - truth.stamps_ns[before]
        share = (estimate.stamps_ns[alone] - truth.stamps_ns[before]) / gaps
        move = truth.positions[later] - truth.positions[before]
        turned = slerp(unit_quats(truth.quats_xyzw[before]), unit_quats(truth.quats_xyzw[later]), share)
        stamps = np.concatenate((stamps, estimate.stamps_ns[alone]))
        positions = np.concatenate((positions, truth.positions[before] + share[:, None] * move))
        quats, est = np.concatenate((quats, turned)), np.concatenate((est, alone))
        order = np.argsort(stamps, kind="stable")
        stamps, positions, quats, est = stamps[order], positions[order], quats[order], est[order]
    unordered = [int(np.count_nonzero(each[1:] < np.maximum.accumulate(each)[:-1])) for each in both]
    association = Association(
        matched=len(est),
        estimate_poses=len(both[0]),
        truth_poses=len(both[1]),
        estimate_duplicates=len(both[0]) - len(est_rows),
        truth_duplicates=len(both[1]) - len(gt_rows),
        estimate_unordered=unordered[0],
        truth_unordered=unordered[1],
        exact=int(np.count_nonzero(difference == 0)),
        near=int(np.count_nonzero(difference)),
        interpolated=len(gaps),
        largest_difference_ns=int(difference.max(initial=0)),
        largest_gap_ns=int(gaps.max(initial=0)),
        mode=mode,
        tolerance_s=config.tolerance_s,
        max_gap_s=config.max_gap_s,
    )
    est_quat = unit_quats(taken(estimate.quats_xyzw, est))
    return Frames(stamps, positions, quats, taken(estimate.positions, est), est_quat, est), association


def unique_rows(stamps_ns: IntArray) -> Rows:
    """Return the rows in order of their stamps; of rows with one stamp the last."""
    if (stamps_ns[1:] > stamps_ns[:-1]).all():
        return np.arange(len(stamps_ns))
    return len(stamps_ns) - 1 - np.unique(stamps_ns[::-1], return_index=True)[1]


def taken(values: NDArray[Number], rows: Rows) -> NDArray[Number]:
    """Return rows of values, none of them twice; the values themselves where these are all in their order."""
    if len(rows) < len(values) or not (rows[1:] > rows[:-1]).all():
        return values[rows]
    return values


def match_nearest(partner: Rows, est_stamps: IntArray, gt_stamps: IntArray, tolerance: int) -> None:
    """Give estimates without a partner (-1) the nearest truth left over, each truth once; of equals the earlier."""
    free_est = np.flatnonzero(partner < 0)
    free_gt = np.setdiff1d(np.arange(len(gt_stamps)), partner, assume_unique=True)
    nearest, difference = nearest_stamps(est_stamps[free_est], gt_stamps[free_gt])
    candidates = np.flatnonzero(difference <= tolerance)
    candidates = candidates[np.argsort(difference[candidates], kind="stable")]
    _, first = np.unique(nearest[candidates], return_index=True)
    chosen = candidates[first]
    partner[free_est[chosen]] = free_gt[nearest[chosen]]


def nearest_stamps(stamps: IntArray, among: IntArray) -> tuple[Rows, IntArray]:
    """Return for each stamp the index of the nearest of `among` (sorted, not empty; the earlier of two) and how far."""
    after = np.minimum(np.searchsorted(among, stamps), len(among) - 1)
    before = np.maximum(after - 1, 0)
    to_before, to_after = np.abs(stamps - among[before]), np.abs(among[after] - stamps)
    return np.where(to_before <= to_after, before, after), np.minimum(to_before, to_after)

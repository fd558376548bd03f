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

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.jit import jit
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.score import AssociationCounts

AUTO_STAMPS = 16
"""Stamps of each kind in the common span that `auto` looks at."""
COVARIANCE_SIZE = 21
"""Numbers of the upper triangle of a 6 x 6 covariance, row by row."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimated poses with what is known about each.

    Attributes:
        trajectory: Estimated poses of RB in DS, in any order.
        lost: `(N,)` bool, pose was repeated because the localiser was lost.
        covariance: `(N, 21)` float64, upper triangle of the covariance, ROS order (m^2, rad^2), NaN where not known;
            None if it is known of none.
    """

    trajectory: Trajectory
    lost: NDArray[np.bool_]
    covariance: FloatArray | None

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        lost: NDArray[np.bool_] | None = None,
        covariance: FloatArray | None = None,
    ) -> Estimates:
        """Return estimates, by default none of them lost and without covariances.

        Raises:
            MetricsError: If the numbers of rows differ.
        """
        count = len(trajectory)
        lost = np.zeros(count, np.bool_) if lost is None else np.asarray(lost, np.bool_)
        shape = (count, COVARIANCE_SIZE) if covariance is None else covariance.shape
        if lost.shape != (count,) or shape != (count, COVARIANCE_SIZE):
            raise MetricsError(
                f"{count} estimates need as many lost flags and covariances of {COVARIANCE_SIZE} numbers: "
                f"got {lost.shape} and {shape}"
            )
        return cls(trajectory, lost, covariance)


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
        covariance: `(N, 21)` float64, or None.
    """

    stamps_ns: IntArray
    gt_pos: FloatArray
    gt_quat: FloatArray
    est_pos: FloatArray
    est_quat: FloatArray
    lost: NDArray[np.bool_]
    covariance: FloatArray | None

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.stamps_ns)

    def rows(self, which: slice | NDArray[np.intp]) -> Frames:
        """Return some of the frames."""
        arrays: list[Any] = [getattr(self, item.name) for item in fields(self)]
        chosen: list[Any] = [None if array is None else array[which] for array in arrays]
        return Frames(*chosen)


def associate(
    estimates: Estimates, truth: Trajectory, config: AssociationConfig
) -> tuple[Frames, AssociationCounts, str]:
    """Return the frames, what became of every pose, and the way it was done (`match` or `interpolate`)."""
    est_rows = unique_rows(estimates.trajectory.stamps_ns)
    gt_rows = unique_rows(truth.stamps_ns)
    est_stamps, gt_stamps = estimates.trajectory.stamps_ns[est_rows], truth.stamps_ns[gt_rows]
    way = decide_way(est_stamps, gt_stamps, config)
    frames, counts = join(estimates, est_rows, truth, gt_rows, config, way)
    given = AssociationCounts(
        estimate_poses=len(estimates.trajectory),
        truth_poses=len(truth),
        estimate_duplicates=len(estimates.trajectory) - len(est_rows),
        truth_duplicates=len(truth) - len(gt_rows),
        estimate_unordered=count_unordered(estimates.trajectory.stamps_ns),
        truth_unordered=count_unordered(truth.stamps_ns),
    )
    return frames, counts + given, way


def unique_rows(stamps_ns: IntArray) -> NDArray[np.intp]:
    """Return the rows in order of their stamps; of rows with one stamp the last."""
    if len(stamps_ns) > 1 and not np.all(stamps_ns[1:] > stamps_ns[:-1]):
        order = np.argsort(stamps_ns, kind="stable")
        ordered = stamps_ns[order]
        return np.asarray(order[np.append(ordered[1:] != ordered[:-1], True)])
    return np.arange(len(stamps_ns), dtype=np.intp)


def count_unordered(stamps_ns: IntArray) -> int:
    """Return how many stamps are earlier than one before them."""
    if len(stamps_ns) < 2:
        return 0
    return int(np.count_nonzero(stamps_ns[1:] < np.maximum.accumulate(stamps_ns)[:-1]))


def decide_way(est_stamps: IntArray, gt_stamps: IntArray, config: AssociationConfig) -> str:
    """Return `match` or `interpolate` from stamps in order and without duplicates."""
    if config.truth != "auto":
        return config.truth
    if not len(est_stamps) or not len(gt_stamps):
        return "match"
    low = max(est_stamps[0], gt_stamps[0]) - tolerance_ns(config)
    est, gt = est_stamps[np.searchsorted(est_stamps, low) :], gt_stamps[np.searchsorted(gt_stamps, low) :]
    if not len(est) or not len(gt):
        return "match"
    until = max(est[min(AUTO_STAMPS, len(est)) - 1], gt[min(AUTO_STAMPS, len(gt)) - 1])
    until = min(until, est[-1], gt[-1]) + tolerance_ns(config)
    est, gt = est[est <= until], gt[gt <= until]
    together = np.count_nonzero(_nearest(est, gt)[1] <= tolerance_ns(config))
    return "match" if 4 * together >= min(len(est), len(gt)) else "interpolate"


def tolerance_ns(config: AssociationConfig) -> int:
    """Return the tolerance in nanoseconds."""
    return round(config.tolerance_s * NS_PER_S)


def join(
    estimates: Estimates,
    est_rows: NDArray[np.intp],
    truth: Trajectory,
    gt_rows: NDArray[np.intp],
    config: AssociationConfig,
    way: str,
) -> tuple[Frames, AssociationCounts]:
    """Return the frames of rows that are in order and without duplicates; counts of the frames only."""
    est_stamps, gt_stamps = estimates.trajectory.stamps_ns[est_rows], truth.stamps_ns[gt_rows]
    partner = match_stamps(est_stamps, gt_stamps, tolerance_ns(config))
    matched = np.flatnonzero(partner >= 0)
    difference = np.abs(est_stamps[matched] - gt_stamps[partner[matched]])
    frames = _side_by_side(estimates, est_rows[matched], truth, gt_rows[partner[matched]])
    counts = AssociationCounts(
        exact=int(np.count_nonzero(difference == 0)),
        near=int(np.count_nonzero(difference)),
        largest_difference_ns=int(difference.max(initial=0)),
    )
    if way == "interpolate":
        between, after = _bracketed(est_stamps, gt_stamps, partner, round(config.max_gap_s * NS_PER_S))
        rows = gt_rows[after - 1], gt_rows[after]
        frames = _merge(frames, _interpolated(estimates, est_rows[between], truth, *rows))
        gaps = truth.stamps_ns[rows[1]] - truth.stamps_ns[rows[0]]
        counts = replace(counts, interpolated=len(between), largest_gap_ns=int(gaps.max(initial=0)))
    return frames, replace(counts, lost=int(np.count_nonzero(frames.lost)))


def match_stamps(est_stamps: IntArray, gt_stamps: IntArray, tolerance: int) -> NDArray[np.intp]:
    """Return for each estimate the index of its truth, or -1; each truth is used once.

    Equal stamps first; then each estimate left over asks for the nearest truth left over (the earlier of two), and of
    several that ask for one truth the nearest (the earliest of equals) gets it.
    """
    partner = np.full(len(est_stamps), -1, dtype=np.intp)
    if not len(est_stamps) or not len(gt_stamps):
        return partner
    place = np.minimum(np.searchsorted(gt_stamps, est_stamps), len(gt_stamps) - 1)
    equal = gt_stamps[place] == est_stamps
    partner[equal] = place[equal]
    free_est = np.flatnonzero(~equal)
    free_gt = np.setdiff1d(np.arange(len(gt_stamps)), place[equal], assume_unique=True) if len(free_est) else free_est
    if tolerance and len(free_est) and len(free_gt):
        nearest, difference = _nearest(est_stamps[free_est], gt_stamps[free_gt])
        asking = np.flatnonzero(difference <= tolerance)
        asking = asking[np.argsort(difference[asking], kind="stable")]
        _, first = np.unique(nearest[asking], return_index=True)
        chosen = asking[first]
        partner[free_est[chosen]] = free_gt[nearest[chosen]]
    return partner


def _nearest(stamps: IntArray, among: IntArray) -> tuple[NDArray[np.intp], IntArray]:
    """Return the index of the nearest of `among` (sorted, not empty) for each stamp, and the distance."""
    after = np.minimum(np.searchsorted(among, stamps), len(among) - 1)
    before = np.maximum(after - 1, 0)
    to_before, to_after = np.abs(stamps - among[before]), np.abs(among[after] - stamps)
    return np.where(to_before <= to_after, before, after), np.minimum(to_before, to_after)


def _bracketed(
    est_stamps: IntArray, gt_stamps: IntArray, partner: NDArray[np.intp], max_gap: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the estimates that lie between two true poses near enough, and the index of the later of the two."""
    left_over = np.flatnonzero(partner < 0)
    after = np.searchsorted(gt_stamps, est_stamps[left_over])
    inside = (after > 0) & (after < len(gt_stamps))
    left_over, after = left_over[inside], after[inside]
    near = gt_stamps[after] - gt_stamps[after - 1] <= max_gap
    return left_over[near], after[near]


def _side_by_side(
    estimates: Estimates, est_rows: NDArray[np.intp], truth: Trajectory, gt_rows: NDArray[np.intp]
) -> Frames:
    est = estimates.trajectory
    return Frames(
        truth.stamps_ns[gt_rows],
        truth.positions[gt_rows],
        unit_quats(truth.quats_xyzw[gt_rows]),
        est.positions[est_rows],
        unit_quats(est.quats_xyzw[est_rows]),
        estimates.lost[est_rows],
        None if estimates.covariance is None else estimates.covariance[est_rows],
    )


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
    pairs = [(getattr(first, item.name), getattr(second, item.name)) for item in fields(first)]
    arrays: list[Any] = [None if a is None else np.concatenate((a, b)) for a, b in pairs]
    both = Frames(*arrays)
    return both.rows(np.argsort(both.stamps_ns, kind="stable"))


@jit
def unit_quats(quats: FloatArray) -> FloatArray:
    """Return quaternions `(N, 4)` of unit length; row by row, so that a row's bits do not depend on its neighbours."""
    out = np.empty((len(quats), 4))
    for i in range(len(quats)):
        x, y, z, w = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = x / norm, y / norm, z / norm, w / norm
    return out


@jit
def slerp(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Return unit quaternions on the shortest way from `a` to `b` (Shoemake 1985).

    Args:
        a: `(N, 4)` unit quaternions.
        b: `(N, 4)` unit quaternions.
        share: `(N,)`, 0 at `a`, 1 at `b`.
    """
    out = np.empty((len(a), 4))
    for i in range(len(a)):
        dot = a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2] + a[i, 3] * b[i, 3]
        sign = -1.0 if dot < 0.0 else 1.0
        minus, plus = 0.0, 0.0
        for k in range(4):
            minus += (a[i, k] - sign * b[i, k]) ** 2
            plus += (a[i, k] + sign * b[i, k]) ** 2
        angle = 2.0 * np.arctan2(np.sqrt(minus), np.sqrt(plus))
        sine = np.sin(angle)
        wa, wb = 1.0 - share[i], share[i]
        if sine > 1e-6:
            wa, wb = np.sin(wa * angle) / sine, np.sin(wb * angle) / sine
        norm = 0.0
        for k in range(4):
            out[i, k] = wa * a[i, k] + sign * wb * b[i, k]
            norm += out[i, k] * out[i, k]
        norm = np.sqrt(norm)
        for k in range(4):
            out[i, k] /= norm
    return out

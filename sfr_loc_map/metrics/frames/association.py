"""One-to-one association of estimates with true poses by their stamps in integer nanoseconds.

docs/metrics.md, "From poses to frames", defines the modes `match`, `interpolate` and `auto` and gives their reasons.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.rotation import slerp, unit_quats
from sfr_loc_map.geometry.trajectory import Trajectory, horizontal
from sfr_loc_map.message_stamps import NS_PER_MS, NS_PER_S
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics.config import AssociationConfig, AssociationMode
from sfr_loc_map.metrics.frames.covariance import COVARIANCE_SIZE, STEP_SIZE
from sfr_loc_map.stamp_pairing import nearest_stamps

Rows = NDArray[np.intp]
Number = TypeVar("Number", bound=np.generic)
AUTO_STAMPS = 16  #: Number of estimates and of true poses in the common span that `auto` examines.
IMAGE_PERIOD_SHARE = 0.4  #: Maximum difference to the stamp of the image, in median periods; files round stamps.
ROUNDED_NS = NS_PER_MS
"""Largest difference of the stamps of an estimate and its image that is attributed to rounding in a file."""
MATCHES_PER_STAMP = 4  #: `auto` selects `match` if at least one in four stamps coincides.
STATE_COLUMNS = ("lost", "degraded", "is_lost_known", "is_degraded_known")  #: Columns of `Estimates` with Booleans.


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimated poses with their states, covariances and steps."""

    trajectory: Trajectory  #: Estimated poses of RB in DS, in any order.
    lost: Mask  #: `(N,)` bool: whether the localiser was lost, so the pose is repeated.
    degraded: Mask  #: `(N,)` bool: whether a check of the localiser reported a problem with the pose.
    is_lost_known: Mask  #: `(N,)` bool: whether the source of the estimate reports if the pose is lost.
    is_degraded_known: Mask  #: `(N,)` bool: whether the source of the estimate reports if the pose is degraded.
    #: `(N, 21)` float64, upper triangles in ROS order (m^2, rad^2), NaN if unknown; None if all are unknown.
    covariance: FloatArray | None
    #: `(N, 48)` float64, step to each pose (`frames.covariance.STEP_SIZE`), NaN if unknown; None without steps.
    steps: FloatArray | None = None

    @property
    def unreliable(self) -> Mask:
        """Whether each pose `(N,)` is lost or degraded."""
        return self.lost | self.degraded

    def __post_init__(self) -> None:
        """Check the shapes of the columns, and that the states are Booleans; MetricsError if not."""
        count = len(self.trajectory)
        shapes = dict.fromkeys(STATE_COLUMNS, (count,)) | {
            "covariance": (count, COVARIANCE_SIZE),
            "steps": (count, STEP_SIZE),
        }
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values is not None and np.shape(values) != shape:
                needed = f"{shape} is required for {counted(count, 'pose')}"
                raise MetricsError(f"'{name}' of an estimate has the shape {np.shape(values)}: {needed}")
            if name in STATE_COLUMNS and values.dtype != np.bool_:
                raise MetricsError(f"'{name}' of an estimate has the type {values.dtype}: true or false is required")

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        lost: Mask | None = None,
        degraded: Mask | None = None,
        covariance: FloatArray | None = None,
        steps: FloatArray | None = None,
    ) -> Estimates:
        """Return estimates; states, covariances and steps that are not given are unknown for all poses."""
        is_lost_known, is_degraded_known = (np.full(len(trajectory), flags is not None) for flags in (lost, degraded))
        nowhere = np.zeros(len(trajectory), np.bool_)
        lost, degraded = (nowhere if flags is None else np.asarray(flags) for flags in (lost, degraded))
        return cls(trajectory, lost, degraded, is_lost_known, is_degraded_known, covariance, steps)

    def at_rows(self, rows: Rows) -> Estimates:
        """Return the estimates in `rows`."""
        return Estimates(
            trajectory=self.trajectory.at_rows(rows),
            lost=self.lost[rows],
            degraded=self.degraded[rows],
            is_lost_known=self.is_lost_known[rows],
            is_degraded_known=self.is_degraded_known[rows],
            covariance=None if self.covariance is None else self.covariance[rows],
            steps=None if self.steps is None else self.steps[rows],
        )

    def state_counts(self, rows: Rows) -> StateCounts:
        """Return how many of the poses are lost and degraded."""
        lost = int(np.count_nonzero(self.lost[rows]))
        degraded = int(np.count_nonzero(self.degraded[rows]))
        return StateCounts(
            lost=lost if self.is_lost_known[rows].all() else None,
            degraded=degraded if self.is_degraded_known[rows].all() else None,
        )


class StateCounts(NamedTuple):
    """Numbers of poses by state; None if the state of any of the poses is unknown."""

    lost: int | None
    degraded: int | None


class StampedPoses(NamedTuple):
    """Stamped poses in time order, as columns."""

    stamps_ns: IntArray
    position: FloatArray  #: `(N, 3)`.
    attitude: FloatArray  #: `(N, 4)` quaternions.


class Frames(NamedTuple):
    """True and estimated poses of the same frames in time order, with their stamps and the rows of the estimates."""

    stamps_ns: IntArray
    true_position: FloatArray
    true_attitude: FloatArray
    position: FloatArray
    attitude: FloatArray
    estimate_rows: Rows

    def without_heights(self) -> Frames:
        """Return the frames with estimated heights of 0, for a truth without heights, which has true heights of 0."""
        return self._replace(position=horizontal(self.position))

    @property
    def truth(self) -> StampedPoses:
        """The true poses."""
        return StampedPoses(self.stamps_ns, self.true_position, self.true_attitude)

    @property
    def estimate(self) -> StampedPoses:
        """The estimated poses."""
        return StampedPoses(self.stamps_ns, self.position, self.attitude)


class Matches(NamedTuple):
    """Rows of the estimates and of the true poses whose stamps agree, in ascending order of the stamps."""

    estimate_rows: Rows
    true_rows: Rows
    alone: Rows  #: Rows of the estimates without a true pose.


class MatchedStamps(NamedTuple):
    """How the stamps of estimates and of true poses were matched; the fields are those of `records.Association`."""

    mode: AssociationMode
    tolerance_s: float
    max_gap_s: float
    estimate_duplicates: int
    truth_duplicates: int
    exact: int
    near: int
    interpolated: int
    largest_difference_ns: int
    beside_images: int
    largest_image_difference_ns: int
    largest_gap_ns: int


def associate(
    estimate: Trajectory, truth: Trajectory, config: AssociationConfig, images_ns: IntArray | None = None
) -> tuple[Frames, MatchedStamps]:
    """Return the frames, and how their stamps were matched.

    If the stamps of the images are given, only the nearest estimate to each image can be a frame. MetricsError for an
    estimate without attitudes.
    """
    check_attitudes(estimate)
    estimate_rows, true_rows = unique_rows(estimate.stamps_ns), unique_rows(truth.stamps_ns)
    estimate_duplicates = len(estimate.stamps_ns) - len(estimate_rows)
    truth_duplicates = len(truth.stamps_ns) - len(true_rows)
    tolerance_ns = round(config.tolerance_s * NS_PER_S)
    if images_ns is not None and len(images_ns):
        images_ns = np.unique(images_ns)
        near_ns = nearness_ns(images_ns, tolerance_ns)
        estimate_rows = rows_of_images(estimate.stamps_ns, estimate_rows, images_ns, near_ns)
    mode = AssociationMode(config.truth)
    if mode is AssociationMode.AUTO:
        estimate_stamps, true_stamps = taken(estimate.stamps_ns, estimate_rows), taken(truth.stamps_ns, true_rows)
        mode = mode_of_stamps(estimate_stamps, true_stamps, tolerance_ns)
    matches = matches_of_stamps(estimate, truth, estimate_rows, true_rows, tolerance_ns)
    frames = matched_frames(estimate, truth, matches)
    difference = np.abs(taken(estimate.stamps_ns, matches.estimate_rows) - frames.stamps_ns)
    gaps = np.empty(0, np.int64)
    if mode is AssociationMode.INTERPOLATE:
        between, gaps = interpolated_frames(estimate, truth, matches.alone, true_rows, config.max_gap_s)
        frames = in_time_order(frames, between)
    from_images = np.empty(0, np.int64)
    if images_ns is not None and len(images_ns):
        _, from_images = nearest_stamps(estimate.stamps_ns[frames.estimate_rows], images_ns)
    matched = MatchedStamps(
        mode=mode,
        tolerance_s=config.tolerance_s,
        max_gap_s=config.max_gap_s,
        estimate_duplicates=estimate_duplicates,
        truth_duplicates=truth_duplicates,
        exact=int(np.count_nonzero(difference == 0)),
        near=int(np.count_nonzero(difference)),
        interpolated=len(gaps),
        largest_difference_ns=int(difference.max(initial=0)),
        beside_images=int(np.count_nonzero(from_images > ROUNDED_NS)),
        largest_image_difference_ns=int(from_images.max(initial=0)),
        largest_gap_ns=int(gaps.max(initial=0)),
    )
    return frames, matched


def check_attitudes(estimate: Trajectory) -> None:
    """Check that an estimate has attitudes; MetricsError if not."""
    if not estimate.has_attitude:
        raise MetricsError("the estimate has only positions: give an estimate with attitudes (unit quaternions)")


def mode_of_stamps(estimate_stamps: IntArray, true_stamps: IntArray, tolerance_ns: int) -> AssociationMode:
    """Return `match` if enough of the first stamps in the common span coincide, otherwise `interpolate`."""
    if not len(estimate_stamps) or not len(true_stamps):
        return AssociationMode.MATCH
    begin_ns = max(estimate_stamps[0], true_stamps[0]) - tolerance_ns
    est, gt = estimate_stamps[estimate_stamps >= begin_ns], true_stamps[true_stamps >= begin_ns]
    if not len(est) or not len(gt):
        return AssociationMode.MATCH
    last = AUTO_STAMPS - 1
    end_ns = max(est[min(last, len(est) - 1)], gt[min(last, len(gt) - 1)])
    end_ns = min(end_ns, est[-1], gt[-1]) + tolerance_ns
    est, gt = est[est <= end_ns], gt[gt <= end_ns]
    if not len(est) or not len(gt):  # all stamps of one trajectory lie between two stamps of the other
        return AssociationMode.INTERPOLATE
    is_near = np.searchsorted(gt, est - tolerance_ns, "left") < np.searchsorted(gt, est + tolerance_ns, "right")
    is_enough = MATCHES_PER_STAMP * np.count_nonzero(is_near) >= min(len(est), len(gt))
    return AssociationMode.MATCH if is_enough else AssociationMode.INTERPOLATE


def matches_of_stamps(
    estimate: Trajectory, truth: Trajectory, estimate_rows: Rows, true_rows: Rows, tolerance_ns: int
) -> Matches:
    """Return the pairs of equal stamps and of nearest remaining stamps within the tolerance, in time order."""
    estimate_stamps, true_stamps = taken(estimate.stamps_ns, estimate_rows), taken(truth.stamps_ns, true_rows)
    partner = np.full(len(estimate_stamps), -1, dtype=np.intp)
    if len(true_stamps):
        at = np.minimum(np.searchsorted(true_stamps, estimate_stamps), len(true_stamps) - 1)
        is_equal = true_stamps[at] == estimate_stamps
        partner[is_equal] = at[is_equal]
    if tolerance_ns and np.count_nonzero(partner >= 0) < min(len(estimate_stamps), len(true_stamps)):
        match_nearest(partner, estimate_stamps, true_stamps, tolerance_ns)
    is_matched = partner >= 0
    return Matches(estimate_rows[is_matched], true_rows[partner[is_matched]], estimate_rows[~is_matched])


def matched_frames(estimate: Trajectory, truth: Trajectory, matches: Matches) -> Frames:
    """Return the frames of the matches, with the stamps of the truth."""
    est, gt = matches.estimate_rows, matches.true_rows
    return Frames(
        stamps_ns=taken(truth.stamps_ns, gt),
        true_position=taken(truth.positions, gt),
        true_attitude=unit_quats(taken(truth.quats_xyzw, gt)),
        position=taken(estimate.positions, est),
        attitude=unit_quats(taken(estimate.quats_xyzw, est)),
        estimate_rows=est,
    )


def interpolated_frames(
    estimate: Trajectory, truth: Trajectory, alone: Rows, true_rows: Rows, max_gap_s: float
) -> tuple[Frames, IntArray]:
    """Return the frames of estimates between true poses at most `max_gap_s` apart, and the gaps between these poses."""
    true_stamps = truth.stamps_ns[true_rows]
    after = np.searchsorted(true_stamps, estimate.stamps_ns[alone])
    is_between = (after > 0) & (after < len(true_stamps))
    alone, after = alone[is_between], after[is_between]
    is_near = true_stamps[after] - true_stamps[after - 1] <= round(max_gap_s * NS_PER_S)
    alone, before, later = alone[is_near], true_rows[after[is_near] - 1], true_rows[after[is_near]]
    gaps = truth.stamps_ns[later] - truth.stamps_ns[before]
    share = (estimate.stamps_ns[alone] - truth.stamps_ns[before]) / gaps
    move = truth.positions[later] - truth.positions[before]
    frames = Frames(
        stamps_ns=estimate.stamps_ns[alone],
        true_position=truth.positions[before] + share[:, None] * move,
        true_attitude=slerp(unit_quats(truth.quats_xyzw[before]), unit_quats(truth.quats_xyzw[later]), share),
        position=estimate.positions[alone],
        attitude=unit_quats(estimate.quats_xyzw[alone]),
        estimate_rows=alone,
    )
    return frames, gaps


def in_time_order(frames: Frames, others: Frames) -> Frames:
    """Return the frames and the other frames together, in the order of their stamps."""
    order = np.argsort(np.concatenate((frames.stamps_ns, others.stamps_ns)), kind="stable")
    return Frames(*(np.concatenate(both)[order] for both in zip(frames, others, strict=True)))


def unordered(stamps_ns: IntArray) -> int:
    """Return the number of stamps that come after a later stamp."""
    return int(np.count_nonzero(stamps_ns[1:] < np.maximum.accumulate(stamps_ns)[:-1]))


def unique_rows(stamps_ns: IntArray) -> Rows:
    """Return the rows in the order of their stamps; of several rows with the same stamp only the last."""
    if (stamps_ns[1:] > stamps_ns[:-1]).all():
        return np.arange(len(stamps_ns))
    return len(stamps_ns) - 1 - np.unique(stamps_ns[::-1], return_index=True)[1]


def rows_of_images(stamps_ns: IntArray, rows: Rows, images_ns: IntArray, near_ns: int) -> Rows:
    """Return the nearest row to each image within `near_ns`; `rows` are in the order of their stamps.

    Estimates between the images, for instance of a filter with a higher rate, are not frames. Otherwise an item under
    test could publish more poses where the estimate is good. All rows are returned if no row is near an image.
    """
    stamps = taken(stamps_ns, rows)
    image, difference = nearest_stamps(stamps, images_ns)
    near = np.flatnonzero(difference <= near_ns)
    by_image = near[np.lexsort((difference[near], image[near]))]
    first = np.unique(image[by_image], return_index=True)[1]
    chosen = by_image[first]
    return rows[chosen] if len(chosen) else rows


def taken(values: NDArray[Number], rows: Rows) -> NDArray[Number]:
    """Return `values[rows]`, without a copy if `rows` contains all rows in ascending order. `rows` must be unique."""
    if len(rows) < len(values) or not (rows[1:] > rows[:-1]).all():
        return values[rows]
    return values


def match_nearest(partner: Rows, estimate_stamps: IntArray, true_stamps: IntArray, tolerance: int) -> None:
    """Assign the nearest unassigned true pose to estimates without a partner (-1), in place.

    Each true pose is used once. Of two equally near true poses the earlier is used. An estimate is not assigned to a
    true pose beyond an assigned stamp, so that the pairs are in time order.
    """
    assigned = estimate_stamps[partner >= 0]
    free_est = np.flatnonzero(partner < 0)
    free_gt = np.setdiff1d(np.arange(len(true_stamps)), partner, assume_unique=True)
    nearest, difference = nearest_stamps(estimate_stamps[free_est], true_stamps[free_gt])
    estimated_after = np.searchsorted(assigned, estimate_stamps[free_est])
    true_after = np.searchsorted(assigned, true_stamps[free_gt[nearest]])
    candidates = np.flatnonzero((difference <= tolerance) & (estimated_after == true_after))
    candidates = candidates[np.argsort(difference[candidates], kind="stable")]
    _, first = np.unique(nearest[candidates], return_index=True)
    chosen = candidates[first]
    partner[free_est[chosen]] = free_gt[nearest[chosen]]


def nearness_ns(needed: IntArray, tolerance_ns: int = 0) -> int:
    """Return the largest difference between an expected stamp and another stamp of the same pair; stamps ascend."""
    if len(needed) < 2:
        return tolerance_ns
    return max(tolerance_ns, int(IMAGE_PERIOD_SHARE * np.median(np.diff(needed))))

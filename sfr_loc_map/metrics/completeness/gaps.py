"""The gaps of a drive: times without an estimate, their length on the true path, and parts of the path without images.

A gap is a run of expected stamps without an estimate (`gaps_of`). If the images are unknown, the true poses are not
evidence of images, because a ground truth may have more poses than there were images. In this case, only a time of more
than five median periods between neighbouring estimates is an evident gap (`long_gaps`). The median is that of the
estimates' own periods, so an estimate that contains only every fifth pose, for example, has no evident gap. With
limits, each true pose without an estimate therefore counts as missing. Without limits there is no verdict, and only
evident gaps are reported. See docs/metrics.md, "Completeness".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.completeness.expected_items import due_stamps, has_stamp
from sfr_loc_map.metrics.conditions import Condition, ConditionKind
from sfr_loc_map.metrics.frames.association import nearness_ns, unique_rows

GAP_PERIODS = 5
"""A gap is a time of more than this number of median periods between neighbouring poses. Chosen by hand
(docs/decisions/0009-verdicts.md)."""

SAME_PERIOD = 1.5  #: Largest ratio of the median periods of images and true poses that have the same period.
MOST_IMAGES = 0.9  #: If this fraction of the images has a true pose, each true pose belongs to an image.


class TruePath(NamedTuple):
    """The ascending stamps of the true poses, and the length of the true path up to each pose."""

    stamps_ns: IntArray  #: `(T,)`
    travelled_m: FloatArray  #: `(T,)`

    def travelled_at(self, stamps_ns: IntArray) -> FloatArray:
        """Return the length of the path up to stamps, m, interpolated linearly; there must be a true pose."""
        begin_ns = self.stamps_ns[0]
        since_ns = (self.stamps_ns - begin_ns).astype(np.float64)  # differences of stamps are exact in float64
        return np.asarray(np.interp((stamps_ns - begin_ns).astype(np.float64), since_ns, self.travelled_m))


def true_path(truth: Trajectory, estimates_ns: IntArray, in_flight_ns: int) -> TruePath:
    """Return the path of the true poses whose results are due."""
    rows = unique_rows(truth.stamps_ns)
    stamps_ns = due_stamps(truth.stamps_ns[rows], estimates_ns, in_flight_ns)
    steps_m = np.linalg.norm(np.diff(truth.positions[rows[: len(stamps_ns)]], axis=0), axis=1)
    return TruePath(stamps_ns, np.append(0.0, np.cumsum(steps_m)))


class Gaps(NamedTuple):
    """The intervals of a drive without an estimate."""

    begins_ns: IntArray  #: `(G,)`
    ends_ns: IntArray  #: `(G,)`

    def with_others(self, others: Gaps) -> Gaps:
        """Return these gaps together with further gaps; the gaps may overlap."""
        begins_ns = np.concatenate((self.begins_ns, others.begins_ns))
        ends_ns = np.concatenate((self.ends_ns, others.ends_ns))
        return Gaps(begins_ns, ends_ns)

    def lengths_s(self) -> FloatArray:
        """Return the time of each gap, s."""
        return np.asarray((self.ends_ns - self.begins_ns) / NS_PER_S)

    def lengths_m(self, path: TruePath) -> FloatArray:
        """Return the length of the true path in each gap, m; 0 without a true pose."""
        if not len(path.stamps_ns):
            return np.zeros(len(self.begins_ns))
        return path.travelled_at(self.ends_ns) - path.travelled_at(self.begins_ns)


class DriveGaps(NamedTuple):
    """All gaps of a drive, and its evident gaps, which are reported even without limits."""

    every: Gaps
    evident: Gaps
    evident_share: float | None  #: Fraction of the drive in evident gaps; None if nothing was expected.


def gaps_of(expected_ns: IntArray, is_absent: Mask) -> Gaps:
    """Return the gaps from the last expected stamp with an estimate to the next expected stamp with an estimate.

    `expected_ns` is ascending. A gap at an end of the drive begins or ends at the first or last expected stamp.
    """
    edges = np.flatnonzero(np.diff(is_absent, prepend=False, append=False))  # begin and end of each run, alternating
    begins = expected_ns[np.maximum(edges[::2] - 1, 0)]
    ends = expected_ns[np.minimum(edges[1::2], len(expected_ns) - 1)]
    return Gaps(begins, ends)


def long_gaps(stamps: IntArray, true_ns: IntArray) -> Gaps:
    """Return the times of more than five median periods between estimates, within the time span of the truth.

    Both stamps are ascending.
    """
    nothing = np.empty(0, np.int64)
    if not len(stamps) or not len(true_ns):
        return Gaps(nothing, nothing)
    usual_ns = np.median(np.diff(stamps)) if len(stamps) > 1 else 0
    within = stamps[(stamps > true_ns[0]) & (stamps < true_ns[-1])]
    known = np.concatenate([true_ns[:1], within, true_ns[-1:]])
    wide = np.flatnonzero(np.diff(known) > GAP_PERIODS * usual_ns)
    return Gaps(known[wide], known[wide + 1])


def missing_path(gaps: Gaps, stamps: IntArray, path: TruePath) -> float:
    """Return the fraction of the true path in gaps, or of the time if the rover did not move.

    The fraction is 1 without an estimate or a true pose.
    """
    if not len(stamps) or not len(path.stamps_ns):
        return 1.0
    whole = float(path.travelled_m[-1])
    in_gaps = float(gaps.lengths_m(path).sum())
    if whole <= 0.0:
        whole = int(path.stamps_ns[-1] - path.stamps_ns[0]) / NS_PER_S
        in_gaps = float(gaps.lengths_s().sum())
    return in_gaps / whole if whole > 0.0 else 0.0


def path_without_images(images_ns: IntArray, path: TruePath, max_gap_ns: int) -> float | None:
    """Return the fraction of the true path before the first image, after the last image, and in gaps between images.

    A gap is longer than both `max_gap_ns` and five median periods, or contains a true pose although every image has a
    true pose (`between_images`). No estimate is expected there. None without a path.
    """
    true_ns = path.stamps_ns
    if not len(true_ns) or path.travelled_m[-1] <= 0.0:
        return None
    steps_ns = np.diff(images_ns)
    is_hole = steps_ns > max(max_gap_ns, GAP_PERIODS * float(np.median(steps_ns)) if len(steps_ns) else 0.0)
    is_hole |= between_images(images_ns, true_ns)
    begins_m = path.travelled_at(np.concatenate((true_ns[:1], images_ns[:-1][is_hole], images_ns[-1:])))
    ends_m = path.travelled_at(np.concatenate((images_ns[:1], images_ns[1:][is_hole], true_ns[-1:])))
    return float(np.sum(np.maximum(ends_m - begins_m, 0.0)) / path.travelled_m[-1])


def between_images(images_ns: IntArray, true_ns: IntArray) -> Mask:
    """Return which steps between neighbouring images contain a true pose without an image; both stamps ascend.

    The ground truth must have the stamps and the period of the images. Otherwise a true pose is not evidence of an
    image, and no step is returned.
    """
    is_hole = np.zeros(max(len(images_ns) - 1, 0), np.bool_)
    if min(len(images_ns), len(true_ns)) < 2:
        return is_hole
    near_ns = nearness_ns(images_ns)
    has_same_period = SAME_PERIOD * np.median(np.diff(true_ns)) > np.median(np.diff(images_ns))
    if not has_same_period or np.mean(has_stamp(images_ns, true_ns, near_ns)) < MOST_IMAGES:
        return is_hole
    alone = true_ns[~has_stamp(true_ns, images_ns, near_ns)]
    after = np.searchsorted(images_ns, alone)
    is_hole[after[(after > 0) & (after < len(images_ns))] - 1] = True
    return is_hole


def is_in_a_gap(condition: Condition, gaps: Gaps, path: TruePath) -> bool:
    """Return whether a gap is longer than the sub-trajectories of a condition, in each part of a combined condition.

    The frames and the turn of a gap are unknown, so that parts of these kinds are ignored.
    """
    lengths_m = gaps.lengths_m(path)
    lengths_s = gaps.lengths_s()
    lengths = {ConditionKind.DISTANCE: lengths_m, ConditionKind.DISPLACEMENT: lengths_m, ConditionKind.TIME: lengths_s}
    is_longer = [lengths[each.kind] > each.value for each in condition.components if each.kind in lengths]
    return bool(is_longer) and bool(np.all(is_longer, axis=0).any())

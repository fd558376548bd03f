"""The rows of completeness of a drive: its expected stamps, their coverage, and the gaps between its estimates.

`drive_completeness` determines

1. the expected stamps (`expected_stamps`): the images, or the true poses if the images are unknown,
2. which of them have an estimate and a ground truth (`coverage_of`),
3. the gaps, which are times without an estimate (module `gaps`), and
4. the rows of the table of figures.

An estimate counts as judged if it is paired with a true pose. There is one exception, because a matched truth may be
sparser than the images: an estimate between two of its poses also counts as judged, although no figure contains its
error (`TruthCoverage.requires_frame`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import IntArray, Mask
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.completeness.expected_items import due_stamps, expected_row, has_stamp, share_of, share_rows
from sfr_loc_map.metrics.completeness.gaps import (
    GAP_PERIODS,
    DriveGaps,
    TruePath,
    gaps_of,
    is_in_a_gap,
    long_gaps,
    missing_path,
    path_without_images,
    true_path,
)
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import AssociationMode
from sfr_loc_map.metrics.figures.catalogue import HIDDEN_CONDITIONS, IN_GAPS
from sfr_loc_map.metrics.figures.row_part import DISTANCE, TIME, RowPart
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import Scope
from sfr_loc_map.metrics.frames.association import MatchedStamps, nearness_ns
from sfr_loc_map.metrics.frames.placement import PlacedFrames

DOUBLED_SHARE = 0.1  #: A file contains two runs if the fraction of repeated stamps with another position exceeds this.
SPARSER = 1.5  #: The truth is sparser than the images if the ratio of their median periods exceeds this.


class DriveCompleteness(NamedTuple):
    """The rows of completeness of a drive, and the number of images whose result is due, None if it is unknown."""

    rows: list[Figure]
    images: int | None


def drive_completeness(
    estimate: Trajectory,
    placed: PlacedFrames,
    conditions: Sequence[Condition],
    image_stamps_ns: IntArray | None,
    in_flight_ns: int = 0,
) -> DriveCompleteness:
    """Return the completeness of a drive.

    `estimate` contains the estimates as given, before an alignment. `image_stamps_ns` is None if the images are
    unknown. MetricsError if the estimate or the truth contains two runs.
    """
    estimates_ns = single_run_stamps(estimate, "estimate")
    single_run_stamps(placed.truth, "ground truth")
    path = true_path(placed.truth, estimates_ns, in_flight_ns)
    truth = TruthCoverage.of(path.stamps_ns, placed.matched)
    expected_ns = expected_stamps(image_stamps_ns, estimates_ns, truth, in_flight_ns)
    coverage = coverage_of(expected_ns, estimates_ns, placed.frames.stamps_ns, truth)
    if image_stamps_ns is None:
        images = None
        gaps = gaps_without_images(coverage, estimates_ns, path)
        without_images = figure_row("path_without_images", n=0)
    else:
        images = len(expected_ns)
        gaps = gaps_between_images(coverage)
        share = path_without_images(expected_ns, path, truth.max_gap_ns)
        without_images = figure_row("path_without_images", n=images, value=share)
    rows = [*coverage_rows(coverage), *pose_rows(placed, len(estimates_ns))]
    return DriveCompleteness([*rows, *gap_rows(gaps, path, conditions), without_images], images)


def single_run_stamps(poses: Trajectory, what: str) -> IntArray:
    """Return the stamps of poses in order, each once; MetricsError, which names `what`, if there are two runs."""
    order = np.argsort(poses.stamps_ns, kind="stable")
    stamps = poses.stamps_ns[order]
    positions = poses.positions[order]
    again = np.flatnonzero(stamps[1:] == stamps[:-1]) + 1
    elsewhere = int(np.count_nonzero((positions[again] != positions[again - 1]).any(axis=1)))
    unique = np.delete(stamps, again)
    if elsewhere > DOUBLED_SHARE * len(unique):
        raise MetricsError(
            f"the {what} contains two runs: {elsewhere} of its {len(stamps)} poses repeat the stamp of another "
            "pose at another position: give one run"
        )
    return unique


# ---- what the ground truth covers


class TruthCoverage(NamedTuple):
    """The ascending stamps of the true poses, and the rule by which these poses cover other stamps."""

    stamps_ns: IntArray  #: `(T,)`
    mode: AssociationMode
    tolerance_ns: int  #: Largest difference between stamps that are considered equal.
    max_gap_ns: int  #: Longest gap of the truth that is interpolated.

    @classmethod
    def of(cls, stamps_ns: IntArray, matched: MatchedStamps) -> TruthCoverage:
        """Return the coverage by true poses with the settings of the association."""
        tolerance_ns = round(matched.tolerance_s * NS_PER_S)
        return cls(stamps_ns, matched.mode, tolerance_ns, round(matched.max_gap_s * NS_PER_S))

    def spans(self, expected_ns: IntArray, near_ns: int) -> Mask:
        """Return which ascending stamps the ground truth covers.

        The truth covers the time between two true poses, unless this time is a gap that is longer than both the longest
        interpolated gap and five median periods of the truth. In such gaps and beyond its ends, the truth covers only
        stamps near a true pose. The largest distance is `near_ns` if the truth is interpolated, because files round
        stamps. It is the tolerance or one median period if the truth is matched, because a matched truth may be sparser
        than the images.
        """
        true_ns = self.stamps_ns
        if not len(true_ns):
            return np.zeros(len(expected_ns), np.bool_)
        usual_ns = float(np.median(np.diff(true_ns))) if len(true_ns) > 1 else 0.0
        reach_ns = max(self.tolerance_ns, round(usual_ns)) if self.mode is AssociationMode.MATCH else near_ns
        longest_ns = max(self.max_gap_ns, GAP_PERIODS * usual_ns)
        before = np.searchsorted(true_ns, expected_ns, "right") - 1
        after = np.searchsorted(true_ns, expected_ns, "left")
        since = expected_ns - true_ns[np.maximum(before, 0)]
        until = true_ns[np.minimum(after, len(true_ns) - 1)] - expected_ns
        has_before = before >= 0
        has_after = after < len(true_ns)
        is_inside = has_before & has_after & (since + until <= longest_ns)
        is_beside = (has_before & (since <= reach_ns)) | (has_after & (until <= reach_ns))
        return np.asarray(is_inside | is_beside)

    def requires_frame(self, expected_ns: IntArray, near_ns: int) -> Mask:
        """Return which ascending stamps are judged only if their estimate is a frame, that is, has a true pose.

        - If the truth is interpolated: all stamps.
        - If the truth is matched: all stamps, or only the stamps of true poses if the truth is sparser than the images.

        Stamps near the ends of the truth are excluded, because a file may have rounded the stamp of an estimate
        outwards.
        """
        true_ns = self.stamps_ns
        if not len(true_ns):
            return np.zeros(len(expected_ns), np.bool_)
        is_inside = (expected_ns - near_ns >= true_ns[0]) & (expected_ns + near_ns <= true_ns[-1])
        if self.mode is AssociationMode.MATCH and self.is_sparser_than(expected_ns):
            is_inside &= has_stamp(expected_ns, true_ns, near_ns)
        return np.asarray(is_inside)

    def is_sparser_than(self, expected_ns: IntArray) -> bool:
        """Return whether the period of the true poses is `SPARSER` times that of expected stamps, or longer."""
        if min(len(self.stamps_ns), len(expected_ns)) < 2:
            return False
        return bool(np.median(np.diff(self.stamps_ns)) >= SPARSER * np.median(np.diff(expected_ns)))


# ---- expected stamps, and which of them are covered


def expected_stamps(
    image_stamps_ns: IntArray | None, estimates_ns: IntArray, truth: TruthCoverage, in_flight_ns: int = 0
) -> IntArray:
    """Return the ascending stamps of a drive at which an estimate is due; the stamps of the estimates ascend.

    They are the stamps of the images. If the images are unknown, they are the stamps of the true poses, and of the
    estimates that the ground truth does not cover. Results of the last `in_flight_ns` are not due yet.
    """
    if image_stamps_ns is not None:
        return due_stamps(np.unique(image_stamps_ns), estimates_ns, in_flight_ns)
    due_ns = due_stamps(estimates_ns, estimates_ns[:0], in_flight_ns)
    return expected_without_images(due_ns, truth)


def expected_without_images(estimates_ns: IntArray, truth: TruthCoverage) -> IntArray:
    """Return the stamps of true poses, and of the estimates before, after and in gaps of the truth; inputs ascend.

    If the images are unknown, these estimates count as images without a truth.
    """
    if len(truth.stamps_ns) < 2:
        return truth.stamps_ns
    is_covered = truth.spans(estimates_ns, nearness_ns(estimates_ns, truth.tolerance_ns))
    return np.union1d(truth.stamps_ns, estimates_ns[~is_covered])


class Coverage(NamedTuple):
    """The ascending expected stamps of a drive, and which of them have an estimate and a ground truth."""

    expected_ns: IntArray  #: `(E,)`
    has_estimate: Mask  #: `(E,)`
    has_truth: Mask  #: `(E,)`: whether there is a ground truth with which an estimate at this stamp is compared.

    @property
    def expected(self) -> int:
        """The number of expected stamps."""
        return len(self.expected_ns)

    @property
    def judged(self) -> int:
        """The number of expected stamps with an estimate and a ground truth."""
        return int(np.count_nonzero(self.has_estimate & self.has_truth))

    @property
    def missing(self) -> int:
        """The number of expected stamps without an estimate."""
        return int(np.count_nonzero(~self.has_estimate))

    @property
    def without_truth(self) -> int:
        """The number of expected stamps without a ground truth."""
        return int(np.count_nonzero(~self.has_truth))


def coverage_of(expected_ns: IntArray, estimates_ns: IntArray, frames_ns: IntArray, truth: TruthCoverage) -> Coverage:
    """Return which expected stamps have an estimate and a ground truth; all stamps ascend."""
    near_ns = nearness_ns(expected_ns, truth.tolerance_ns)
    has_estimate = has_stamp(expected_ns, estimates_ns, near_ns)
    has_frame = has_stamp(expected_ns, frames_ns, near_ns)
    has_truth = truth.spans(expected_ns, near_ns)
    has_truth &= has_frame | ~has_estimate | ~truth.requires_frame(expected_ns, near_ns)
    return Coverage(expected_ns, has_estimate, has_truth)


def coverage_rows(coverage: Coverage) -> Iterator[Figure]:
    """Yield the rows that count expected stamps."""
    yield expected_row(RowPart(Scope.DRIVE), coverage.judged, coverage.expected)
    yield from share_rows("missing", coverage.missing, coverage.expected)
    yield from share_rows("images_without_truth", coverage.without_truth, coverage.expected)


def pose_rows(placed: PlacedFrames, unique_estimates: int) -> Iterator[Figure]:
    """Yield the rows of frames and estimates; `unique_estimates` is the number of distinct stamps of the estimates."""
    frames = len(placed.frames.stamps_ns)
    states = placed.states
    yield from share_rows("lost", states.lost, frames)
    yield from share_rows("degraded", states.degraded, frames)
    yield from share_rows("unmatched", unique_estimates - frames, unique_estimates)
    yield from share_rows("doubled", placed.matched.estimate_duplicates, len(placed.estimates.trajectory))


def rows_without_poses(images: int) -> Iterator[Figure]:
    """Yield the rows of a drive without an estimate for any of its images."""
    yield expected_row(RowPart(Scope.DRIVE), 0, images)
    yield from share_rows("missing", images, images)
    yield figure_row(IN_GAPS, value=1.0)


# ---- gaps


def gaps_between_images(coverage: Coverage) -> DriveGaps:
    """Return the gaps of a drive whose images are known. All gaps are evident."""
    gaps = gaps_of(coverage.expected_ns, ~coverage.has_estimate)
    return DriveGaps(gaps, gaps, share_of(coverage.missing, coverage.expected))


def gaps_without_images(coverage: Coverage, estimates_ns: IntArray, path: TruePath) -> DriveGaps:
    """Return the gaps of a drive whose images are unknown; only long gaps are evident, by their true path."""
    evident = long_gaps(estimates_ns, path.stamps_ns)
    every = gaps_of(coverage.expected_ns, ~coverage.has_estimate).with_others(evident)
    is_empty = not coverage.expected and not len(estimates_ns)
    return DriveGaps(every, evident, None if is_empty else missing_path(evident, estimates_ns, path))


def gap_rows(gaps: DriveGaps, path: TruePath, conditions: Sequence[Condition]) -> Iterator[Figure]:
    """Yield the longest gaps, the fraction of the drive in evident gaps, and the conditions that these gaps hide.

    The longest path and the longest time may belong to different gaps, and are 0 without a gap.
    """
    longest_m = gaps.every.lengths_m(path).max(initial=0.0)
    longest_s = gaps.every.lengths_s().max(initial=0.0)
    yield figure_row("longest_gap", part=DISTANCE, value=longest_m)
    yield figure_row("longest_gap", part=TIME, value=longest_s)
    yield figure_row(IN_GAPS, value=gaps.evident_share)
    hidden = sum(is_in_a_gap(condition, gaps.evident, path) for condition in conditions)
    yield figure_row(HIDDEN_CONDITIONS, n=len(conditions), value=share_of(hidden, len(conditions)))

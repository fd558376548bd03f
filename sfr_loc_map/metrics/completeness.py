"""Completeness: the expected items of a drive, a map, the calls or a live run, and the fraction that can be judged.

The source defines the expected items, never the item under test. They are the stamps of its images or, if the images
are unknown, the stamps of the ground truth. `drive_completeness`, `map_completeness`, `calls_completeness` and
`live_completeness` return rows of the table of figures. `metrics.judging` uses these rows to decide whether a verdict
is possible. See docs/metrics.md, "Completeness".

A gap is a run of expected stamps without an estimate. The true poses are no evidence of the images, because a ground
truth may be denser than unknown images. If the images are unknown, only a time of more than five median periods between
neighbouring estimates is therefore an evident gap (`long_gaps`). Limits require complete evidence, so that each true
pose without an estimate is missing. Without limits, only evident gaps make a drive incomplete.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.association import nearest_stamps, nearness_ns
from sfr_loc_map.metrics.catalogue import CALLS, DRIVE, LIVE, MAP
from sfr_loc_map.metrics.config import AssociationMode, CallKind, Condition, ConditionKind
from sfr_loc_map.metrics.records import Association
from sfr_loc_map.metrics.row_part import Place, RowPart
from sfr_loc_map.metrics.table import Figure, figure_row

MISSING_SHARE = 0.01  #: Missing fraction above which an estimate is reported as incomplete without limits.
DISTANCE, TIME = "distance", "time"  #: Parts of the rows of the longest gap.
GAP_PERIODS = 5  #: A gap is a time of more than this number of median periods between neighbouring poses.
SPARSER = 1.5  #: The truth is sparser than the images if the ratio of their median periods exceeds this.
DOUBLED_SHARE = 0.1  #: A file contains two runs if the fraction of repeated stamps with another position exceeds this.


class TruePath(NamedTuple):
    """The ascending stamps of the true poses, and the length of the true path up to each pose."""

    stamps_ns: IntArray  #: `(T,)`
    travelled_m: FloatArray  #: `(T,)`

    def travelled_at(self, stamps_ns: IntArray) -> FloatArray:
        """Return the length of the path up to stamps, m, interpolated linearly; there must be a true pose."""
        begin_ns = self.stamps_ns[0]
        since_ns = (self.stamps_ns - begin_ns).astype(np.float64)  # differences of stamps are exact in float64
        return np.asarray(np.interp((stamps_ns - begin_ns).astype(np.float64), since_ns, self.travelled_m))


class Gaps(NamedTuple):
    """The intervals of a drive without an estimate."""

    begins_ns: IntArray  #: `(G,)`
    ends_ns: IntArray  #: `(G,)`

    def with_others(self, others: Gaps) -> Gaps:
        """Return these gaps and others, which may overlap."""
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


class LongestGap(NamedTuple):
    """The longest path and the longest time of the gaps of a drive, 0 without a gap."""

    distance_m: float
    time_s: float

    @classmethod
    def of(cls, gaps: Gaps, path: TruePath) -> LongestGap:
        """Return the longest path and the longest time of gaps, which may belong to different gaps."""
        return cls(float(gaps.lengths_m(path).max(initial=0.0)), float(gaps.lengths_s().max(initial=0.0)))


def drive_completeness(
    estimate: Trajectory,
    truth: Trajectory,
    association: Association,
    frames_ns: IntArray,
    conditions: Sequence[Condition],
    image_stamps_ns: IntArray | None,
    in_flight_ns: int = 0,
) -> tuple[Association, list[Figure]]:
    """Return the association with the reason why the estimate is incomplete, and the rows of completeness.

    `frames_ns` are the ascending stamps of the frames. MetricsError if the estimate or the truth contains
    two runs.
    """
    stamps = single_run_stamps(estimate, "estimate")
    single_run_stamps(truth, "ground truth")
    path = true_path(truth, stamps, in_flight_ns)
    tolerance_ns = round(association.tolerance_s * NS_PER_S)
    max_gap_ns = round(association.max_gap_s * NS_PER_S)
    images: int | None = None
    if image_stamps_ns is not None and len(image_stamps_ns):
        needed = settled(np.unique(image_stamps_ns), stamps, in_flight_ns)
        images = len(needed)
    else:
        due_ns = settled(stamps, stamps[:0], in_flight_ns)
        needed = np.union1d(path.stamps_ns, estimates_without_truth(due_ns, path.stamps_ns, max_gap_ns, tolerance_ns))
    near_ns = nearness_ns(needed, tolerance_ns)
    has_estimate, has_frame = has_near(needed, stamps, near_ns), has_near(needed, frames_ns, near_ns)
    has_truth = is_spanned(needed, path.stamps_ns, max_gap_ns, tolerance_ns)
    has_truth &= has_frame | ~has_estimate | ~needs_frame(needed, path.stamps_ns, near_ns, association.mode)
    expected = len(needed)
    given = len(stamps)
    matched = association.matched
    missing = int(np.count_nonzero(~has_estimate))
    covered = covered_share(missing, expected)
    gaps = gaps_of(needed, ~has_estimate)
    evident = gaps
    evidently_covered = covered
    if not images:
        evident = long_gaps(stamps, path.stamps_ns)
        evidently_covered = covered_path(evident, stamps, path)
        gaps = gaps.with_others(evident)
    longest = LongestGap.of(gaps, path)
    incomplete = None
    if 1.0 - evidently_covered > MISSING_SHARE or hides_a_condition(evident, path, conditions):
        incomplete = covered_text(covered, "images" if images else "true poses", longest)
    figures = [
        expected_row(RowPart(DRIVE), int(np.count_nonzero(has_estimate & has_truth)), expected),
        *share_rows("missing", missing, expected),
        *share_rows("images_without_truth", int(np.count_nonzero(~has_truth)), expected),
        *share_rows("lost", association.lost, matched),
        *share_rows("degraded", association.degraded, matched),
        *share_rows("unmatched", given - matched, given),
        *share_rows("doubled", association.estimate_duplicates, len(estimate.stamps_ns)),
        figure_row(
            "path_without_images",
            n=images or 0,
            value=path_without_images(needed, path, max_gap_ns) if images else None,
        ),
        *longest_gap_rows(longest),
    ]
    return msgspec.structs.replace(association, images=images, incomplete=incomplete), figures


def true_path(truth: Trajectory, estimates_ns: IntArray, in_flight_ns: int) -> TruePath:
    """Return the path of the true poses whose results are due."""
    stamps_ns, rows = np.unique(truth.stamps_ns, return_index=True)
    stamps_ns = settled(stamps_ns, estimates_ns, in_flight_ns)
    steps_m = np.linalg.norm(np.diff(truth.positions[rows[: len(stamps_ns)]], axis=0), axis=1)
    return TruePath(stamps_ns, np.append(0.0, np.cumsum(steps_m)))


def longest_gap_rows(longest: LongestGap) -> Iterator[Figure]:
    """Yield the longest distance and the longest time without an estimate."""
    yield figure_row("longest_gap", part=DISTANCE, value=longest.distance_m)
    yield figure_row("longest_gap", part=TIME, unit="s", value=longest.time_s)


def settled(stamps_ns: IntArray, results_ns: IntArray, in_flight_ns: int) -> IntArray:
    """Return the ascending stamps whose results are due.

    Results are due up to the stamp of the last result, and for stamps that are older than `in_flight_ns`.
    """
    if not in_flight_ns or not len(stamps_ns):
        return stamps_ns
    due_ns = stamps_ns.max() - in_flight_ns
    if len(results_ns):
        due_ns = max(due_ns, results_ns.max())
    return np.asarray(stamps_ns[stamps_ns <= due_ns])


def expected_row(part: RowPart, judged: int, expected: int | None) -> Figure:
    """Return the row of the number of expected items of a part and of the judged fraction; null if unknown."""
    return figure_row(
        "judged", part=part.text, n=expected, value=None if expected is None else share_of(judged, expected)
    )


def share_rows(name: str, count: int, total: int) -> Iterator[Figure]:
    """Yield the rows of a count as a fraction of a total, and as a number."""
    yield figure_row(name, n=total, value=share_of(count, total))
    yield figure_row(name, part="count", n=total, value=count)


def share_of(count: int, total: int) -> float | None:
    """Return a count as a fraction of a total, None if the total is 0."""
    return count / total if total else None


def single_run_stamps(poses: Trajectory, what: str) -> IntArray:
    """Return the stamps of poses in order, each once; MetricsError, which names `what`, if there are two runs."""
    order = np.argsort(poses.stamps_ns, kind="stable")
    stamps, positions = poses.stamps_ns[order], poses.positions[order]
    again = np.flatnonzero(stamps[1:] == stamps[:-1]) + 1
    elsewhere = int(np.count_nonzero((positions[again] != positions[again - 1]).any(axis=1)))
    unique = np.delete(stamps, again)
    if elsewhere > DOUBLED_SHARE * len(unique):
        raise MetricsError(
            f"the {what} contains two runs: {elsewhere} of its {len(stamps)} poses repeat the stamp of another "
            "pose at another position: give one run"
        )
    return unique


def has_near(stamps: IntArray, among: IntArray, near_ns: int) -> Mask:
    """Return which stamps have a stamp of `among` within `near_ns`; both are ascending."""
    first = np.searchsorted(among, stamps - near_ns, "left")
    return np.asarray(first < np.searchsorted(among, stamps + near_ns, "right"))


def needs_frame(needed: IntArray, true_ns: IntArray, near_ns: int, mode: AssociationMode | str) -> Mask:
    """Return which expected stamps are judged only if their estimate is a frame; both stamps are ascending.

    A frame is an estimate paired with a true pose (docs/metrics.md). No figure contains the error of an estimate that
    is not a frame. With an interpolated truth, every estimate is expected to be a frame. With a matched truth, every
    estimate at a true pose is expected to be a frame: every estimate unless the truth is sparser than the images. The
    ends of the truth are excluded, because a file may have rounded the stamp of an estimate outwards.
    """
    if not len(true_ns):
        return np.zeros(len(needed), np.bool_)
    is_inside = (needed - near_ns >= true_ns[0]) & (needed + near_ns <= true_ns[-1])
    is_sparse = min(len(true_ns), len(needed)) > 1 and np.median(np.diff(true_ns)) >= SPARSER * np.median(
        np.diff(needed)
    )
    if mode == AssociationMode.MATCH and is_sparse:
        is_inside &= has_near(needed, true_ns, near_ns)
    return np.asarray(is_inside)


def is_spanned(needed: IntArray, true_ns: IntArray, max_gap_ns: int, tolerance_ns: int) -> Mask:
    """Return which expected stamps the ground truth covers; both stamps are ascending.

    A true pose covers one median period of the truth before and after it, so that a truth that is sparser than the
    images covers the images at both ends. A gap that is longer than `max_gap_ns` and than five median periods is not
    covered.
    """
    if not len(true_ns):
        return np.zeros(len(needed), np.bool_)
    usual_ns = float(np.median(np.diff(true_ns))) if len(true_ns) > 1 else 0.0
    reach_ns = max(tolerance_ns, round(usual_ns))
    before = np.searchsorted(true_ns, needed, "right") - 1
    after = np.searchsorted(true_ns, needed, "left")
    since = needed - true_ns[np.maximum(before, 0)]
    until = true_ns[np.minimum(after, len(true_ns) - 1)] - needed
    is_inside = (before >= 0) & (after < len(true_ns)) & (since + until <= max(max_gap_ns, GAP_PERIODS * usual_ns))
    is_beside = ((before >= 0) & (since <= reach_ns)) | ((after < len(true_ns)) & (until <= reach_ns))
    return np.asarray(is_inside | is_beside)


def estimates_without_truth(stamps: IntArray, true_ns: IntArray, max_gap_ns: int, tolerance_ns: int) -> IntArray:
    """Return the stamps of estimates before, after and in gaps of the truth; both stamps are ascending.

    If the images are unknown, these stamps count as images without a truth.
    """
    if len(true_ns) < 2:
        return np.empty(0, np.int64)
    return np.asarray(stamps[~is_spanned(stamps, true_ns, max_gap_ns, tolerance_ns)])


def path_without_images(images_ns: IntArray, path: TruePath, max_gap_ns: int) -> float | None:
    """Return the fraction of the true path before the first image, after the last image, and in gaps between images.

    A gap is longer than `max_gap_ns` and than five median periods. No estimate is expected there. None without a path.
    """
    true_ns = path.stamps_ns
    if not len(true_ns) or path.travelled_m[-1] <= 0.0:
        return None
    steps_ns = np.diff(images_ns)
    is_hole = steps_ns > max(max_gap_ns, GAP_PERIODS * float(np.median(steps_ns)) if len(steps_ns) else 0.0)
    begins_m = path.travelled_at(np.concatenate((true_ns[:1], images_ns[:-1][is_hole], images_ns[-1:])))
    ends_m = path.travelled_at(np.concatenate((images_ns[:1], images_ns[1:][is_hole], true_ns[-1:])))
    return float(np.sum(np.maximum(ends_m - begins_m, 0.0)) / path.travelled_m[-1])


def gaps_of(needed: IntArray, is_absent: Mask) -> Gaps:
    """Return the gaps between the expected stamps that have an estimate; stamps are ascending."""
    edges = np.flatnonzero(np.diff(is_absent, prepend=False, append=False))  # begin and end of each run, alternating
    begins = needed[np.maximum(edges[::2] - 1, 0)]
    ends = needed[np.minimum(edges[1::2], len(needed) - 1)]
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


def covered_share(missing: int, expected: int) -> float:
    """Return the fraction of the expected stamps that have an estimate; 0 if no stamp is expected."""
    return 1.0 - missing / expected if expected else 0.0


def covered_path(gaps: Gaps, stamps: IntArray, path: TruePath) -> float:
    """Return the fraction of the true path outside of gaps, or of the time if the rover did not move.

    The fraction is 0 without an estimate or a true pose.
    """
    if not len(stamps) or not len(path.stamps_ns):
        return 0.0
    whole, in_gaps = float(path.travelled_m[-1]), float(gaps.lengths_m(path).sum())
    if whole <= 0.0:
        whole, in_gaps = int(path.stamps_ns[-1] - path.stamps_ns[0]) / NS_PER_S, float(gaps.lengths_s().sum())
    return 1.0 - in_gaps / whole if whole > 0.0 else 1.0


def hides_a_condition(gaps: Gaps, path: TruePath, conditions: Sequence[Condition]) -> bool:
    """Return whether a gap is longer than the sub-trajectories of a condition, in each part of a combined condition.

    The frames and the turn of a gap are unknown, so that parts of these kinds are ignored.
    """
    lengths_m, lengths_s = gaps.lengths_m(path), gaps.lengths_s()
    lengths = {ConditionKind.DISTANCE: lengths_m, ConditionKind.DISPLACEMENT: lengths_m, ConditionKind.TIME: lengths_s}
    for condition in conditions:
        is_longer = [lengths[part.kind] > part.value for part in condition.parts if part.kind in lengths]
        if is_longer and np.all(is_longer, axis=0).any():
            return True
    return False


def covered_text(share: float, of: str, longest: LongestGap | None) -> str:
    """Return the text of the covered fraction of images or true poses (`of`) and of the longest gap."""
    text = f"the estimate covers {100.0 * share:.4g} % of the {of}"
    if longest is not None:
        text += f", and its longest gap is {longest.distance_m:.4g} m and {longest.time_s:.4g} s"
    if of != "images":
        text += "; if the truth is longer or denser than the images, score against the source with its images"
    return text


# ---- maps, calls and live runs


def map_completeness(
    points: int,
    not_finite: int,
    without_truth: int,
    point_pairs: NDArray[np.integer],
    expected_pairs: int,
    bare: Sequence[float | None],
    repeated: int = 0,
) -> Iterator[Figure]:
    """Yield the rows of completeness of a cloud.

    `points` is the number of finite points of the cloud. `point_pairs` has the pairs of the points. `bare` is the
    fraction of the true pixels of each pair in the scored range that have no point, None if the pair has no such pixel.
    `repeated` is the number of points whose pixel or position is that of an earlier point.
    """
    mapped = len(np.unique(point_pairs))
    yield expected_row(RowPart(MAP), mapped, expected_pairs)
    yield from share_rows("pairs_without_cloud", max(expected_pairs - mapped, 0), expected_pairs)
    yield from share_rows("points_without_truth", without_truth, points)
    yield from share_rows("points_not_finite", not_finite, points + not_finite)
    yield from share_rows("points_repeated", repeated, points)
    known = [share for share in bare if share is not None]
    yield figure_row("pixels_without_point", n=len(known), value=max(known, default=None))


def calls_completeness(
    kind: CallKind,
    stamps_ns: IntArray,
    expected_ns: IntArray | None,
    values: Mapping[str, FloatArray],
    place: Place = Place.HOST,
) -> Iterator[Figure]:
    """Yield the rows of completeness of the calls `(N,)` of one kind, relative to the expected pairs.

    `values` has the measurements of each call by `calls` (time) and `memory`, NaN if not measured. `place` states where
    the calls were measured. One call maps a set of pairs, at the stamp of its last pair. At least one such call, at a
    stamp of the source, is therefore expected. A call belongs to the pair of the nearest stamp; further calls of
    the pair are doubled.
    """
    for name, measured in values.items():
        given = stamps_ns[np.isfinite(measured)]
        if expected_ns is None or not len(expected_ns):
            yield expected_row(RowPart(name, kind, place), 0, None)
            continue
        expected = np.unique(expected_ns)
        near_ns = nearness_ns(expected)
        unique, counts = np.unique(given, return_counts=True)
        is_of_drive = has_near(unique, expected, near_ns)
        judged, many = int(np.count_nonzero(has_near(expected, unique, near_ns))), len(expected)
        if kind not in (CallKind.LOCALISATION, CallKind.MAPPING):
            judged, many = min(judged, 1), 1
        yield expected_row(RowPart(name, kind, place), judged, many)
        if name == CALLS:
            part, total = RowPart("", kind, place).text, len(given)
            other = int(counts[~is_of_drive].sum())
            pairs = nearest_stamps(unique[is_of_drive], expected)[0]
            repeated_stamps = int((counts - 1).sum())
            doubled = repeated_stamps + len(pairs) - len(np.unique(pairs))
            yield figure_row("calls_missing", part=part, n=many, value=share_of(many - judged, many))
            yield figure_row("calls_other", part=part, n=total, value=share_of(other, total))
            yield figure_row("calls_doubled", part=part, n=total, value=share_of(doubled, total))


def live_completeness(received: int, dropped: int, restarts: int) -> Iterator[Figure]:
    """Yield the rows of completeness of a live run: received and dropped messages, and restarts of the score."""
    yield expected_row(RowPart(LIVE), received, received + dropped)
    yield from share_rows("dropped", dropped, received + dropped)
    yield figure_row("restarts", value=restarts)

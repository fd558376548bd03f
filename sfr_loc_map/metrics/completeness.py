"""What of a drive an estimate covers: a part of a drive is never a pass of the whole [4.1.1].

Where the images are known they are what has to be covered. Otherwise it is the truth's path: what is between
neighbouring estimates counts as covered unless they are further apart than five of their usual periods, since truth is
often denser than images. docs/metrics.md, "The whole drive".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.config import Condition, ConditionKind
from sfr_loc_map.metrics.score import Association, Figure, figure_row

MISSING_SHARE = 0.01  #: An estimate that misses more is incomplete.
GAP_PERIODS = 5  #: Neighbouring estimates that are more of their usual periods apart cover nothing between them.
IMAGE_PERIOD_SHARE = 0.4  #: An estimate this near to an image, in periods, is of this image: files round stamps.
DOUBLED_SHARE = 0.1  #: With more stamps that occur twice, and other poses at them, a file holds two runs.


class Gaps(NamedTuple):
    """The intervals of a drive that no estimate covers."""

    begins_ns: IntArray  #: `(G,)`
    ends_ns: IntArray  #: `(G,)`
    missing: int  #: Images, or true poses, that have no estimate.


class GapSizes(NamedTuple):
    """How much of a drive is not covered."""

    longest_m: float
    longest_s: float
    missing_share: float


def completeness(
    estimate: Trajectory,
    truth: Trajectory,
    association: Association,
    conditions: Sequence[Condition],
    image_stamps_ns: IntArray | None,
) -> tuple[Association, list[Figure]]:
    """Return what of a drive is covered: the association with why it is incomplete, and the rows of the score.

    MetricsError if the estimate holds two runs.
    """
    stamps = single_run_stamps(estimate)
    true_ns, rows = np.unique(truth.stamps_ns, return_index=True)
    steps = np.linalg.norm(np.diff(truth.positions[rows], axis=0), axis=1)
    travelled_m = np.append(0.0, np.cumsum(steps))
    images: int | None = None
    if image_stamps_ns is not None and len(image_stamps_ns):
        needed = np.unique(image_stamps_ns)
        images = len(needed)
        gaps = gaps_in_images(stamps, needed, round(association.tolerance_s * NS_PER_S))
    else:
        gaps = gaps_in_truth(stamps, true_ns)
    sizes = sizes_of(gaps, stamps, true_ns, travelled_m, images)
    incomplete = why_incomplete(gaps, sizes, conditions, images)
    given, matched = len(estimate.stamps_ns), association.matched
    unmatched, doubled = len(stamps) - matched, association.estimate_duplicates
    counts = {
        "missing": (gaps.missing, sizes.missing_share, images or len(true_ns)),
        "lost": (association.lost, share_of(association.lost, matched), matched),
        "degraded": (association.degraded, share_of(association.degraded, matched), matched),
        "unmatched": (unmatched, share_of(unmatched, len(stamps)), len(stamps)),
        "doubled": (doubled, share_of(doubled, given), given),
    }
    figures = [figure_row("judged", n=images or len(true_ns), value=1.0 - sizes.missing_share)]
    for name, (count, share, total) in counts.items():
        figures += [figure_row(name, n=total, value=share), figure_row(name, part="count", n=total, value=count)]
    figures.append(figure_row("longest_gap", part="distance", value=sizes.longest_m))
    figures.append(figure_row("longest_gap", part="time", unit="s", value=sizes.longest_s))
    return msgspec.structs.replace(association, images=images, incomplete=incomplete), figures


def share_of(count: int, total: int) -> float | None:
    """Return a count as a fraction of a total, None if there is none."""
    return count / total if total else None


def single_run_stamps(estimate: Trajectory) -> IntArray:
    """Return the stamps of an estimate in order, each once; MetricsError if the estimate holds two runs."""
    order = np.argsort(estimate.stamps_ns, kind="stable")
    stamps, positions = estimate.stamps_ns[order], estimate.positions[order]
    again = np.flatnonzero(stamps[1:] == stamps[:-1]) + 1
    elsewhere = int(np.count_nonzero((positions[again] != positions[again - 1]).any(axis=1)))
    unique = np.delete(stamps, again)
    if elsewhere > DOUBLED_SHARE * len(unique):
        raise MetricsError(
            f"the estimate holds two runs: {elsewhere} of its {len(stamps)} poses have the stamp of another elsewhere: "
            "give one"
        )
    return unique


def gaps_in_images(stamps: IntArray, needed: IntArray, tolerance_ns: int) -> Gaps:
    """Return the gaps between estimates of images; stamps of both go up."""
    near_ns = tolerance_ns
    if len(needed) > 1:
        near_ns = max(tolerance_ns, int(IMAGE_PERIOD_SHARE * np.median(np.diff(needed))))
    first = np.searchsorted(stamps, needed - near_ns, "left")
    is_absent = first == np.searchsorted(stamps, needed + near_ns, "right")
    edges = np.flatnonzero(np.diff(is_absent, prepend=False, append=False))  # a run begins, a run has ended
    begins = needed[np.maximum(edges[::2] - 1, 0)]
    ends = needed[np.minimum(edges[1::2], len(needed) - 1)]
    return Gaps(begins, ends, int(np.count_nonzero(is_absent)))


def gaps_in_truth(stamps: IntArray, true_ns: IntArray) -> Gaps:
    """Return the gaps between estimates of a truth; stamps of both go up."""
    nothing = np.empty(0, np.int64)
    if not len(stamps) or not len(true_ns):
        return Gaps(nothing, nothing, len(true_ns))
    usual_ns = np.median(np.diff(stamps)) if len(stamps) > 1 else 0
    within = stamps[(stamps > true_ns[0]) & (stamps < true_ns[-1])]
    known = np.concatenate([true_ns[:1], within, true_ns[-1:]])
    wide = np.flatnonzero(np.diff(known) > GAP_PERIODS * usual_ns)
    begins, ends = known[wide], known[wide + 1]
    is_inside = np.searchsorted(begins, true_ns, "right") > np.searchsorted(ends, true_ns, "left")
    missing = int(np.count_nonzero(~np.isin(true_ns[is_inside], stamps, assume_unique=True)))
    return Gaps(begins, ends, missing)


def sizes_of(gaps: Gaps, stamps: IntArray, true_ns: IntArray, travelled_m: FloatArray, images: int | None) -> GapSizes:
    """Return how much of a drive is in gaps: of the images, of the true path, or of the time if the rover stood."""
    gaps_s = (gaps.ends_ns - gaps.begins_ns) / NS_PER_S
    gaps_m = np.zeros(len(gaps_s))
    if len(true_ns) and len(gaps_s):
        since_ns = (true_ns - true_ns[0]).astype(np.float64)  # differences of stamps keep all digits
        begins = np.interp((gaps.begins_ns - true_ns[0]).astype(np.float64), since_ns, travelled_m)
        ends = np.interp((gaps.ends_ns - true_ns[0]).astype(np.float64), since_ns, travelled_m)
        gaps_m = ends - begins
    judged = 0.0
    if images:
        judged = 1.0 - gaps.missing / images
    elif len(stamps) and len(true_ns):
        whole, in_gaps = float(travelled_m[-1]), float(gaps_m.sum())
        if whole <= 0.0:
            whole, in_gaps = int(true_ns[-1] - true_ns[0]) / NS_PER_S, float(gaps_s.sum())
        judged = 1.0 - in_gaps / whole if whole > 0.0 else 1.0
    return GapSizes(float(gaps_m.max(initial=0.0)), float(gaps_s.max(initial=0.0)), 1.0 - judged)


def why_incomplete(gaps: Gaps, sizes: GapSizes, conditions: Sequence[Condition], images: int | None) -> str | None:
    """Return why an estimate does not cover the drive: it misses too much, or a whole sub-trajectory."""
    longest = {
        ConditionKind.DISTANCE: sizes.longest_m,
        ConditionKind.DISPLACEMENT: sizes.longest_m,
        ConditionKind.TIME: sizes.longest_s,
    }
    parts = [part for condition in conditions for part in condition.parts]
    hides_one = any(longest.get(part.kind, 0.0) > part.value for part in parts)
    if sizes.missing_share <= MISSING_SHARE and not hides_one:
        return None
    judged = 100.0 * (1.0 - sizes.missing_share)
    text = f"the estimate covers {judged:.4g} % of the {'images' if images else 'true path'}"
    if len(gaps.ends_ns):
        text += f", its longest gap is {sizes.longest_m:.4g} m and {sizes.longest_s:.4g} s"
    if images is None:
        text += "; where the truth is longer than the images, score against the source with its images"
    return text

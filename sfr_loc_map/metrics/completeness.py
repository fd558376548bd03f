"""What of a drive an estimate covers: a part of a drive is never a pass of the whole [4.1.1].

Where the images are known they are what has to be covered. Otherwise it is the truth's path: what lies between
neighbouring estimates counts as covered unless they are further apart than five of their usual periods, since truth is
often denser than images. docs/metrics.md, "The whole drive".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.association import taken
from sfr_loc_map.metrics.config import Condition, ConditionKind
from sfr_loc_map.metrics.score import AssociationCounts, Completeness

MISSING_SHARE = 0.01  #: An estimate that leaves out more is incomplete.
GAP_PERIODS = 5  #: Neighbouring estimates that are more of their usual periods apart cover nothing between them.
IMAGE_PERIOD_SHARE = 0.4  #: An estimate this near to an image, in periods, is its own: files round stamps.
DOUBLED_SHARE = 0.1  #: With more stamps that occur twice, and other poses at them, a file holds two runs.


def completeness(
    estimate: Trajectory,
    truth: Trajectory,
    counts: AssociationCounts,
    matched: int,
    conditions: Sequence[Condition],
    image_stamps_ns: IntArray | None,
    tolerance_ns: int,
) -> Completeness:
    """Return what of a drive is covered, where the score has `matched` frames; MetricsError for two runs in one."""
    order = np.argsort(estimate.stamps_ns, kind="stable")
    given_ns, given = taken(estimate.stamps_ns, order), taken(estimate.positions, order)
    again = np.flatnonzero(given_ns[1:] == given_ns[:-1]) + 1
    stamps = np.delete(given_ns, again) if len(again) else given_ns
    elsewhere = int(np.count_nonzero((given[again] != given[again - 1]).any(axis=1)))
    if elsewhere > DOUBLED_SHARE * len(stamps):
        raise MetricsError(
            f"the estimate holds two runs: {elsewhere} of its {len(given)} poses have the stamp of another elsewhere: "
            "give one"
        )
    true_ns, rows = np.unique(truth.stamps_ns, return_index=True)
    squares = sum(np.square(np.diff(axis)) for axis in taken(truth.positions, rows).T)  # less memory than `norm`
    travelled = np.append(0.0, np.cumsum(np.sqrt(squares)))
    begins, ends, missing, images = np.empty(0, np.int64), np.empty(0, np.int64), len(true_ns), None
    if image_stamps_ns is not None and len(image_stamps_ns):
        needed = np.unique(image_stamps_ns)
        near_ns = (
            max(tolerance_ns, int(IMAGE_PERIOD_SHARE * np.median(np.diff(needed)))) if len(needed) > 1 else tolerance_ns
        )
        first = np.searchsorted(stamps, needed - near_ns, "left")
        absent = first == np.searchsorted(stamps, needed + near_ns, "right")
        edges = np.flatnonzero(np.diff(absent, prepend=False, append=False))  # a run begins, a run has ended
        begins, ends = needed[np.maximum(edges[::2] - 1, 0)], needed[np.minimum(edges[1::2], len(needed) - 1)]
        missing, images = int(np.count_nonzero(absent)), len(needed)
    elif len(stamps) and len(true_ns):
        usual_ns = np.median(np.diff(stamps)) if len(stamps) > 1 else 0
        known = np.concatenate([true_ns[:1], stamps[(stamps > true_ns[0]) & (stamps < true_ns[-1])], true_ns[-1:]])
        wide = np.flatnonzero(np.diff(known) > GAP_PERIODS * usual_ns)
        begins, ends = known[wide], known[wide + 1]
        inside = np.searchsorted(begins, true_ns, "right") > np.searchsorted(ends, true_ns, "left")
        missing = int(np.count_nonzero(~np.isin(true_ns[inside], stamps, assume_unique=True)))
    gaps_s, gaps_m, share = (ends - begins) / NS_PER_S, np.zeros(len(ends)), 0.0
    if len(true_ns) and len(ends):  # differences of stamps, so that large ones lose nothing
        at, since = np.stack([begins, ends]) - true_ns[0], true_ns - true_ns[0]
        gaps_m = np.diff(np.interp(at.astype(np.float64), since.astype(np.float64), travelled), axis=0)[0]
    if images:
        share = 1.0 - missing / images
    elif len(stamps) and len(true_ns):
        whole, left_out = float(travelled[-1]), float(gaps_m.sum())
        if whole <= 0.0:  # the rover stood: time counts
            whole, left_out = int(true_ns[-1] - true_ns[0]) / NS_PER_S, float(gaps_s.sum())
        share = 1.0 - left_out / whole if whole > 0.0 else 1.0
    longest_m, longest_s = float(gaps_m.max(initial=0.0)), float(gaps_s.max(initial=0.0))
    longest = {ConditionKind.DISTANCE: longest_m, ConditionKind.DISPLACEMENT: longest_m, ConditionKind.TIME: longest_s}
    parts = [part for condition in conditions for part in (condition, *condition.others)]
    incomplete = None
    if 1.0 - share > MISSING_SHARE or any(longest.get(part.kind, 0.0) > part.value for part in parts):
        incomplete = f"the estimate covers {100.0 * share:.4g} % of the {'images' if images else 'true path'}"
        if len(ends):
            incomplete += f", its longest gap is {longest_m:.4g} m and {longest_s:.4g} s"
        if images is None:
            incomplete += "; where the truth is longer than the images, score against the source with its images"
    return Completeness(
        truth_poses=counts.truth_poses,
        images=images,
        matched=matched,
        missing=missing,
        lost=counts.lost,
        degraded=counts.degraded,
        unmatched_estimates=len(stamps) - matched,
        doubled_stamps=counts.estimate_duplicates,
        judged_share=share,
        missing_share=1.0 - share,
        lost_share=counts.lost / matched if matched else None,
        degraded_share=counts.degraded / matched if matched else None,
        unmatched_share=1.0 - matched / len(stamps) if len(stamps) else None,
        doubled_share=counts.estimate_duplicates / len(given_ns) if len(given_ns) else None,
        longest_gap_m=longest_m,
        longest_gap_s=longest_s,
        incomplete=incomplete,
    )

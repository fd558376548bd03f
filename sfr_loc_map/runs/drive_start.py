"""The pose at which a drive starts."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.stamped_poses import LONGEST_GAP_S
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.io.sequence import LocSequence
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.frames.association import nearness_ns

MAX_START_GAP_NS = round(LONGEST_GAP_S * NS_PER_S)
"""Longest gap of the truth in which the start pose is interpolated, ns; as in a score."""


def start_pose(sequence: LocSequence, start: str, from_ns: int = 0) -> StartPose:
    """Return the pose at which a drive starts, with its stamp.

    `identity`: the first pair has the identity as the pose of RB in DS. `truth`: the true pose at the first pair,
    interpolated if necessary. If the truth has a gap there, or if the pairs before `from_ns` are omitted, the next true
    pose is used; without a next true pose, the last true pose is used. Raises ConfigError for another value of `start`,
    and InputError for `truth` without true attitudes.
    """
    if start == "identity":
        return StartPose(Transform.identity())
    if start != "truth":
        raise ConfigError(f"start is '{start}': identity or truth is required")
    truth = sequence.ground_truth
    if truth is None or not len(truth):
        raise InputError(
            "the start 'truth' requires ground truth, which the source does not have: start at the identity"
        )
    if not truth.has_attitude:
        raise InputError(
            "the start 'truth' requires true attitudes, but the ground truth has only positions: start at the identity"
        )
    stamps = truth.stamps_ns
    first_ns = int(sequence.stamps_ns[0] if len(sequence) else stamps[0])
    wanted_ns = max(first_ns, from_ns)
    after = min(int(np.searchsorted(stamps, wanted_ns)), len(stamps) - 1)
    next_true_pose = StartPose(truth.pose(after), stamp_ns=int(stamps[after]))
    if wanted_ns > first_ns or after == 0:
        return next_true_pose
    before_ns, after_ns = int(stamps[after - 1]), int(stamps[after])
    if not before_ns < wanted_ns < after_ns or after_ns - before_ns > MAX_START_GAP_NS:
        return next_true_pose
    fraction = (wanted_ns - before_ns) / (after_ns - before_ns)
    return StartPose(interpolated(truth.pose(after - 1), truth.pose(after), fraction), stamp_ns=wanted_ns)


def true_start(sequence: LocSequence) -> StartPose:
    """Return the pose at which a drive starts: the true pose, or the identity without true attitudes."""
    truth = sequence.ground_truth
    has_attitude = truth is not None and len(truth) > 0 and truth.has_attitude
    return start_pose(sequence, "truth" if has_attitude else "identity")


def unstamped_start_warning(start: StartPose, sequence: LocSequence) -> str | None:
    """Return a warning if the start pose of a method under test and the first pair have different stamps.

    Our localiser uses the stamp of a start pose. The interface of methods has no such stamp, so that all poses of a
    method are offset by the motion between the two stamps. Stamps that differ by no more than the tolerance for stamps
    of one image (`nearness_ns`) count as equal.
    """
    if start.stamp_ns is None or not len(sequence):
        return None
    after_ns = start.stamp_ns - int(sequence.stamps_ns[0])
    if abs(after_ns) <= nearness_ns(np.asarray(sequence.stamps_ns, np.int64)):
        return None
    after_s = after_ns / NS_PER_S
    return (
        f"the start pose is the true pose {abs(after_s):.3g} s {'after' if after_s > 0.0 else 'before'} the first "
        "pair: all poses of the method, and errors without re-basing, are offset by the motion in this time"
    )

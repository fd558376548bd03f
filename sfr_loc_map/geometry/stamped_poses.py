"""Interpolation between stamped poses."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import itemgetter

from sfr_loc_map.geometry.transform import Transform, interpolated


def pose_at(poses: Sequence[tuple[int, Transform]], stamp_ns: int, max_gap_ns: int) -> Transform | None:
    """Return the pose of a stamp, interpolated between two poses at most `max_gap_ns` apart; None if there is none.

    The poses are in the order of their stamps, ns.
    """
    at = bisect_left(poses, stamp_ns, key=itemgetter(0))
    after_ns, after = poses[at] if at < len(poses) else (0, None)
    if after_ns == stamp_ns:
        return after
    before_ns, before = poses[at - 1] if at else (after_ns, None)
    if after is None or before is None or after_ns - before_ns > max_gap_ns:
        return None
    return interpolated(before, after, (stamp_ns - before_ns) / (after_ns - before_ns))

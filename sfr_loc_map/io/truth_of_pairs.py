"""True poses at the stamps of pairs, for layouts that have one pose an image."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.geometry.transform import Transform, interpolated


def poses_at(
    stamps_ns: Sequence[int], poses: Sequence[tuple[int, Transform]], max_gap_ns: int = 1_000_000_000
) -> list[Transform] | None:
    """Return the pose at each stamp: that of the same stamp, else between its neighbours.

    Args:
        stamps_ns: Stamps of the pairs, in order.
        poses: Stamps and poses, in order.
        max_gap_ns: Longest time between two poses over which a third is interpolated.

    Returns:
        One pose a stamp; None where one cannot be had.
    """
    found, after = [], 0
    for stamp in stamps_ns:
        while after < len(poses) and poses[after][0] < stamp:
            after += 1
        if after == len(poses):
            return None
        if poses[after][0] == stamp:
            found.append(poses[after][1])
            continue
        if after == 0:
            return None
        (before_ns, before), (after_ns, later) = poses[after - 1 : after + 1]
        if after_ns - before_ns > max_gap_ns:
            return None
        found.append(interpolated(before, later, (stamp - before_ns) / (after_ns - before_ns)))
    return found

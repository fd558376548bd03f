"""Interpolation between stamped poses, with constant velocity and constant turn rate.

`pose_at` returns one pose of a sequence of transforms. `sampled` returns many poses of a trajectory at once.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import itemgetter

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.rotation import slerp, unit_quats
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.message_stamps import NS_PER_S

LONGEST_GAP_S = 1.0  #: Longest time between two poses for interpolation between them, s.


def pose_at(poses: Sequence[tuple[int, Transform]], stamp_ns: int, max_gap_ns: int) -> Transform | None:
    """Return the pose at a stamp, interpolated between two poses at most `max_gap_ns` apart; None without such poses.

    `poses` are sorted by stamp, ns.
    """
    index = bisect_left(poses, stamp_ns, key=itemgetter(0))
    after_ns, after = poses[index] if index < len(poses) else (0, None)
    if after_ns == stamp_ns:
        return after
    before_ns, before = poses[index - 1] if index else (after_ns, None)
    if after is None or before is None or after_ns - before_ns > max_gap_ns:
        return None
    return interpolated(before, after, (stamp_ns - before_ns) / (after_ns - before_ns))


def sampled(poses: Trajectory, stamps_ns: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return interpolated positions `(S, 3)`, metres, and unit quaternions `(S, 4)` at stamps `(S,)`.

    There must be at least one pose, and the poses are sorted by stamp. A single pose is valid at all stamps. Before the
    first and after the last pose, the motion between the two nearest poses is extrapolated; use `covered` to select the
    stamps between poses.
    """
    if len(poses) == 1:
        quats_xyzw = unit_quats(poses.quats_xyzw)
        return np.repeat(poses.positions, len(stamps_ns), axis=0), np.repeat(quats_xyzw, len(stamps_ns), axis=0)
    known = poses.stamps_ns
    after = np.clip(np.searchsorted(known, stamps_ns, "right"), 1, len(known) - 1)
    before = after - 1
    fraction = (stamps_ns - known[before]) / np.maximum(known[after] - known[before], 1)
    positions = poses.positions[before] + fraction[:, None] * (poses.positions[after] - poses.positions[before])
    return positions, slerp(unit_quats(poses.quats_xyzw[before]), unit_quats(poses.quats_xyzw[after]), fraction)


def covered(known_ns: IntArray, stamps_ns: IntArray) -> Mask:
    """Return whether each stamp is a known stamp, or between two neighbouring known stamps within `LONGEST_GAP_S`.

    There must be at least one known stamp, and the known stamps are sorted.
    """
    after = np.searchsorted(known_ns, stamps_ns).clip(max=len(known_ns) - 1)
    before = np.where(known_ns[after] == stamps_ns, after, (after - 1).clip(0))
    near = known_ns[after] - known_ns[before] <= LONGEST_GAP_S * NS_PER_S
    return np.asarray((known_ns[before] <= stamps_ns) & (stamps_ns <= known_ns[after]) & near)

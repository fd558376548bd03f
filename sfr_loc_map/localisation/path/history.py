"""Past poses, to which external poses with past stamps are applied."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.localisation.uncertainty.path_errors import PathErrors
from sfr_loc_map.message_stamps import NS_PER_S

HISTORY_PAIRS = 1000  #: Number of past pairs to which an external pose can be applied: 100 s at 10 Hz.


class PastPose(NamedTuple):
    """A past pose and its errors, for the uncertainty of later poses relative to this pose."""

    stamp_ns: int
    T_world_left: Transform
    #: Whether the pair directly follows that of the previous past pose, without a refused or missing pair in between.
    follows_directly: bool
    position: FloatArray  #: `(3,)` position at which `errors` holds, m; `T_world_left` may be interpolated.
    errors: PathErrors  #: Errors of the pose.


class History(NamedTuple):
    """Past poses, oldest first."""

    poses: tuple[PastPose, ...] = ()

    @property
    def last_ns(self) -> int | None:
        """Stamp of the last pose; None if there is no past pose."""
        return self.poses[-1].stamp_ns if self.poses else None

    def with_pose(self, pose: PastPose) -> History:
        """Return the history with a further pose. The oldest pose is removed from a full history."""
        return History((*self.poses[-(HISTORY_PAIRS - 1) :], pose))

    def with_last(self, pose: PastPose) -> History:
        """Return the history with another last pose."""
        return History((*self.poses[:-1], pose))

    def at(self, stamp_ns: int) -> tuple[PastPose, float]:
        """Return the pose at a stamp, and the time between the returned pose and the stamp, s.

        The pose is interpolated between two consecutive pairs, and the errors are those of the later pair. Otherwise
        the nearest pose is returned, which is the last pose for a later stamp.
        """
        last = self.poses[-1]
        if stamp_ns > last.stamp_ns:
            return last, (stamp_ns - last.stamp_ns) / NS_PER_S
        after = bisect_left(self.poses, stamp_ns, key=lambda pose: pose.stamp_ns)
        later = self.poses[after]
        if later.stamp_ns == stamp_ns:
            return later, 0.0
        if after == 0:
            return later, (later.stamp_ns - stamp_ns) / NS_PER_S
        earlier = self.poses[after - 1]
        if later.follows_directly:
            fraction = (stamp_ns - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
            between = interpolated(earlier.T_world_left, later.T_world_left, fraction)
            return later._replace(stamp_ns=stamp_ns, T_world_left=between), 0.0
        nearest = min(earlier, later, key=lambda pose: abs(pose.stamp_ns - stamp_ns))
        return nearest, abs(nearest.stamp_ns - stamp_ns) / NS_PER_S

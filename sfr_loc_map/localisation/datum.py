"""Datum: where the world of the localiser is in DS, and the poses from outside that place it there.

The localiser estimates in a world of its own. A pose of RB in DS from outside (the start of the run, an operator) gives
the transform between the two. A pose with a stamp of the past is applied to the estimate of that stamp, so that the
motion since then is kept.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.localisation.uncertainty import DirectedError, DisparityBias, LocatedCovariance

HISTORY_PAIRS = 1000  #: Number of past pairs to which a pose from outside can be applied: 100 s at 10 Hz.
MAX_AHEAD_NS = 10 * NS_PER_S
"""Maximum lead of a pose's stamp over the images. A larger lead indicates another clock; the pose is then applied to
the next pair."""
MAX_START_AHEAD_NS = 600 * NS_PER_S  #: The same lead of the start pose, because a ground truth may begin later.


class PendingPose(NamedTuple):
    """A pose from outside that waits for the pair at or after its stamp."""

    pose: StartPose
    max_ahead_ns: int  #: Maximum lead of its stamp over the images.

    def stamp_at(self, stamp_ns: int) -> int:
        """Return the stamp at which the pose holds, if the newest pair has a given stamp."""
        stated = self.pose.stamp_ns
        if stated is None or stated > stamp_ns + self.max_ahead_ns:
            return stamp_ns
        return stated


@dataclass(frozen=True, slots=True, eq=False)
class Datum:
    """Place of the world in DS."""

    T_ds_world: Transform  #: Takes points in the world to DS.
    placed: StartPose  #: Pose from outside that defined `T_ds_world` last.
    pending: PendingPose | None = None  #: Pose from outside that is not applied yet.
    has_pairs: bool = False  #: Whether a pair has arrived.


class PastPose(NamedTuple):
    """A past pose, and what its covariance was composed of, so that a later pose can be taken relative to it."""

    stamp_ns: int
    T_world_left: Transform
    was_known: bool  #: Whether the pose before was not lost.
    window: int  #: Number of its window.
    in_window: LocatedCovariance  #: Covariance of the pose in its window.
    accumulated: LocatedCovariance  #: What all windows up to it added (`uncertainty.accumulated_covariance`).
    bias: DisparityBias  #: Path integrals up to it.
    directed: DirectedError  #: Sum of the directed errors up to it.


class History(NamedTuple):
    """Past poses, oldest first."""

    poses: tuple[PastPose, ...] = ()

    @property
    def last_ns(self) -> int | None:
        """Stamp of the last pose; None without any."""
        return self.poses[-1].stamp_ns if self.poses else None

    def with_pose(self, pose: PastPose) -> History:
        """Return the history with a further pose; the oldest one leaves a full history."""
        return History((*self.poses[-(HISTORY_PAIRS - 1) :], pose))

    def at(self, stamp_ns: int) -> tuple[PastPose, float]:
        """Return the pose at a stamp that is not after the last pose, and the time between it and the stamp, s.

        The pose is interpolated between two pairs if the pose of the earlier one was known; otherwise the nearest pose
        is returned. The errors are those of the later pair. Stamps increase.
        """
        after = bisect_left(self.poses, stamp_ns, key=lambda pose: pose.stamp_ns)
        later = self.poses[after]
        if later.stamp_ns == stamp_ns:
            return later, 0.0
        if after == 0:
            return later, (later.stamp_ns - stamp_ns) / NS_PER_S
        earlier = self.poses[after - 1]
        if later.was_known:
            fraction = (stamp_ns - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
            between = interpolated(earlier.T_world_left, later.T_world_left, fraction)
            return later._replace(stamp_ns=stamp_ns, T_world_left=between), 0.0
        nearest = min(earlier, later, key=lambda pose: abs(pose.stamp_ns - stamp_ns))
        return nearest, abs(nearest.stamp_ns - stamp_ns) / NS_PER_S

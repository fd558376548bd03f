"""Datum: where the world of the localiser is in DS, and the poses from outside that place it there.

The localiser estimates in a world of its own. A pose of RB in DS from outside (the start of the run, an operator) gives
the transform between the two. A pose with a stamp of the past is applied to the estimate of that stamp (`history`), so
that the motion since then is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.estimate import StartPose

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

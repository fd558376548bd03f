"""Datum: pose of the localiser's world in DS, and the external poses that define it.

The localiser estimates poses in its own world frame. An external pose of RB in DS (the start of the run, or set by an
operator) defines the transform between the two frames. An external pose with a past stamp is applied to the estimate at
that stamp (`history`), so that the motion since then is preserved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.message_stamps import NS_PER_S

MAX_AHEAD_NS = 10 * NS_PER_S
"""Maximum lead of a pose's stamp over the images. A larger lead indicates a different clock; the pose is then applied
to the next pair."""
MAX_START_AHEAD_NS = 600 * NS_PER_S  #: Maximum lead of a start pose, larger because a ground truth may begin late.


class PendingPose(NamedTuple):
    """An external pose that waits for the pair at or after its stamp."""

    pose: StartPose
    max_ahead_ns: int  #: Maximum lead of the pose's stamp over the images.

    def stamp_at(self, stamp_ns: int) -> int:
        """Return the stamp at which the pose is valid, given the stamp of the newest pair."""
        stated = self.pose.stamp_ns
        if stated is None or stated > stamp_ns + self.max_ahead_ns:
            return stamp_ns
        return stated


@dataclass(frozen=True, slots=True, eq=False)
class Datum:
    """Pose of the world in DS."""

    T_ds_world: Transform  #: Takes points in the world to DS.
    placed: StartPose  #: Last external pose that was applied at the end of the path, not at a past pose.
    pending: PendingPose | None = None  #: External pose that is not applied yet.
    #: Stamp of the last external pose with which the map was kept; None if the map was discarded since then. If this
    #: stamp is later than the last accepted pair, the motion of a kept pose is unobserved since this stamp.
    rebased_ns: int | None = None

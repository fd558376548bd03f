"""State of the path: last pose, datum, accumulated errors, pose published last, and past poses.

The localiser estimates poses in its own world frame. An external pose of RB in DS (the start of the run, or set by an
operator) defines the transform between the two frames, which is the datum.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.path.history import History
from sfr_loc_map.localisation.uncertainty.inflation import unobserved_during
from sfr_loc_map.localisation.uncertainty.path_errors import PathErrors
from sfr_loc_map.localisation.uncertainty.published_pose import PublishedPose
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel
from sfr_loc_map.message_stamps import NS_PER_S


@dataclass(frozen=True, slots=True, eq=False)
class Datum:
    """Pose of the localiser's world frame in DS, and the external pose that will change it next (`external_poses`)."""

    T_ds_world: Transform  #: Takes points in the world to DS.
    #: External pose that waits for its stamp. Before the first pair: the start pose, which is already applied.
    pending: StartPose | None = None
    pending_ns: int | None = None  #: Stamp at which the pending pose is valid; None until the next pair decides this.
    #: Stamp of the last external pose to which the map was anchored; None if the map was discarded since then. If this
    #: stamp is later than the last accepted pair, the motion of a kept pose is unobserved since this stamp.
    anchored_ns: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PathState:
    """Poses and accumulated errors so far."""

    last: LastPose  #: Last known pose in the present map, and the motion to it.
    datum: Datum  #: Pose of the world in DS.
    errors: PathErrors  #: Components of the covariance of the pose.
    published: PublishedPose  #: The pose published last, at which the next step starts.
    history: History = History()  #: Past poses, to which an external pose can be applied.
    arrived_ns: int | None = None  #: Stamp of the newest pair, refused or not; None before the first pair.
    period_ns: int = 0  #: Time between the newest two pairs, refused or not; 0 before the second pair.

    def unobserved_of_left(self, stamp_ns: int, model: RoverModel) -> FloatArray:
        """Return the covariance `(6, 6)` of the unobserved motion up to a stamp, for the left camera in the world."""
        unobserved_s = self.last.unobserved_s(stamp_ns)
        anchored_ns = self.datum.anchored_ns
        if anchored_ns is not None:  # a later external pose is the kept pose itself at its stamp
            unobserved_s = min(unobserved_s, (stamp_ns - anchored_ns) / NS_PER_S)
        return model.covariance_at(self.last.T_world_left, unobserved_during(self.last.speed, unobserved_s, model))

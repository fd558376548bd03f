"""State of the localiser between two pairs, and the outcome of one pair.

Each call takes a state and returns the next one. `transitions` contains all changes, with a table of the events.

An external pose is applied in one of two ways (`path.external_poses`): the map is anchored to the pose, or the map is
discarded and the path is reset at the pose. Three stamps of the path answer different questions:

| stamp | question | changed by |
|---|---|---|
| `path.last.known_ns` | since when is the motion unobserved? | accepted pair, new window, reset; first pair |
| `path.last.accepted_ns` | from which pair are missing pairs counted? | accepted pair, new window |
| `path.history.last_ns` | what is the last pair to which an external pose can apply? | accepted pair, new window; |
| | | None after a reset |

The three stamps are equal after an accepted pair and after a pair that begins a window. The other stamps and poses:

| value | meaning | changed by |
|---|---|---|
| `path.last.T_world_left` | last known pose, in the present map | accepted pair; adjustment of a keyframe |
| `path.published` | pose published last, where the next step begins | accepted or kept pair, new window; |
| | | adjustment of a keyframe with a yaw correction |
| `path.datum.anchored_ns` | stamp since which a kept pose is unobserved, if later | anchoring; None after a reset |
| `path.datum.pending` | external pose that is not applied yet | `set_pose`; first pair; when the pose is applied |
| `path.datum.pending_ns` | stamp at which that pose applies | like `pending`; pair after `set_pose` |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.estimate import StateReason, StepEstimate, TrackingState, TrackingStatistics
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.memory import GroundMemory
from sfr_loc_map.localisation.guards import ShearMean
from sfr_loc_map.localisation.keyframes import KeyframeJob
from sfr_loc_map.localisation.path.path_state import PathState
from sfr_loc_map.localisation.relocalisation import RecoveryImages
from sfr_loc_map.localisation.stale_images import ImageMemory


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """State that persists between two pairs, except for the keyframe that is being made in the background."""

    path: PathState  #: Last pose, datum, history and accumulated errors.
    calibration: OnlineCalibration  #: Rotation error of the right camera.
    ground_memory: GroundMemory  #: Memory of the selection of the ground.
    landmark_map: LandmarkMap | None = None  #: Window and landmarks; None before a window has begun.
    recovery: RecoveryImages = RecoveryImages()  #: Images from which lost tracking can be recovered.
    failed_recoveries: int = 0  #: Number of good images with a refused pose since the last accepted pair.
    image_memory: ImageMemory | None = None  #: Memory of the check for stale images.
    shear_mean: ShearMean = ShearMean()  #: Memory of the check for sheared rows.
    keyframes: int = 0  #: Number of keyframes since the start.
    #: Number of further keyframes until an unobserved motion before the window no longer degrades the poses.
    gap_keyframes: int = 0
    #: Whether an adjustment has diverged since the last window began. An external pose that discards the map resets
    #: the value.
    has_diverged: bool = False
    status: TrackingState = TrackingState.INITIALISING  #: State published last.
    reason: StateReason | None = None  #: Reason published last.


class Outcome(NamedTuple):
    """The outcome of one pair."""

    state: State
    statistics: TrackingStatistics
    tracks: Tracks | None = None  #: Tracked landmarks, trusted or not; None if nothing was tracked.
    step: StepEstimate | None = None  #: Step to the pose; None if lost.
    keyframe: KeyframeJob | None = None  #: Keyframe job; None if the pair does not become a keyframe.

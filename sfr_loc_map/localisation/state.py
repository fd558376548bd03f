"""State of the localiser between two pairs, and what one pair leads to.

Several stamps and two poses in the state look similar. Each has one meaning, and few pairs change it: an accepted one
(A), a kept one (K), one that begins a window (W), or another event.

| value | meaning | changed by |
|---|---|---|
| `path.last.T_world_left` | last known pose, in the present map | A; adjustment of a keyframe |
| `path.published.T_world_left` | pose published last, where the next step begins | A, K, W |
| `path.published.stamp_ns` | its stamp | A, K, W |
| `path.last.known_ns` | stamp since which the motion is unseen | A, W; first pair; pose from outside |
| `path.last.tracked_ns` | stamp from which missing pairs are counted | A, W |
| `path.history.last_ns` | last stamp to which a pose from outside can be applied | A, W; pose from outside after it |
| `path.datum.pending` | pose from outside that is not applied yet | `set_pose`; first pair; when it is applied |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.estimate import StateReason, StepEstimate, TrackingState, TrackingStatistics
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground_memory import GroundMemory
from sfr_loc_map.localisation.guards import ShearMean
from sfr_loc_map.localisation.keyframes import KeyframeJob
from sfr_loc_map.localisation.relocalisation import RecoveryImages
from sfr_loc_map.localisation.stale_images import ImageMemory
from sfr_loc_map.localisation.trajectory import PathState


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Everything that is known between two pairs, except for the keyframe that is being made in the background."""

    path: PathState  #: Last pose, datum, history and accumulated errors.
    calibration: OnlineCalibration  #: Rotation error of the right camera.
    ground_memory: GroundMemory  #: Memory of the selection of the ground.
    landmark_map: LandmarkMap | None = None  #: Window and landmarks; None before a window has begun.
    recovery: RecoveryImages = RecoveryImages()  #: Images that lost tracking can be recovered from.
    failed_recoveries: int = 0  #: Number of good images with a refused pose since the last accepted pair.
    image_memory: ImageMemory | None = None  #: Memory of the check for stale images.
    shear_mean: ShearMean = ShearMean()  #: Memory of the check for sheared rows.
    keyframes: int = 0  #: Number of keyframes since the start.
    #: Number of the keyframe from which a window is no longer degraded by a gap before it.
    clean_from_keyframe: int = 0
    status: TrackingState = TrackingState.INITIALISING  #: State published last; a lost pose is not continued.
    reason: StateReason | None = None  #: Reason published last.


class Outcome(NamedTuple):
    """What one pair leads to."""

    state: State
    statistics: TrackingStatistics
    tracks: Tracks | None = None  #: What was tracked, trusted or not; None if nothing was.
    step: StepEstimate | None = None  #: Step to the pose; None if lost.
    keyframe: KeyframeJob | None = None  #: Work of the keyframe that the pair becomes.

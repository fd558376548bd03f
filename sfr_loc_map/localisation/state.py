"""State of the localiser between two pairs, and the outcome of one pair.

Each call takes a state and returns the next one. A pair changes these parts of the state:

| pair | changes |
|---|---|
| accepted (`_accept`) | all but `clean_from_keyframe` and `has_diverged` |
| kept (`_keep`) | path (covariance and step), status, reason |
| lost (`_lose`) | path (a standstill is predicted), memory of the ground (identification restarts), status, reason |
| | number of failed recoveries (after a good image) |
| begins a window (`_begin`) | all but `shear_mean`; the window starts at the last known pose |

Five other events change the state:

- A keyframe of the previous call is finished: path (pose, errors and last past pose), map, calibration, recovery
  images, and the pose of the earlier image in the memory of the ground. If its adjustment diverged, the map is
  discarded, the calibration is reset and `has_diverged` is set instead.
- An external pose is applied: path. `trajectory._placed` applies a pose whose stamp is more than 1.5 periods later
  than the last pair that was accepted or began a window, and any pose before the first such pair. The map is then
  discarded, and `has_diverged` is reset. `trajectory._rebased` applies any other pose.
- A pair arrives: path (its stamp; with the first pair also the stamp of the start pose).
- `set_pose` is called: path.
- `reset` is called: all.

Two memories also change with refused pairs. `image_memory` changes with every pair that does not repeat the previous
pair. `ground_memory` changes with every pair that has stale rows, whose image contradicts its pose, or that is lost. A
pair whose image contradicts its pose is the only refused pair from which a memory learns (`outlasts_refusal`). If
the localiser is already lost, a pair that would otherwise be kept is lost as well, and counts as a failed recovery if
its images are new and good.

The state contains several similar stamps and poses. The table gives the meaning of each, and the events that change
it: an accepted pair (A), a kept pair (K), a pair that begins a window (W), or another event.

| value | meaning | changed by |
|---|---|---|
| `path.last.T_world_left` | last known pose, in the present map | A; adjustment of a keyframe |
| `path.published.T_world_left` | pose published last, where the next step begins | A, K, W |
| `path.published.stamp_ns` | stamp of the pose published last | A, K, W |
| `path.last.known_ns` | stamp since which the motion is unobserved | A, W; first pair; `_placed` |
| `path.last.tracked_ns` | stamp from which missing pairs are counted | A, W |
| `path.history.last_ns` | last stamp to which an external pose can be applied | A, W; None after `_placed` |
| `path.datum.rebased_ns` | stamp since which a kept pose is unobserved, if later | `_rebased`; None after `_placed` |
| `path.datum.pending` | external pose that is not applied yet | `set_pose`; first pair; when the pose is applied |
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
from sfr_loc_map.localisation.relocalisation import RecoveryImages
from sfr_loc_map.localisation.stale_images import ImageMemory
from sfr_loc_map.localisation.trajectory import PathState


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
    #: Number of the first keyframe at which a preceding gap no longer degrades the window.
    clean_from_keyframe: int = 0
    #: Whether an adjustment diverged, and neither a window has begun nor the map was discarded for an external pose
    #: since then.
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

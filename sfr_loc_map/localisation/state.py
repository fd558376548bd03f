"""State of the localiser between two pairs, with all of its changes, and the values of one pair that change it.

The state is one immutable value. Its methods, one for each event, are its only changes (`Localiser` stores the
results). An event has the same name here and in the components of the state that it changes.

| event | method | changes |
|---|---|---|
| start of a run, `reset` | `started` | all |
| an external pose is set | `pose_set` | path (waiting pose; before the first pair, also datum and errors) |
| its stamp is reached | `pose_applied` | path; if the map is discarded, also map and `has_diverged` |
| keyframe of the previous call is adjusted | `adjusted` | path (pose, errors, last past pose, error of the next |
| | | step), map, calibration, recovery images, memory of the ground (pose of the earlier image) |
| its adjustment was singular or diverged | `diverged` | no map, calibration starts again, `has_diverged` |
| pair arrives | `arrived` | path (stamps), image memory, memory of the ground (stale rows) |
| pair is accepted | `accepted` | all but `has_diverged` and the image memory |
| pair is refused because of its pose | `refused` | memory of the ground, only if the image contradicts the pose |
| pair is refused, may begin a window, and its | `recovery_failed` | number of failed recoveries |
| images are good | | |
| refused pair is kept | `kept` | path (covariance and step), status, reason |
| refused pair is lost | `lost` | path (a standstill is predicted), memory of the ground (learnt again), |
| | | status, reason |
| pair has too few landmarks to begin a window | `window_failed` | memory of the ground (excluded cells age) |
| pair begins a window | `window_begun` | all but `shear_mean` and the image memory |

The state learns from the pose of a pair in `accepted` only, with one exception: the memory of the ground also learns
from a refused pair whose image contradicts its pose (`GroundMemory.after_verdict`). The image memory changes with every
pair that does not repeat the previous pair.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.estimate import StartPose, StateReason, StepEstimate, TrackingState, TrackingStatistics
from sfr_loc_map.localisation.findings import Action, Verdict
from sfr_loc_map.localisation.frontend.right_camera import NO_SHEAR, RowShear
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.ground.memory import GroundMemory
from sfr_loc_map.localisation.ground.selection import Ground
from sfr_loc_map.localisation.guards import ShearMean
from sfr_loc_map.localisation.keyframes import KeyframeJob, KeyframeResult
from sfr_loc_map.localisation.path import PathState
from sfr_loc_map.localisation.relocalisation import RecoveryImages
from sfr_loc_map.localisation.stale_images import ImageComparison, ImageMemory
from sfr_loc_map.localisation.uncertainty.error_sources import RoverModel
from sfr_loc_map.localisation.uncertainty.pose_covariance import AcceptedPair


class Candidate(NamedTuple):
    """A pair whose pose is to be judged."""

    frame: StereoFrame
    #: The map, in which landmarks that do not move with the ground are no longer tracked. Their earlier observations
    #: remain in the window (`SlidingWindow.deactivated`).
    landmark_map: LandmarkMap
    ground: Ground
    tracks: Tracks  #: Tracks of the ground with corrected right observations, and their pose.
    calibration: OnlineCalibration  #: The calibration, updated by the pair.
    shear_mean: ShearMean  #: The running mean, updated by the pair.
    shear: RowShear = NO_SHEAR  #: Shear of the rows of this pair.


class State(NamedTuple):
    """State that persists between two pairs, except for the keyframe that is being made in the background."""

    path: PathState  #: Last pose, datum, past poses and accumulated errors.
    calibration: OnlineCalibration  #: Rotation error of the right camera.
    ground_memory: GroundMemory  #: Memory of the selection of the ground.
    landmark_map: LandmarkMap | None = None  #: Window and landmarks; None before a window has begun.
    recovery: RecoveryImages = RecoveryImages()  #: Images from which lost tracking can be recovered.
    #: Number of refused pairs with good images since the last pair that was accepted or began a window.
    failed_recoveries: int = 0
    image_memory: ImageMemory | None = None  #: Memory of the check for stale images.
    shear_mean: ShearMean = ShearMean()  #: Memory of the check for sheared rows.
    keyframes: int = 0  #: Number of keyframes since the start.
    #: Number of further keyframes during which an unobserved motion before the window degrades the poses.
    gap_keyframes: int = 0
    #: Whether an adjustment has diverged since the last window began. An external pose that discards the map resets
    #: the value.
    has_diverged: bool = False
    status: TrackingState = TrackingState.INITIALISING  #: State published last.
    reason: StateReason | None = None  #: Reason published last.

    @classmethod
    def started(cls, start: StartPose, calibration: OnlineCalibration, model: RoverModel) -> State:
        """Return the state before the first pair."""
        return cls(PathState.started(start, model), calibration, GroundMemory.none(calibration.shape))

    # ---- before the stages of a pair

    def pose_set(self, pose: StartPose, model: RoverModel) -> State:
        """Return the state with an external pose, which is applied once its stamp is reached."""
        return self._replace(path=self.path.pose_set(pose, model))

    def adjusted(self, result: KeyframeResult, model: RoverModel) -> State:
        """Return the state with the adjusted map, pose and calibration of a keyframe."""
        landmark_map = result.landmark_map
        path = self.path.adjusted(landmark_map, model, has_yaw_step=result.has_yaw_step)
        T_after_before = path.last.T_world_left @ self.path.last.T_world_left.inverse()
        return self._replace(
            path=path,
            ground_memory=self.ground_memory.adjusted(T_after_before),
            landmark_map=landmark_map,
            calibration=result.calibration,
            recovery=self.recovery.adjusted(landmark_map.landmarks),
        )

    def diverged(self) -> State:
        """Return the state after an adjustment that was singular or diverged. A window may begin at the last pose.

        The map and the estimates of the calibration are discarded. The sums of the path continue. Corrections of the
        yaw up to here then count as errors (`disparity` in `uncertainty`), because the yaw that they were based on is
        discarded.
        """
        return self._replace(landmark_map=None, calibration=self.calibration.diverged(), has_diverged=True)

    def arrived(self, images: ImageComparison, stamp_ns: int) -> State:
        """Return the state after a pair arrived and was compared with the previous pair."""
        return self._replace(
            path=self.path.arrived(stamp_ns),
            image_memory=images.memory,
            ground_memory=self.ground_memory.rows_stale(images.blanked_rows),
        )

    # ---- an accepted pair

    def accepted(
        self, candidate: Candidate, verdict: Verdict, model: RoverModel, *, is_reference: bool, is_keyframe: bool
    ) -> tuple[State, StepEstimate]:
        """Return the state after an accepted pair, and the step to its pose.

        Args:
            candidate: The pair with its final pose.
            verdict: Verdict on the pair.
            model: Extrinsics, camera geometry, bounds and error sources.
            is_reference: Whether lost tracking may be recovered from the pair.
            is_keyframe: Whether the pair becomes a keyframe.
        """
        tracks = candidate.tracks
        pair = AcceptedPair(
            stamp_ns=candidate.frame.stamp_ns,
            T_world_left=Transform(*tracks.pose),
            given_keyframes=np.asarray(np.linalg.inv(tracks.information)),
            tracked_depth_m=tracks.landmarks.median_depth,
            chi_median=tracks.chi_median,
            landmark_map=candidate.landmark_map,
            calibration=candidate.calibration,
            was_known=self.status is not TrackingState.LOST,
            shear=candidate.shear,
            inflation=verdict.inflation,
            other_distance=candidate.ground.other_distance,
        )
        path, step = self.path.accepted(pair, model)
        recovery = self.recovery
        if is_reference:
            recovery = recovery.accepted(candidate.frame.image, tracks)
        after = self._replace(
            path=path,
            landmark_map=candidate.landmark_map,
            calibration=candidate.calibration,
            shear_mean=candidate.shear_mean,
            ground_memory=self.ground_memory.after_verdict(candidate.ground.learnt, verdict),
            recovery=recovery,
            failed_recoveries=0,
            keyframes=self.keyframes + int(is_keyframe),
            gap_keyframes=max(self.gap_keyframes - int(is_keyframe), 0),
            status=TrackingState.TRACKING if verdict.action is Action.ACCEPT else TrackingState.DEGRADED,
            reason=verdict.reason,
        )
        return after, step

    # ---- a refused pair

    def refused(self, candidate: Candidate, verdict: Verdict) -> State:
        """Return the state after the pose of a pair was refused, before the pair is kept, lost or begins a window."""
        return self._replace(ground_memory=self.ground_memory.after_verdict(candidate.ground.learnt, verdict))

    def recovery_failed(self) -> State:
        """Return the state after a further refused pair with good images."""
        return self._replace(failed_recoveries=self.failed_recoveries + 1)

    def window_failed(self) -> State:
        """Return the state after a textured pair with too few landmarks for a window, before the pair is lost."""
        return self._replace(ground_memory=self.ground_memory.window_failed(self.calibration.shape))

    def kept(self, reason: StateReason | None, stamp_ns: int, model: RoverModel) -> tuple[State, StepEstimate]:
        """Return the state in which the last pose is published again with a larger covariance, and the step to it."""
        path, step = self.path.kept(stamp_ns, model)
        return self._replace(path=path, status=TrackingState.DEGRADED, reason=reason), step

    def lost(self, reason: StateReason | None) -> State:
        """Return the state in which the pose is unknown."""
        return self._replace(
            path=self.path.lost(), ground_memory=self.ground_memory.lost(), status=TrackingState.LOST, reason=reason
        )

    # ---- a new window

    def gap_keyframes_at_window(self, stamp_ns: int, window_keyframes: int) -> int:
        """Return `gap_keyframes` after a pair begins a window.

        After an unobserved motion, the poses are degraded until the window is full. Otherwise, an earlier count
        continues, because the pair is a keyframe.
        """
        if self.path.last.has_gap(stamp_ns):
            return window_keyframes - 1
        return max(self.gap_keyframes - 1, 0)

    def window_begun(
        self, frame: StereoFrame, window: KeyframeResult, verdict: Verdict, gap_keyframes: int, model: RoverModel
    ) -> tuple[State, StepEstimate]:
        """Return the state after a pair began a window at the last known pose, and the step to this pose.

        `gap_keyframes` is the number that `gap_keyframes_at_window` returned, on which the verdict depends, too.
        """
        landmark_map = window.landmark_map
        keyframes = self.keyframes + 1
        status = TrackingState.DEGRADED
        if verdict.action is Action.ACCEPT:
            status = TrackingState.INITIALISING if keyframes == 1 else TrackingState.TRACKING
        path, step = self.path.window_begun(frame.stamp_ns, landmark_map, model)
        after = self._replace(
            path=path,
            landmark_map=landmark_map,
            calibration=window.calibration,
            recovery=RecoveryImages.window_begun(frame.image, landmark_map.landmarks),
            failed_recoveries=0,
            ground_memory=self.ground_memory.window_begun(frame, Pose.of(self.path.last.T_world_left)),
            keyframes=keyframes,
            gap_keyframes=gap_keyframes,
            has_diverged=False,
            status=status,
            reason=verdict.reason,
        )
        return after, step

    # ---- after the stages of a pair

    def pose_applied(self, stamp_ns: int, model: RoverModel) -> State:
        """Return the state after a pair, with a waiting external pose applied if its stamp is reached."""
        if self.path.datum.waiting is None:
            return self
        path, discards_map = self.path.pose_applied(stamp_ns, model)
        if discards_map:
            # the next window begins at the external pose and continues no window that diverged
            return self._replace(path=path, landmark_map=None, has_diverged=False)
        return self._replace(path=path)


class Outcome(NamedTuple):
    """The outcome of one pair."""

    state: State
    statistics: TrackingStatistics
    tracks: Tracks | None = None  #: Tracked landmarks, trusted or not; None if nothing was tracked.
    step: StepEstimate | None = None  #: Step to the pose; None if lost.
    keyframe: KeyframeJob | None = None  #: Keyframe job; None if the pair does not become a keyframe.

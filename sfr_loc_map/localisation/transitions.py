"""Changes of the state: one function for each event. Nothing else changes the state (`Localiser` stores the results).

An event has the same name here and in the components of the state that it changes.

| event | function | changes |
|---|---|---|
| start of a run, `reset` | `started` | all |
| an external pose is set | `pose_set` | path (pending pose; before the first pair, also datum and errors) |
| its stamp is reached | `pose_applied` | path; if the map is discarded, also map and `has_diverged` |
| keyframe of the previous call is adjusted | `adjusted` | path (pose, errors, last past pose, error of the next |
| | | step), map, calibration, recovery images, memory of the ground (pose of the earlier image) |
| its adjustment was singular or diverged | `diverged` | no map, calibration starts again, `has_diverged` |
| pair arrives | `arrived` | path (stamps), image memory, memory of the ground (stale rows) |
| pair is accepted | `accepted` | all but `has_diverged` and the image memory |
| pair is refused because of its pose | `refused` | memory of the ground, only if the image contradicts the pose |
| and its images are good | `recovery_failed` | number of failed recoveries |
| refused pair is kept | `kept` | path (covariance and step), status, reason |
| refused pair is lost | `lost` | path (a standstill is predicted), memory of the ground (learnt again), |
| | | status, reason |
| pair cannot begin a window | `window_failed` | memory of the ground (excluded cells may age) |
| pair begins a window | `window_begun` | all but `shear_mean` and the image memory |

What is learnt from the pose of a pair changes in `accepted` only, with one exception: the memory of the ground also
learns from a refused pair whose image contradicts its pose (`Ground.memory_after`). The image memory changes with
every pair that does not repeat the previous pair.
"""

from __future__ import annotations

from dataclasses import replace

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.candidate import Candidate, FinalPose
from sfr_loc_map.localisation.estimate import StartPose, StateReason, StepEstimate, TrackingState
from sfr_loc_map.localisation.findings import Action, Verdict
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.ground.memory import GroundMemory
from sfr_loc_map.localisation.keyframes import KeyframeResult
from sfr_loc_map.localisation.path import external_poses, trajectory
from sfr_loc_map.localisation.relocalisation import RecoveryImages
from sfr_loc_map.localisation.stale_images import ImageComparison
from sfr_loc_map.localisation.state import State
from sfr_loc_map.localisation.uncertainty.accepted_pair import AcceptedPair
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel


def started(start: StartPose, calibration: OnlineCalibration, model: RoverModel) -> State:
    """Return the state before the first pair."""
    return State(
        path=external_poses.started(start, model),
        calibration=calibration,
        ground_memory=GroundMemory.none(calibration.shape),
    )


# ---- before the stages of a pair


def pose_set(state: State, pose: StartPose, model: RoverModel) -> State:
    """Return the state with an external pose, which is applied once its stamp is reached."""
    return replace(state, path=external_poses.pose_set(state.path, pose, model))


def adjusted(state: State, result: KeyframeResult, model: RoverModel) -> State:
    """Return the state with the adjusted map, pose and calibration of a keyframe."""
    window = result.landmark_map.window
    path = trajectory.adjusted(state.path, window, model, has_yaw_step=result.has_yaw_step)
    T_after_before = path.last.T_world_left @ state.path.last.T_world_left.inverse()
    return replace(
        state,
        path=path,
        ground_memory=state.ground_memory.adjusted(T_after_before),
        landmark_map=result.landmark_map,
        calibration=result.calibration,
        recovery=state.recovery.adjusted(result.landmark_map.landmarks),
    )


def diverged(state: State) -> State:
    """Return the state after an adjustment that was singular or diverged. A new window may begin at the last pose.

    The map and the estimates of the calibration are discarded. The sums of the path continue. Corrections of the yaw up
    to here then count as errors (`disparity` in `uncertainty`), because the yaw that they were based on is discarded.
    """
    return replace(state, landmark_map=None, calibration=state.calibration.diverged(), has_diverged=True)


def arrived(state: State, images: ImageComparison, stamp_ns: int) -> State:
    """Return the state after a pair arrived and was compared with the previous pair."""
    return replace(
        state,
        path=trajectory.arrived(state.path, stamp_ns),
        image_memory=images.memory,
        ground_memory=state.ground_memory.rows_stale(images.blanked_rows),
    )


# ---- an accepted pair


def accepted(
    state: State, candidate: Candidate, verdict: Verdict, final: FinalPose, chi_median: float, model: RoverModel
) -> tuple[State, StepEstimate]:
    """Return the state after an accepted pair, and the step to its pose.

    Args:
        state: State before the pair.
        candidate: The pair that was judged.
        verdict: Verdict on the pair.
        final: Final pose of the pair.
        chi_median: Median squared Mahalanobis residual of the final pose per degree of freedom; NaN without residuals.
        model: Extrinsics, camera geometry, bounds and error sources.
    """
    pair = AcceptedPair(
        stamp_ns=candidate.frame.stamp_ns,
        tracks=final.tracks,
        landmark_map=candidate.landmark_map,
        calibration=candidate.corrected.calibration,
        chi_median=chi_median,
        was_known=state.status is not TrackingState.LOST,
        shear_chi2=candidate.corrected.shear_chi2,
        inflation=verdict.inflation,
        other_distance=candidate.ground.other_distance,
    )
    path, step = trajectory.accepted(state.path, pair, model)
    recovery = state.recovery
    if final.is_recovery_image:
        recovery = recovery.accepted(candidate.frame.image, final.tracks)
    after = replace(
        state,
        path=path,
        landmark_map=candidate.landmark_map,
        calibration=candidate.corrected.calibration,
        shear_mean=candidate.corrected.shear_mean,
        ground_memory=candidate.ground.memory_after(verdict, state.ground_memory),
        recovery=recovery,
        failed_recoveries=0,
        keyframes=state.keyframes + int(final.is_keyframe),
        gap_keyframes=max(state.gap_keyframes - int(final.is_keyframe), 0),
        status=TrackingState.TRACKING if verdict.action is Action.ACCEPT else TrackingState.DEGRADED,
        reason=verdict.reason,
    )
    return after, step


# ---- a refused pair


def refused(state: State, candidate: Candidate, verdict: Verdict) -> State:
    """Return the state after the pose of a pair was refused, before the pair is kept, lost or begins a window."""
    return replace(state, ground_memory=candidate.ground.memory_after(verdict, state.ground_memory))


def recovery_failed(state: State) -> State:
    """Return the state after a further good image whose pose was refused."""
    return replace(state, failed_recoveries=state.failed_recoveries + 1)


def window_failed(state: State, verdict: Verdict) -> State:
    """Return the state after a pair could not begin a window, before the pair is lost."""
    if not verdict.ages_excluded_cells:
        return state
    return replace(state, ground_memory=state.ground_memory.window_failed(state.calibration.shape))


def kept(state: State, reason: StateReason | None, stamp_ns: int, model: RoverModel) -> tuple[State, StepEstimate]:
    """Return the state in which the last pose is published again with a larger covariance, and the step to it."""
    path, step = trajectory.kept(state.path, stamp_ns, model)
    return replace(state, path=path, status=TrackingState.DEGRADED, reason=reason), step


def lost(state: State, reason: StateReason | None) -> State:
    """Return the state in which the pose is unknown."""
    return replace(
        state,
        path=trajectory.lost(state.path),
        ground_memory=state.ground_memory.lost(),
        status=TrackingState.LOST,
        reason=reason,
    )


def gap_keyframes_at_window(state: State, stamp_ns: int, window_keyframes: int) -> int:
    """Return `State.gap_keyframes` after a pair begins a window.

    After an unobserved motion, the poses are degraded until the window is full. Otherwise, an earlier count continues,
    because the pair is a keyframe.
    """
    if state.path.last.has_gap(stamp_ns):
        return window_keyframes - 1
    return max(state.gap_keyframes - 1, 0)


def window_begun(
    state: State, frame: StereoFrame, window: KeyframeResult, verdict: Verdict, gap_keyframes: int, model: RoverModel
) -> tuple[State, StepEstimate]:
    """Return the state after a pair began a window at the last known pose, and the step to this pose.

    `gap_keyframes` is the number that `gap_keyframes_at_window` returned, on which the verdict depends, too.
    """
    landmark_map = window.landmark_map
    keyframes = state.keyframes + 1
    status = TrackingState.DEGRADED
    if verdict.action is Action.ACCEPT:
        status = TrackingState.INITIALISING if keyframes == 1 else TrackingState.TRACKING
    path, step = trajectory.window_begun(state.path, frame.stamp_ns, landmark_map, model)
    after = replace(
        state,
        path=path,
        landmark_map=landmark_map,
        calibration=window.calibration,
        recovery=RecoveryImages.window_begun(frame.image, landmark_map.landmarks),
        failed_recoveries=0,
        ground_memory=state.ground_memory.window_begun(frame, Pose.of(state.path.last.T_world_left)),
        keyframes=keyframes,
        gap_keyframes=gap_keyframes,
        has_diverged=False,
        status=status,
        reason=verdict.reason,
    )
    return after, step


# ---- after the stages of a pair


def pose_applied(state: State, stamp_ns: int, model: RoverModel) -> State:
    """Return the state after a pair, with a pending external pose applied if its stamp is reached."""
    path, discards_map = external_poses.pose_applied(state.path, stamp_ns, model)
    if discards_map:
        # the next window begins at the external pose and continues no window that diverged
        return replace(state, path=path, landmark_map=None, has_diverged=False)
    return replace(state, path=path)

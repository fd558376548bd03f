"""The localiser: one call per stereo pair.

A sparse, keyframe-based stereo odometry with a sliding window. `Localiser._locate` runs nine stages:

1. Check the images: keep the last pose for a repeated pair, and blank stale parts (`stale_images`, `guards`).
2. Predict the pose by the last motion, a standstill and wheel odometry (`motion_model`).
3. Track: align some landmarks jointly (direct image alignment as in SVO, Forster et al. 2017). Track the patches of
   more landmarks, warped by their local planes, in both images (Lucas and Kanade 1981), and solve for the pose with
   robust weights.
4. Relocalise if the pose is not trusted: optical flow, then SIFT descriptors (`relocalisation`).
5. Select the ground's motion among the motions in the image (`ground.selection`). If one motion does not explain the
   tracks, track the landmarks again from its pose. If many are still unexplained, search for another motion. Landmarks
   that do not move with the ground are no longer tracked.
6. Correct the right camera: estimate its rotation error, and correct its drift (`backend/online_calibration`).
7. Judge: a table decides from the findings of all guards whether the pose is accepted (`guards`, `findings.RULES`).
8. Complete: the pair becomes a keyframe if few landmarks are left or if they moved far in the image. For a keyframe,
   the remaining landmarks of the map are tracked, too, and the pose is estimated again.
9. Accept: update the path and its accumulated errors, and compute the motion since the last pose with its covariance
   (`trajectory`, `uncertainty`).

Before and after these stages, `Localiser.process`

- adopts the keyframe of the previous call, which was made in the background (`_with_keyframe`);
- applies an external pose once its stamp is reached (`_with_pose_from_outside`);
- computes the covariance of the published pose (`_estimate`);
- starts a keyframe in the background: the pair is added to the window, and the window is adjusted (bundle adjustment
  with marginalisation as in OKVIS, Leutenegger et al. 2015; `keyframes`).

A pair may begin a window (`_begin`) if there is no map, or if several good images were refused. Findings can refuse a
pair at five points, and the later stages are then skipped:

- after stage 1, with or without a map;
- before stage 2, if the map has too few landmarks;
- in stage 7;
- in `_begin`, if the findings of stage 1 show that the pair cannot be a reference for later pairs;
- in `_begin`, by the findings about the new window (`_check_window`).

A pair that `_begin` refuses is lost. At the other points, the finding determines whether the last pose is kept, the
localiser is lost, or a window may begin (`findings.Action`).

The state between two pairs is one immutable value (`state.State`, with the changes by each pair and event). Each stage
takes and returns values. `findings` contains the consequences of all findings, and what a new guard requires.
`uncertainty` lists the error sources, what enlarges the covariance, and where a new error source belongs.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.config import checked
from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig, check_rig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation import guards, stale_images, trajectory, warm_up
from sfr_loc_map.localisation.backend.online_calibration import DriftEstimate, OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import (
    PoseEstimate,
    StartPose,
    StateReason,
    TrackingState,
    TrackingStatistics,
    check_given,
    lost_covariance,
)
from sfr_loc_map.localisation.findings import Action, Finding, Findings, Verdict, decide
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.right_camera import RightOffset, right_shift
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks
from sfr_loc_map.localisation.ground.cell_change import Change
from sfr_loc_map.localisation.ground.memory import GroundMemory
from sfr_loc_map.localisation.ground.motion_tools import MotionTools
from sfr_loc_map.localisation.ground.selection import Ground, GroundSelector
from sfr_loc_map.localisation.guards import ShearMean
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW, KeyframeJob, KeyframeMaker, KeyframeResult, max_corners
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.pair_statistics import accepted_statistics, displayed, residual_statistics
from sfr_loc_map.localisation.relocalisation import RESTART_AFTER, RecoveryImages, Relocaliser
from sfr_loc_map.localisation.stage_clock import StageClock
from sfr_loc_map.localisation.stale_images import ImageComparison
from sfr_loc_map.localisation.state import Outcome, State
from sfr_loc_map.localisation.symmetric_matrices import symmetric
from sfr_loc_map.localisation.uncertainty.accepted_pair import AcceptedPair
from sfr_loc_map.localisation.uncertainty.pose_covariance import pose_terms
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel
from sfr_loc_map.parallel import Pending


class CorrectedTracks(NamedTuple):
    """Tracks and calibration after the correction of the right camera."""

    tracks: Tracks  #: Tracks with corrected right observations.
    calibration: OnlineCalibration  #: The calibration, updated by the pair.
    shear_mean: ShearMean  #: The running mean, updated by the pair.
    shear_chi2: float = 0.0  #: Squared shear of the rows of this pair, divided by its variance, per degree of freedom.


class Candidate(NamedTuple):
    """A pair whose pose is to be judged."""

    frame: StereoFrame
    #: The map, in which landmarks that do not move with the ground are no longer tracked. Their earlier observations
    #: remain in the window (`SlidingWindow.without`).
    landmark_map: LandmarkMap
    ground: Ground
    corrected: CorrectedTracks  #: Tracks of the ground after the correction.

    @property
    def tracks(self) -> Tracks:
        """Tracks of the ground with corrected right observations, and their pose."""
        return self.corrected.tracks


class FinalPose(NamedTuple):
    """The final pose of an accepted pair."""

    tracks: Tracks  #: The judged tracks. For a keyframe, tracks of all landmarks unless a guard refuses their pose.
    is_keyframe: bool  #: Whether the pair becomes a keyframe.
    is_recovery_image: bool  #: Whether the pair may serve to recover lost tracking.


class Localiser:
    """Estimates the pose of RB (the rover's body frame) in DS (the frame of the datum) at each stereo pair.

    Keyframes are processed in a background thread after the call returns. The next call waits for the result, so that
    results do not depend on timing.
    """

    version = __version__

    def __init__(
        self,
        rig: StereoRig,
        config: LocalisationConfig = LocalisationConfig(),  # noqa: B008 - frozen
        start: StartPose | Transform = Transform.identity(),  # noqa: B008 - never modified
    ) -> None:
        """Start at a pose of RB in DS. A pose without a stamp is valid at the first pair.

        GeometryError if the rig is another object, has no extrinsics or too small images (`check_rig`), or if the pose
        is invalid (`StartPose.of`). ConfigError if a value of the configuration is invalid, if a mask cannot be read,
        or if its size is not the rig's.
        """
        check_rig(rig)
        config = checked(config)
        self._rig = rig
        self._config = config
        self._camera = rig.camera
        self._shape = (rig.height, rig.width)
        self._model = RoverModel.of(rig, config.motion, KEYFRAME_FLOW)
        self._tracker = Tracker(config.min_tracked, rig.camera)
        self._max_corners = max_corners(rig, config)
        self._relocaliser = Relocaliser(self._tracker, config, rig.camera, self._max_corners)
        self._ground_selector = GroundSelector(
            MotionTools(self._tracker, self._relocaliser, rig.camera, self._shape, config.min_tracked)
        )
        self._keyframes = KeyframeMaker(rig, config)
        # one thread, which starts with the first keyframe and ends with this object
        self._background = ThreadPoolExecutor(max_workers=1, thread_name_prefix="keyframe")
        self._pending: Future[KeyframeResult] | None = None
        self.reset(start)

    def reset(self, start: StartPose | Transform) -> None:
        """Discard the state and start at a pose of RB in DS. A pose without a stamp is valid at the first pair.

        GeometryError, and no change, if the pose is invalid (`StartPose.of`).
        """
        start = StartPose.of(start)
        if self._pending is not None:
            wait([self._pending])
        self._pending = None
        self._state = State(
            path=trajectory.started(start, self._model),
            calibration=self._first_calibration(),
            ground_memory=GroundMemory.none(self._shape),
        )

    def set_pose(self, pose: StartPose | Transform) -> None:
        """Set an external pose, which is valid at its stamp; without a stamp, at the next pair.

        The pose replaces an earlier external pose that is not applied yet. Before the first pair, the pose replaces the
        start pose.

        GeometryError, and no change, if the pose is invalid (`StartPose.of`).
        """
        self._state = replace(self._state, path=trajectory.given(self._state.path, StartPose.of(pose), self._model))

    def pose_at(self, stamp_ns: int) -> Transform | None:
        """Return the pose of RB in DS at a past stamp; None if no pair was accepted or began a window.

        The pose is interpolated between two consecutive pairs. Otherwise the pose of the nearest pair is returned.
        """
        return trajectory.pose_at(self._state.path, stamp_ns, self._model)

    @property
    def known_ns(self) -> int | None:
        """Stamp, ns, since which the odometry of the next pair is measured; None if there is no map.

        The stamp is that of the last pair that was accepted or began a window. If the adjustment of the last keyframe
        diverges in the background, the next pair begins a window although the stamp is not None.
        """
        return None if self._state.landmark_map is None else self._state.path.last.known_ns

    @staticmethod
    def warm_up() -> None:
        """Compile or load all kernels on a small drive, so that later calls need not do this."""
        localiser = Localiser(warm_up.RIG, warm_up.CONFIG)
        for pair in warm_up.small_drive():
            localiser.process(pair)
        landmark_map = localiser._state.landmark_map
        assert landmark_map is not None, "the black pair is kept"
        warm_up.call_kernels_of_two_motions(landmark_map.tracked)
        localiser.reset(Transform.identity())  # waits for the last keyframe
        warm_up.call_kernels_of_large_images()

    def process(self, pair: StereoPair, odometry: Transform | None = None) -> PoseEstimate:
        """Return the pose of RB in DS at a pair, with its covariance and state.

        The odometry, for example from wheels, is the motion `T_before_now` of RB since `known_ns`. The odometry is an
        initial guess only. The images are copied, so that the caller may reuse their memory.

        LocalisationError, and no change, if the pair is another object, if the size of the images is not the rig's, or
        if the stamp of the pair is not later than that of the previous pair. GeometryError, and no change, if the
        odometry has an invalid rotation or a coordinate above `MAX_GIVEN_M`.
        """
        self._check_pair(pair)
        if odometry is not None:
            check_given(odometry, "the odometry")
        pair = replace(pair, left=pair.left.copy(), right=pair.right.copy())
        clock = StageClock()
        with clock.stage("wait"):
            pending = self._pending
            self._pending = None
            if pending is not None:
                result = _result_of(pending)
                self._state = self._with_keyframe(self._state, result)
                if result is not None:
                    clock.add("keyframe", result.seconds)
        outcome = self._locate(self._state, pair, odometry, clock)
        self._state = self._with_pose_from_outside(outcome.state, pair.stamp_ns)
        # A keyframe implies an accepted pose. Only an external pose with a later stamp would discard the map.
        assert outcome.keyframe is None or self._state.landmark_map is not None
        estimate = self._estimate(pair.stamp_ns, self._state, outcome, clock)
        if outcome.keyframe is not None:
            self._pending = self._background.submit(self._keyframes.make, outcome.keyframe)
        return estimate

    # ---- the stages of a pair

    def _locate(self, state: State, pair: StereoPair, odometry: Transform | None, clock: StageClock) -> Outcome:
        """Run stages 1 to 9 (module docstring) on a pair.

        The tracks follow any motion (`tracks`), then the ground (`ground.tracks`), then have corrected right
        observations (`candidate.tracks`), and for a keyframe contain all landmarks (`final.tracks`).
        """
        # 1 check the images
        images = stale_images.compare(pair, state.image_memory)
        state = replace(
            state,
            path=trajectory.arrived(state.path, pair.stamp_ns),
            image_memory=images.memory,
            ground_memory=state.ground_memory.after_stale_rows(images.blanked_rows),
        )
        landmark_map = state.landmark_map
        findings = guards.check_images(images, has_map=landmark_map is not None) | guards.check_wiring(pair)
        verdict = decide(findings)
        if verdict.refuses:
            return self._refuse(state, verdict, pair.stamp_ns)
        with clock.stage("pyramid"):
            frame = StereoFrame.of(images.pair, pair, has_frozen_image=images.is_one_frozen)
        if landmark_map is None:
            return self._begin(state, frame, findings)
        verdict = decide(findings | guards.check_landmarks(frame, landmark_map.landmarks, self._config.min_tracked))
        if verdict.refuses:
            return self._refuse_or_restart(state, verdict, frame)
        # 2 predict
        guesses = state.path.last.predict(pair.stamp_ns, odometry, self._model)
        prediction = Prediction(guesses, state.calibration.offset)
        # 3 track, 4 relocalise; meanwhile a second thread compares the cells of the image for stage 5
        pending_change = self._ground_selector.begin_change(frame, state.ground_memory)
        tracks = self._track(frame, landmark_map, prediction, state.recovery, clock)
        # 5 select the ground's motion
        ground = self._select_ground(frame, tracks, prediction, state, images, pending_change)
        # 6 correct the right camera
        corrected = self._correct_right_camera(ground.tracks, state.calibration, state.shear_mean)
        candidate = Candidate(frame, landmark_map.without(ground.not_ground), ground, corrected)
        # 7 judge
        verdict = self._judge(state, candidate, findings | ground.findings)
        if verdict.refuses:
            state = replace(state, ground_memory=ground.memory.for_verdict(verdict))
            return self._refuse_or_restart(state, verdict, frame, candidate.tracks)
        # 8 complete, 9 accept
        final = self._complete(state, candidate, verdict, clock)
        return self._accept(state, candidate, verdict, final)

    def _track(
        self,
        frame: StereoFrame,
        landmark_map: LandmarkMap,
        prediction: Prediction,
        recovery: RecoveryImages,
        clock: StageClock,
    ) -> Tracks:
        """Track the landmarks of the map; relocalise if the pose is not trusted."""
        landmarks = landmark_map.tracked
        with clock.stage("align"):
            coarse = self._tracker.align(frame.left, landmark_map.aligned, prediction.guesses.distinct)
        with clock.stage("refine"):
            tracks = self._tracker.refine(frame, landmarks, coarse, prediction.offset)
        if tracks.is_trusted:
            return tracks
        with clock.stage("relocate"):
            found = self._relocaliser.relocalise(frame, landmarks, recovery, prediction.offset)
        return found or tracks

    def _select_ground(
        self,
        frame: StereoFrame,
        tracks: Tracks,
        prediction: Prediction,
        state: State,
        images: ImageComparison,
        pending_change: Pending[Change],
    ) -> Ground:
        """Select the ground's motion, unless the left image is frozen or rows of either image are stale."""
        memory = state.ground_memory
        if images.is_left_frozen or images.blanked_rows.any():
            return Ground.unselected(tracks, memory)
        change = pending_change.result()
        return self._ground_selector.select(frame, tracks, prediction, memory, state.recovery, change)

    def _correct_right_camera(
        self, tracks: Tracks, calibration: OnlineCalibration, shear_mean: ShearMean
    ) -> CorrectedTracks:
        """Estimate the shift of the right image, and correct the right observations for a drift of the right camera.

        Tracks that are not trusted are returned unchanged, because stage 7 refuses them.
        """
        if not tracks.is_trusted:
            return CorrectedTracks(tracks, calibration, shear_mean)
        lens_px = calibration.lens.likely_px
        landmarks = tracks.landmarks.estimates
        shift = right_shift(tracks.pose, landmarks, tracks.observed, self._camera, self._shape, lens_px)
        if not np.isfinite(shift.variance):  # too few landmarks are observed in both images
            return CorrectedTracks(tracks, calibration, shear_mean)
        calibration, drift_px = calibration.with_lens_residuals(shift).with_shift(shift)
        if drift_px != 0.0:
            observations = tracks.observations.copy()
            observations[:, 2:] -= RightOffset(u=drift_px).at(observations[:, 2:], self._camera)
            observed = tracks.observed._replace(uv=observations)
            tracks = self._tracker.solve(tracks.landmarks, observed, tracks.pose)
        return CorrectedTracks(tracks, calibration, shear_mean.with_pair(shift.shear_chi2), shift.shear_chi2)

    def _judge(self, state: State, candidate: Candidate, findings: Findings) -> Verdict:
        """Apply all guards to a pose."""
        frame = candidate.frame
        tracks = candidate.tracks
        corrected = candidate.corrected
        findings |= self._check_pose(state, frame, tracks)
        verdict = decide(findings)
        if verdict.refuses:  # the other guards require a valid pose
            return verdict
        findings |= guards.check_sides(frame, tracks, self._tracker, corrected.calibration.offset)
        findings |= guards.check_gap(keyframes=state.keyframes, clean_from_keyframe=state.clean_from_keyframe)
        findings |= guards.check_calibration(corrected.calibration)
        findings |= guards.check_shear(corrected.shear_chi2, corrected.shear_mean)
        return decide(findings)

    def _check_pose(self, state: State, frame: StereoFrame, tracks: Tracks) -> Findings:
        """Return the findings of the fast guards that refuse poses; they are repeated for the pose of a keyframe."""
        findings = guards.check_tracks(frame, tracks)
        return findings | guards.check_pose(tracks, state.path.last, frame.stamp_ns, self._config.motion)

    def _complete(self, state: State, candidate: Candidate, verdict: Verdict, clock: StageClock) -> FinalPose:
        """Decide whether a judged pair becomes a keyframe, and solve for the pose of a keyframe from all landmarks.

        Only the errors of keyframes accumulate. Other poses are therefore estimated from fewer landmarks to save time.
        Findings about the images hold for the new pose as well, but the checks of the pose are repeated. If these
        checks refuse the new pose, the judged pose and its tracks are used.
        """
        tracks = candidate.tracks
        # later pairs are compared with the left image, which must show enough landmarks
        is_recovery_image = verdict.can_be_reference and tracks.left_inlier_count >= self._config.min_tracked
        if not (is_recovery_image and self._keyframes.is_needed(tracks, candidate.landmark_map)):
            return FinalPose(tracks, is_keyframe=False, is_recovery_image=is_recovery_image)
        with clock.stage("refine"):
            complete = self._with_all_landmarks(candidate)
        is_refused = decide(self._check_pose(state, candidate.frame, complete)).refuses
        return FinalPose(tracks if is_refused else complete, is_keyframe=True, is_recovery_image=True)

    def _with_all_landmarks(self, candidate: Candidate) -> Tracks:
        """Track the remaining landmarks, and estimate the pose from all landmarks."""
        tracks = candidate.tracks
        landmark_map = candidate.landmark_map
        landmarks = landmark_map.landmarks
        was_tracked = landmarks.among(tracks.landmarks)
        if was_tracked.all():
            return tracks
        rest = landmark_map.rest_of(tracks.landmarks)
        offset = candidate.corrected.calibration.offset
        return self._tracker.complete(candidate.frame, tracks, landmarks, was_tracked, rest, offset)

    def _accept(self, state: State, candidate: Candidate, verdict: Verdict, final: FinalPose) -> Outcome:
        """Accept a pose and update the state from it."""
        tracks = final.tracks
        corrected = candidate.corrected
        ground = candidate.ground
        landmark_map = candidate.landmark_map
        residuals = residual_statistics(tracks)
        pair = AcceptedPair(
            stamp_ns=candidate.frame.stamp_ns,
            tracks=tracks,
            landmark_map=landmark_map,
            calibration=corrected.calibration,
            chi_median=residuals.chi_median,
            was_known=state.status is not TrackingState.LOST,
            shear_chi2=corrected.shear_chi2,
            inflation=verdict.inflation,
            other_distance=ground.other_distance,
        )
        path, step = trajectory.accepted(state.path, pair, self._model)
        recovery = state.recovery
        if final.is_recovery_image:
            recovery = recovery.with_tracked(candidate.frame.image, tracks)
        state = replace(
            state,
            path=path,
            landmark_map=landmark_map,
            calibration=corrected.calibration,
            shear_mean=corrected.shear_mean,
            ground_memory=ground.memory.for_verdict(verdict),
            recovery=recovery,
            failed_recoveries=0,
            keyframes=state.keyframes + int(final.is_keyframe),
            status=TrackingState.TRACKING if verdict.action is Action.ACCEPT else TrackingState.DEGRADED,
            reason=verdict.reason,
        )
        keyframe = None
        if final.is_keyframe:
            mask = state.ground_memory.excluded.mask
            keyframe = KeyframeJob(candidate.frame, tracks, landmark_map.window, state.calibration, mask)
        return Outcome(state, accepted_statistics(state, tracks, residuals), tracks, step, keyframe)

    # ---- pairs without an accepted pose

    def _refuse(self, state: State, verdict: Verdict, stamp_ns: int, tracks: Tracks | None = None) -> Outcome:
        """Refuse a pair: the last pose is kept, or the localiser is lost."""
        is_repeated = verdict.finding is Finding.REPEATED_PAIR
        statistics = TrackingStatistics(repeated=1) if is_repeated else TrackingStatistics(inliers=0)
        if verdict.action is Action.KEEP:
            return self._keep(state, verdict, stamp_ns, statistics, tracks)
        return self._lose(state, verdict.reason, statistics, tracks)

    def _refuse_or_restart(
        self, state: State, verdict: Verdict, frame: StereoFrame, tracks: Tracks | None = None
    ) -> Outcome:
        """Refuse a pair, or begin a window with it if several good images were refused.

        A pair that would be kept (`KEEP`) counts only while the localiser is lost. Otherwise, a localiser whose map
        contradicts all images would stay lost.
        """
        assert state.landmark_map is not None, "without a map, a pair begins a window"
        count = len(state.landmark_map.landmarks.rows)
        is_lost = state.status is TrackingState.LOST
        may_restart = verdict.action is Action.RESTART or (verdict.action is Action.KEEP and is_lost)
        if may_restart and self._relocaliser.is_good_image(frame, count):
            state = replace(state, failed_recoveries=state.failed_recoveries + 1)
            if state.failed_recoveries >= RESTART_AFTER and verdict.can_be_reference:
                # the findings concern a pose in the old map, which the new window does not continue
                return self._begin(state, frame, frozenset(), tracks)
        return self._refuse(state, verdict, frame.stamp_ns, tracks)

    def _keep(
        self, state: State, verdict: Verdict, stamp_ns: int, statistics: TrackingStatistics, tracks: Tracks | None
    ) -> Outcome:
        """Publish the last pose again with a larger covariance. A lost localiser stays lost and keeps its reason.

        The localiser is lost once the motion since the last pose is as uncertain as an unknown pose.
        """
        if state.status is TrackingState.LOST:
            return self._lose(state, state.reason, statistics, tracks)
        path, step = trajectory.kept(state.path, stamp_ns, self._model)
        if path.errors.kept_motion.max() >= LOST_VARIANCE:
            return self._lose(state, verdict.reason, statistics, tracks)
        state = replace(state, path=path, status=TrackingState.DEGRADED, reason=verdict.reason)
        return Outcome(state, statistics, tracks, step)

    def _lose(
        self, state: State, reason: StateReason | None, statistics: TrackingStatistics, tracks: Tracks | None = None
    ) -> Outcome:
        """Report that the pose is unknown."""
        state = replace(
            state,
            path=trajectory.lost(state.path),
            ground_memory=state.ground_memory.after_lost_pair(),
            status=TrackingState.LOST,
            reason=reason,
        )
        return Outcome(state, statistics, tracks)

    def _begin(self, state: State, frame: StereoFrame, findings: Findings, tracks: Tracks | None = None) -> Outcome:
        """Begin a window at the last known pose with a pair and its findings.

        The localiser is lost if the pair has too few landmarks, or if the pair cannot be a reference for later pairs.
        The state is degraded if the pair has findings, or if the motion since the last pose is unobserved.
        """
        keyframes = state.keyframes + 1
        clean_from = state.clean_from_keyframe
        if state.path.last.has_gap(frame.stamp_ns):  # poses stay degraded until the window is full
            clean_from = keyframes + self._config.window_keyframes - 1
        findings |= guards.check_gap(keyframes=keyframes, clean_from_keyframe=clean_from)
        if state.has_diverged:
            findings |= {Finding.DIVERGED}
        verdict = decide(findings)
        if not verdict.can_be_reference:  # checked first: with a blanked image, no landmark is triangulated
            return self._lose(state, verdict.reason, TrackingStatistics(inliers=0), tracks)
        pose = Pose.of(state.path.last.T_world_left)
        result = self._keyframes.begin(frame, pose, state.calibration, state.ground_memory.excluded.mask)
        landmarks = result.landmark_map.landmarks
        statistics = TrackingStatistics(features=len(landmarks.rows))
        verdict = decide(findings | self._check_window(state, frame, landmarks))
        if verdict.refuses:
            return self._lose(state, verdict.reason, replace(statistics, inliers=0), tracks)
        status = TrackingState.DEGRADED
        if verdict.action is Action.ACCEPT:
            status = TrackingState.INITIALISING if keyframes == 1 else TrackingState.TRACKING
        path, step = trajectory.restarted(state.path, frame.stamp_ns, result.landmark_map, self._model)
        state = replace(
            state,
            path=path,
            landmark_map=result.landmark_map,
            calibration=result.calibration,
            recovery=RecoveryImages.of_first_keyframe(frame.image, landmarks),
            failed_recoveries=0,
            ground_memory=state.ground_memory.in_new_window(frame, pose),
            keyframes=keyframes,
            clean_from_keyframe=clean_from,
            has_diverged=False,
            status=status,
            reason=verdict.reason,
        )
        return Outcome(state, statistics, tracks, step)

    def _check_window(self, state: State, frame: StereoFrame, landmarks: Landmarks) -> Findings:
        """Apply the guards for the landmarks of a new window.

        If the window has few landmarks, those of the swapped images show whether the order is the cause.
        """
        min_tracked = self._config.min_tracked
        findings = guards.check_landmarks(frame, landmarks, min_tracked)
        if len(landmarks.rows) >= max(min_tracked, guards.ORDER_TESTED_RATIO * self._max_corners):
            return findings
        pose = Pose.of(state.path.last.T_world_left)
        ground_mask = state.ground_memory.excluded.mask
        count_if_swapped = self._keyframes.landmark_count(frame.swapped(), pose, state.calibration, ground_mask)
        return findings | guards.check_order(landmarks, count_if_swapped, min_tracked)

    # ---- before and after the stages

    def _check_pair(self, pair: StereoPair) -> None:
        if not isinstance(pair, StereoPair):
            raise LocalisationError(f"the pair has the type {type(pair).__name__}: a StereoPair is required")
        before_ns = self._state.path.arrived_ns
        if before_ns is not None and pair.stamp_ns <= before_ns:
            raise LocalisationError(
                f"the stamp of pair {pair.stamp_ns} is not later than {before_ns}, the stamp of the previous pair: "
                "stamps in increasing order are required; sort the pairs by stamp, or reset the localiser before "
                "another drive"
            )
        if fault := self._rig.fault_of_size(pair.left):  # the right image has the size of the left image
            raise LocalisationError(f"image of stamp {pair.stamp_ns} {fault}")

    def _with_keyframe(self, state: State, result: KeyframeResult | None) -> State:
        """Return the state with the adjusted map, pose and calibration of a keyframe.

        If the adjustment was singular (None) or diverged, the map is discarded, and a new window may begin at the last
        known pose.
        """
        if result is None:
            return self._without_map(state)
        window = result.landmark_map.window
        if guards.has_diverged(state.path.last, window.newest_pose, window.covariance):
            return self._without_map(state)
        path = trajectory.adjusted(state.path, window, self._model, has_yaw_step=result.has_yaw_step)
        T_after_before = path.last.T_world_left @ state.path.last.T_world_left.inverse()
        return replace(
            state,
            path=path,
            ground_memory=state.ground_memory.moved(T_after_before),
            landmark_map=result.landmark_map,
            calibration=result.calibration,
            recovery=state.recovery.with_keyframe(result.landmark_map.landmarks),
        )

    def _without_map(self, state: State) -> State:
        """Return the state after an adjustment that diverged: the map and the calibration are discarded.

        The sum of the drift corrections continues, because the attitude errors that the corrections caused remain. The
        sums of the path continue, too. Corrections of the yaw up to here then count as errors (`disparity` in
        `uncertainty`), because the yaw that they were based on is discarded.
        """
        drift = DriftEstimate(total_px=state.calibration.drift.total_px)
        calibration = replace(self._first_calibration(), drift=drift)
        return replace(state, landmark_map=None, calibration=calibration, has_diverged=True)

    def _first_calibration(self) -> OnlineCalibration:
        """Return the calibration before the first pair."""
        return OnlineCalibration(self._camera, self._shape, self._config.window_keyframes)

    def _with_pose_from_outside(self, state: State, stamp_ns: int) -> State:
        """Apply a pending external pose if its stamp is reached."""
        if state.path.datum.pending is None:
            return state
        path, is_map_forgotten = trajectory.with_pending_pose(state.path, stamp_ns, self._model)
        if is_map_forgotten:
            # the next window begins at the external pose and continues no window that diverged
            return replace(state, path=path, landmark_map=None, has_diverged=False)
        return replace(state, path=path)

    def _estimate(self, stamp_ns: int, state: State, outcome: Outcome, clock: StageClock) -> PoseEstimate:
        """Return the pose of RB in DS and its covariance, converted from the left camera in the world."""
        datum = state.path.datum
        T_ds_left = datum.T_ds_world @ state.path.last.T_world_left
        T_ds_rb = T_ds_left @ self._model.T_left_rb
        if state.status is TrackingState.LOST:
            covariance = lost_covariance()
        else:
            position = state.path.last.T_world_left.translation
            of_left = pose_terms(state.path.errors, position, state.calibration, self._model).total
            lever = T_ds_rb.translation - T_ds_left.translation
            covariance = symmetric(propagated_covariance(of_left, lever, datum.T_ds_world.rotation))
        return PoseEstimate(
            stamp_ns=stamp_ns,
            T_ds_rb=T_ds_rb,
            covariance=covariance,
            state=state.status,
            statistics=outcome.statistics,
            stage_s=clock.seconds,
            reason=state.reason,
            step=outcome.step,
            tracks=None if outcome.tracks is None else displayed(outcome.tracks),
        )


def _result_of(pending: Future[KeyframeResult]) -> KeyframeResult | None:
    """Wait for a keyframe and return it; None if its adjustment was singular."""
    try:
        return pending.result()
    except np.linalg.LinAlgError:
        return None

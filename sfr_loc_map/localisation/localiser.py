"""The localiser: one call per stereo pair.

A sparse, keyframe-based stereo odometry with a sliding window. `Localiser._locate` runs ten stages:

1. Check the images: detect a repeated pair and copies of one image, and blank stale parts (`stale_images`, `guards`).
2. Check the map: too few landmarks refuse the pair. Without a map, the pair begins a window.
3. Predict the pose by the last motion, a standstill and wheel odometry (`motion_model`).
4. Track: align some landmarks jointly (direct image alignment as in SVO, Forster et al. 2017). Track the patches of
   more landmarks, warped by their local planes, in both images (Lucas and Kanade 1981), and solve for the pose with
   robust weights.
5. Relocalise if the pose is not trusted: optical flow, then SIFT descriptors (`relocalisation`).
6. Select the ground's motion among the motions in the image (`ground.selection`). If one motion does not explain the
   tracks, track the landmarks again from its pose. If many are still unexplained, search for another motion. Landmarks
   that do not move with the ground are no longer tracked.
7. Correct the right camera: estimate its rotation error, and correct its drift (`backend/online_calibration`).
8. Judge: a table decides from the findings of all guards whether the pose is accepted (`guards`, `findings.RULES`).
9. Complete: the pair becomes a keyframe if few landmarks are left or if they moved far in the image, unless the pair
   cannot be a reference, or too few inliers are in the left image. For a keyframe, the remaining landmarks of the map
   are tracked, too, and the pose is estimated again.
10. Accept: update the path and its accumulated errors, and compute the motion since the last pose with its covariance
    (`path`, `uncertainty`).

`stages` contains stages 4, 5 and 7 to 9, and the start of a window; `ground.selection` contains stage 6. Before and
after the stages, `Localiser.process`

- adopts the keyframe of the previous call, which was made in the background (`_adopt_keyframe`);
- applies an external pose once its stamp is reached (`State.pose_applied`);
- computes the covariance of the published pose (`_estimate`);
- starts a keyframe in the background: the pair is added to the window, and the window is adjusted (bundle adjustment
  with marginalisation as in OKVIS, Leutenegger et al. 2015; `keyframes`).

**Where a pair is refused.** Three stages can refuse a pair, and the later stages are then skipped. A refused pair is
*kept* (the last pose is published again with a larger covariance), is *lost* (the pose is unknown), or begins a window.
`_without_pose` decides between the three, and can refuse the pair for further reasons, as can the new window:

| where | refused because | what becomes of the pair |
|---|---|---|
| stage 1 | of its images | kept or lost |
| stage 2 | the map has too few landmarks | lost, or begins a window |
| stage 8 | of any finding that refuses poses | kept or lost, or begins a window |
| `_without_pose` | there is no map, and its images cannot be a reference for later pairs | lost |
| `_without_pose` | it would be kept, but the localiser is lost, or its pose is as uncertain as an unknown pose | lost |
| `_begin_window` | it has too few landmarks, or its images are swapped (`Stages.begin_window`) | lost |

A pair may begin a window in two situations: if there is no map, or if `MAX_FAILED_RECOVERIES` good images were refused
since the last pair that was accepted or began a window. An image counts if stage 2 or stage 8 refuses its pair, except
in two cases. Swapped images never count (`Action.LOSE`). Images that contradict the pose (`Action.KEEP`) count only
while the localiser is lost. A pair that stage 1 refuses does not count either.

**Which reason wins.** Each point evaluates all findings so far with one table. Of the findings present, the first one
in `findings.RULES` decides, and its reason is published. The order is:

1. Findings that refuse the pair: a repeated pair; identical or swapped images; too few landmarks, with a cause in the
   images before the number; a pose that the image contradicts, or that is impossible.
2. Findings that degrade the pose: images with stale parts that are known, or one image without texture; a diverged
   adjustment; a gap; the calibration; sheared rows; other stale parts; two motions.

There are three exceptions:

- Stage 8 evaluates the table twice, because some guards require a valid pose. A pair that the first evaluation refuses
  is not examined by these guards. If a map exists, swapped images are therefore reported as too few landmarks unless
  their pose is trusted, although `SWAPPED` precedes `FEW_LANDMARKS` in the table.
- While the localiser is lost, a pair that would otherwise be kept publishes the reason for which the localiser was
  lost.
- If a refused pair may begin a window, only the findings about its images and those of the window are published. The
  reason for which its pose was refused is discarded, even if the window cannot begin.

**What enlarges the covariance.** The covariance of an accepted pose is the sum of its error terms, and findings, kept
pairs, new windows and external poses add to it. `uncertainty` lists all terms and events with links to their formulas.

The state between two pairs is one immutable value, and its methods are all of its changes (`state.State`). In addition,
the localiser holds the keyframe that is being made in the background. Each stage takes and returns values. `findings`
describes what a new guard requires, and `uncertainty` where a new error source belongs.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from dataclasses import replace

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.configuration.parameters import checked
from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.arrays import FloatArray, median
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig, check_rig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance, symmetric
from sfr_loc_map.localisation import guards, stale_images, warm_up
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import (
    LandmarkTracks,
    PoseEstimate,
    StartPose,
    TrackingState,
    TrackingStatistics,
    check_given,
    lost_covariance,
)
from sfr_loc_map.localisation.findings import Action, Finding, Verdict, decide
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import INLIER_CHI2_PER_DOF, Tracks
from sfr_loc_map.localisation.ground.selection import Ground, changed_cells, select_ground
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW_RATIO, KeyframeJob, KeyframeResult, has_diverged
from sfr_loc_map.localisation.relocalisation import MAX_FAILED_RECOVERIES
from sfr_loc_map.localisation.stages import Candidate, FinalPose, StageClock, Stages
from sfr_loc_map.localisation.state import Outcome, State
from sfr_loc_map.localisation.uncertainty.error_sources import RoverModel
from sfr_loc_map.localisation.uncertainty.pose_covariance import pose_terms
from sfr_loc_map.parallel import beside


class Localiser:
    """Estimates the pose of RB (the rover's body frame) in DS (the frame of the datum) at each stereo pair.

    Keyframes are processed in a background thread after the call returns. The next call waits for the result, so that
    results do not depend on timing.

    An instance is not thread-safe: one call at a time is required, from any thread.
    """

    version = __version__

    def __init__(
        self,
        rig: StereoRig,
        config: LocalisationConfig = LocalisationConfig(),  # noqa: B008 - frozen
        start: StartPose | Transform = Transform.identity(),  # noqa: B008 - never modified
        *,
        executor: Executor | None = None,
    ) -> None:
        """Start at a pose of RB in DS. A pose without a stamp is valid at the first pair.

        The executor makes keyframes. By default, this is one thread, which starts with the first keyframe and ends with
        this object.

        GeometryError if the rig is another object, has no extrinsics or too small images (`check_rig`), or if the pose
        is invalid (`StartPose.of`). ConfigError if a value of the configuration is invalid, if a mask cannot be read,
        or if its size is not the rig's.
        """
        check_rig(rig)
        config = checked(config)
        self._rig = rig
        self._config = config
        self._model = RoverModel.of(rig, config.motion, KEYFRAME_FLOW_RATIO)
        self._stages = Stages(rig, config)
        self._background = executor or ThreadPoolExecutor(max_workers=1, thread_name_prefix="keyframe")
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
        calibration = OnlineCalibration(
            self._rig.camera, (self._rig.height, self._rig.width), self._config.window_keyframes
        )
        self._state = State.started(start, calibration, self._model)

    def set_pose(self, pose: StartPose | Transform) -> None:
        """Set an external pose, which is valid at its stamp; without a stamp, at the next pair.

        The pose replaces an earlier external pose that is not applied yet. Before the first pair, the pose replaces the
        start pose. A pose whose stamp is more than `path.MAX_AHEAD_NS` after the next pair is of another
        clock, and applies at the next pair.

        All later poses move with the external pose, and their covariances begin with its covariance. The map is
        discarded if no pair was accepted up to 1.5 periods before the stamp at which the pose applies
        (`path`). The next pair then begins a window.

        GeometryError, and no change, if the pose is invalid (`StartPose.of`).
        """
        self._state = self._state.pose_set(StartPose.of(pose, "the external pose"), self._model)

    def pose_at(self, stamp_ns: int) -> Transform | None:
        """Return the pose of RB in DS at a past stamp; None without an accepted pair.

        A pair that began a window counts as accepted. Pairs before an external pose that discarded the map do not count
        (`set_pose`).

        The pose is interpolated between two consecutive pairs. Otherwise the pose of the nearest pair is returned.
        """
        return self._state.path.pose_at(stamp_ns, self._model)

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
        assert landmark_map is not None, "the black pair is lost, and the map is kept"
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
        pair = StereoPair(int(pair.stamp_ns), pair.left.copy(), pair.right.copy())
        clock = StageClock()
        self._adopt_keyframe(clock)
        outcome = self._locate(self._state, pair, odometry, clock)
        return self._commit(outcome, pair.stamp_ns, clock)

    # ---- the stages of a pair

    def _locate(self, state: State, pair: StereoPair, odometry: Transform | None, clock: StageClock) -> Outcome:
        """Run stages 1 to 10 (module docstring) on a pair.

        The tracks follow any motion (`tracks`), then the ground (`ground.tracks`), then have corrected right
        observations (`candidate.tracks`), and for a keyframe contain all landmarks (`final.tracks`).
        """
        stages = self._stages
        # 1 check the images
        images = stale_images.compare(pair, state.image_memory)
        state = state.arrived(images, pair.stamp_ns)
        landmark_map = state.landmark_map
        findings = guards.check_images(pair, images, has_map=landmark_map is not None)
        verdict = decide(findings)
        if verdict.refuses:
            return self._without_pose(state, verdict, pair.stamp_ns)
        with clock.stage("pyramid"):
            frame = StereoFrame.of(images.pair, pair, has_frozen_image=images.is_one_frozen)
        # 2 check the map
        if landmark_map is None:
            return self._without_pose(state, verdict, pair.stamp_ns, frame=frame, of_images=findings)
        verdict = decide(findings | guards.check_landmarks(frame, landmark_map.landmarks, self._config.min_tracked))
        if verdict.refuses:
            return self._without_pose(state, verdict, pair.stamp_ns, frame=frame, of_images=findings)
        # 3 predict
        prediction = state.path.last.predict(pair.stamp_ns, odometry, state.calibration.offset, self._model)
        # 4 track, 5 relocalise; beside them, stage 6 begins with a comparison of images, which requires no pose
        change = beside(changed_cells, frame, state.ground_memory)
        tracks = stages.track(frame, landmark_map, prediction, state.recovery, clock)
        # 6 select the ground's motion
        changed = change.result()
        if images.is_left_frozen or images.has_stale_rows:
            ground = Ground.unselected(tracks, state.ground_memory)
        else:
            tools = stages.motion_tools
            ground = select_ground(tools, frame, tracks, prediction, state.ground_memory, state.recovery, changed)
        # 7 correct the right camera
        candidate = stages.correct_right_camera(frame, landmark_map, ground, state.calibration, state.shear_mean)
        # 8 judge
        last = state.path.last
        verdict = stages.judge(last, state.gap_keyframes, candidate, findings | ground.findings)
        if verdict.refuses:
            state = state.refused(candidate, verdict)
            return self._without_pose(
                state, verdict, pair.stamp_ns, frame=frame, of_images=findings, tracks=candidate.tracks
            )
        # 9 complete, 10 accept
        final = stages.complete(last, candidate, verdict, clock)
        return self._accept(state, candidate, verdict, final)

    def _accept(self, state: State, candidate: Candidate, verdict: Verdict, final: FinalPose) -> Outcome:
        """Accept a pose: compute its errors and the step to it, and learn from the pair."""
        tracks = final.tracks
        chi_median = median(tracks.chi2_per_dof[~np.isnan(tracks.chi2_per_dof)])
        after, step = state.accepted(candidate, verdict, final, chi_median, self._model)
        offset = after.calibration.offset
        statistics = TrackingStatistics(
            features=len(tracks.inliers),
            inliers=tracks.inlier_count,
            keyframes=after.keyframes,
            chi_median=chi_median,
            residual_px=_median_residual_px(tracks),
            vertical_offset_px=offset.pitch_px,
            disparity_offset_px=-offset.yaw_px,
            roll_offset_px=offset.roll_px,
            masked_share=after.ground_memory.excluded.fraction,
        )
        keyframe = None
        if final.is_keyframe:
            mask = after.ground_memory.excluded.mask
            keyframe = KeyframeJob(candidate.frame, tracks, candidate.landmark_map, after.calibration, mask)
        return Outcome(after, statistics, tracks, step, keyframe)

    # ---- pairs without an accepted pose

    def _without_pose(
        self,
        state: State,
        verdict: Verdict,
        stamp_ns: int,
        *,
        frame: StereoFrame | None = None,
        of_images: frozenset[Finding] = frozenset(),
        tracks: Tracks | None = None,
    ) -> Outcome:
        """Continue with a pair that has no pose in the map: the pair begins a window, is kept, or is lost.

        A pair begins a window if there is no map, or if several good images were refused. A pair that would be kept
        (`KEEP`) counts only while the localiser is lost: without this count, a localiser whose map contradicts all
        images would stay lost. No window begins with a pair that cannot be a reference. This includes a pair in which
        the selection of the ground found stale parts, because new landmarks in these parts would have wrong positions.

        The last pose is kept, with a larger covariance, until the motion since this pose is as uncertain as an unknown
        pose. While the localiser is lost, a pair that would be kept is lost, too, with the earlier reason.

        Args:
            state: State before the consequences of the verdict.
            verdict: Verdict on the pair. Without a map, the verdict on its images.
            stamp_ns: Stamp of the pair.
            frame: Images of the pair; None if the images themselves are refused, so that no window begins.
            of_images: Findings about the images, which also hold for a new window.
            tracks: Tracked landmarks, for display.
        """
        landmark_map = state.landmark_map
        is_lost = state.status is TrackingState.LOST
        may_begin = landmark_map is None
        counts = verdict.action is Action.LOSE_OR_BEGIN or (verdict.action is Action.KEEP and is_lost)
        if frame is not None and landmark_map is not None and counts:
            is_good_image = self._stages.relocaliser.is_good_image(frame, len(landmark_map.landmarks.rows))
            if is_good_image:
                state = state.recovery_failed()
                may_begin = state.failed_recoveries >= MAX_FAILED_RECOVERIES
        if frame is not None and may_begin and verdict.can_be_reference:
            return self._begin_window(state, frame, of_images, tracks)
        is_repeated = verdict.finding is Finding.REPEATED_PAIR
        statistics = TrackingStatistics(repeated=1) if is_repeated else TrackingStatistics(inliers=0)
        reason = verdict.reason
        if verdict.action is Action.KEEP and is_lost:
            reason = state.reason
        elif verdict.action is Action.KEEP:
            kept, step = state.kept(reason, stamp_ns, self._model)
            if kept.path.errors.kept_motion.max() < LOST_VARIANCE:
                return Outcome(kept, statistics, tracks, step)
        return Outcome(state.lost(reason), statistics, tracks)

    def _begin_window(
        self, state: State, frame: StereoFrame, of_images: frozenset[Finding], tracks: Tracks | None
    ) -> Outcome:
        """Begin a window at the last known pose with a pair that can be a reference.

        The localiser is lost if the window has too few landmarks, or if the images are swapped. The state is degraded
        if the images have findings, or if the motion since the last pose is unobserved. Findings about the pose of the
        pair concern the map that the window replaces, and do not hold for the window.
        """
        gap_keyframes = state.gap_keyframes_at_window(frame.stamp_ns, self._config.window_keyframes)
        findings = of_images | guards.check_gap(gap_keyframes)
        findings |= guards.check_divergence(has_diverged=state.has_diverged)
        pose = Pose.of(state.path.last.T_world_left)
        mask = state.ground_memory.excluded.mask
        window, of_window = self._stages.begin_window(frame, pose, state.calibration, mask)
        statistics = TrackingStatistics(features=len(window.landmark_map.landmarks.rows))
        verdict = decide(findings | of_window)
        if verdict.refuses:
            if verdict.ages_excluded:
                state = state.window_failed()
            return Outcome(state.lost(verdict.reason), replace(statistics, inliers=0), tracks)
        state, step = state.window_begun(frame, window, verdict, gap_keyframes, self._model)
        return Outcome(state, statistics, tracks, step)

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

    def _adopt_keyframe(self, clock: StageClock) -> None:
        """Wait for the keyframe of the previous call, and adopt its map, pose and calibration.

        If the adjustment was singular or diverged, the map is discarded, and a new window may begin at the last pose.
        """
        with clock.stage("wait"):
            pending = self._pending
            self._pending = None
            if pending is None:
                return
            state = self._state
            try:
                result = pending.result()
            except np.linalg.LinAlgError:
                self._state = state.diverged()
                return
            clock.add("keyframe", result.seconds)
            is_usable = not has_diverged(result.landmark_map, state.path.last.T_world_left)
            self._state = state.adjusted(result, self._model) if is_usable else state.diverged()

    def _commit(self, outcome: Outcome, stamp_ns: int, clock: StageClock) -> PoseEstimate:
        """Store the state after a pair, start its keyframe in the background, and return the estimate."""
        self._state = outcome.state.pose_applied(stamp_ns, self._model)
        # A keyframe implies an accepted pose. Only an external pose with a later stamp would discard the map.
        assert outcome.keyframe is None or self._state.landmark_map is not None
        estimate = self._estimate(stamp_ns, self._state, outcome, clock)
        if outcome.keyframe is not None:
            self._pending = self._background.submit(self._stages.keyframes.make, outcome.keyframe)
        return estimate

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
            tracks=None if outcome.tracks is None else _displayed(outcome.tracks),
        )


def _median_residual_px(tracks: Tracks) -> float:
    """Return the median residual of the inliers, px, from chi-square and the mean variance of each landmark."""
    found = np.isfinite(tracks.observations[:, ::2])
    mean_variance = 0.5 * (tracks.variance[:, :, 0] + tracks.variance[:, :, 2])
    total: FloatArray = np.where(found, mean_variance, 0.0).sum(axis=1)
    residuals = np.sqrt(tracks.chi2_per_dof * (total / np.maximum(found.sum(axis=1), 1)))
    return median(residuals[tracks.inliers])


def _displayed(tracks: Tracks) -> LandmarkTracks:
    """Return copies of the displayed values of tracks."""
    residual = np.sqrt(tracks.chi2_per_dof / INLIER_CHI2_PER_DOF)
    return LandmarkTracks(tracks.observations[:, :2].copy(), tracks.landmarks.last_seen[:, :2].copy(), residual)

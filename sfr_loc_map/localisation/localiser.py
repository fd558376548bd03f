"""The localiser: one call per stereo pair.

A sparse, keyframe-based stereo odometry with a sliding window. `Localiser._locate` runs ten stages. Each row lists what
the stage adds to the values of the previous stages:

| stage | takes | gives | by |
|---|---|---|---|
| 1 check the images | pair, previous pair | findings; `StereoFrame`, stale parts blanked | `stale_images`, `guards` |
| 2 check the map | landmarks of the map | findings | `guards.check_landmarks` |
| 3 predict | last motion, wheel odometry | `Prediction`: guesses of the pose | `motion_model` |
| 4 track | frame, map, guesses | `Tracks` of any motion, and its pose | `frontend.tracking` |
| 5 relocalise, if not trusted | recovery images | other `Tracks` | `relocalisation` |
| 6 select the ground | tracks, earlier images | `Candidate`: tracks of the ground; findings | `ground.selection` |
| 7 correct the right camera | tracks of the ground | corrected tracks | `frontend.right_camera` |
| 8 judge | all findings, candidate | `Verdict`: action, reason | `guards`, `findings.RULES` |
| 9 complete | accepted candidate | tracks of all landmarks, if a keyframe | `keyframes` |
| 10 accept | final tracks | `State` after the pair, `StepEstimate` | `state`, `path`, `uncertainty` |

In stage 4, some landmarks are aligned jointly (direct image alignment as in SVO, Forster et al. 2017). The patches of
more landmarks, warped by their local planes, are then tracked in both images (Lucas and Kanade 1981). Robust least
squares give the pose. In stage 5, the pose is recovered by optical flow, then by SIFT descriptors. In stage 6, the
landmarks are tracked again from the pose if one motion does not explain the tracks. If many landmarks are still
unexplained, another motion is searched for. In stage 9, the pair becomes a keyframe if few landmarks are left, or if
they moved far in the image. A pair that cannot be a reference, or that has too few inliers in the left image, becomes
no keyframe.

Before and after the stages, `Localiser.process`

- adopts the keyframe of the previous call, which was made in the background (`_adopt_keyframe`);
- applies an external pose once its stamp is reached (`State.pose_applied`);
- computes the covariance of the published pose (`_estimate`);
- starts a keyframe in the background: the pair is added to the window, and the window is adjusted (bundle adjustment
  with marginalisation as in OKVIS, Leutenegger et al. 2015; `keyframes`).

**Where a pair is refused, and which reason wins.** A pair has at most four verdicts. Each verdict takes all findings so
far, except that a new window takes only the findings about the images and its own. The first verdict that refuses the
pair ends the stages. If a new window is then refused, too, its reason replaces the earlier reason:

    pair
     |-- 1 the images repeat the previous pair, or show one image twice -----> keep or lose?
     |-- 2 there is no map --------------------------------------------------> may a window begin?
     |     the map has too few landmarks ------------------------------------> may a window begin?
     |-- 8 tracks, pose or the ground's motion are refused ------------------> may a window begin?
     |     the images are swapped (`check_sides`) ---------------------------> may a window begin? (never)
     '-- accepted; degraded if there is a finding

    may a window begin? (`_begin_or_refuse`)
     |-- yes: first pair of a window (`_begin_window`), with findings about the images, a gap, a divergence, the number
     |        of landmarks, and the order of left and right image
     |         |-- refused: lost, with the reason of the window instead of the earlier reason
     |         '-- first pair of the window; degraded if there is a finding
     '-- no: keep or lose? (`_keep_or_lose`)
               |-- action `KEEP`, and the localiser is not lost: kept, until the motion since the last pose is as
               |   uncertain as an unknown pose
               '-- otherwise: lost; if it was lost before and the action is `KEEP`, the earlier reason stays

*Kept*: the last pose is published again with a larger covariance. *Lost*: the pose is unknown. Within a verdict, the
first finding in the order of `findings.RULES` gives action and reason. Findings that refuse the pair come first: a
repeated pair; identical or swapped images; too few landmarks, with a cause in the images before the number; a pose that
the image contradicts, or that is impossible. Then follow findings that degrade the pose: images with stale parts that
are known, or one image without texture; a diverged adjustment; a gap; the calibration; sheared rows; other stale parts;
two motions.

A window may begin if there is no map, or if `MAX_FAILED_RECOVERIES` good images were refused since the last pair that
was accepted or began a window. Images that stage 2 or 8 refused count, but swapped images never count, and images that
contradict the pose (`Action.KEEP`) count only while the localiser is lost. A pair whose images cannot be a reference
for later pairs begins no window. The findings about the pose in the map do not concern a new window, because the window
replaces the map.

**Where the state changes.** The state between two pairs is one immutable value, and its methods are all of its changes
(`state.State` has the table). The localiser learns from a pose in `State.accepted` only, except that the memory
of the ground also learns that an image contradicts a refused pose (`GroundMemory.after_verdict`). Beside the state, the
localiser holds the keyframe that is being made in the background.

**What enlarges the covariance, and by how much.** The covariance of an accepted pose is the sum of seven terms, and
findings and events add to them. With the time t since the last known pose and with the default parameters,

- a finding with `Inflation.UNOBSERVED`, or a kept pair, adds the standard deviations t max(1.0 m/s, last speed) in
  position and t max(0.5 rad/s, last turn rate) in heading, until the next accepted pair;
- a new window adds the same until the next external pose;
- a finding with `Inflation.AMBIGUITY` adds at least the same until the next external pose, and more if the distance to
  the other motion, or the estimated motion, is larger;
- a lost pair replaces the covariance by 9999 m^2 and 9999 rad^2, until the next pair that is not lost.

The docstring of `uncertainty` states all terms and events with their formulas and values.

**Where new code goes.** A new guard is a `Finding`, a row in `findings.RULES`, a function in `guards`, and a call in
`_locate` (a guard of the images), `_refusals_of_pose` (a guard that refuses a pose), `_begin_window` (a guard of a new
window) or `_judge` (any other guard). `findings` has the details. A new error source is a parameter in
`uncertainty.error_sources.ErrorSources`, and a term in `pose_covariance` or `step_covariance`. `uncertainty` lists the
places by the kind of the error.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from time import perf_counter

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.configuration.parameters import checked
from sfr_loc_map.errors import LocalisationError
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
from sfr_loc_map.localisation.frontend.right_camera import RightCameraOffset, pair_yaw
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import INLIER_CHI2_PER_DOF, Tracker, Tracks
from sfr_loc_map.localisation.ground.rigid_motion import MotionTools
from sfr_loc_map.localisation.ground.selection import Ground, changed_cells, select_ground
from sfr_loc_map.localisation.keyframes import (
    KEYFRAME_FLOW_RATIO,
    KeyframeJob,
    KeyframeMaker,
    KeyframeResult,
    adjustment_diverged,
    max_corners,
)
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.relocalisation import MAX_FAILED_RECOVERIES, Relocaliser
from sfr_loc_map.localisation.state import Candidate, Outcome, State
from sfr_loc_map.localisation.uncertainty.error_sources import RoverModel
from sfr_loc_map.localisation.uncertainty.pose_covariance import pose_terms
from sfr_loc_map.parallel import beside


class StageClock:
    """Durations of the stages of one call, s, by name. No result depends on them."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def stage(self, name: str) -> _Stage:
        """Return a context that adds the time within it to a stage."""
        return _Stage(self, name)

    def add(self, name: str, seconds: float) -> None:
        """Add a time that was measured elsewhere to a stage."""
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds


class _Stage:
    """Context that adds the time within it to a stage. A generator as context would take three times as long."""

    def __init__(self, clock: StageClock, name: str) -> None:
        self._clock = clock
        self._name = name

    def __enter__(self) -> None:
        self._start = perf_counter()

    def __exit__(self, *_: object) -> None:
        self._clock.add(self._name, perf_counter() - self._start)


class Localiser:
    """Estimates the pose of RB (the rover's body frame) in DS (the frame of the datum) at each stereo pair.

    A background thread processes the keyframe of a call, and may continue after the call has returned. The next call
    waits for the result, so that results do not depend on timing.

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

        GeometryError if the rig is not a `StereoRig`, has no extrinsics or too small images (`check_rig`), or if the
        pose is invalid (`StartPose.of`). ConfigError if a value of the configuration is invalid, if a mask cannot be
        read, or if its size is not the rig's.
        """
        check_rig(rig)
        config = checked(config)
        self._rig = rig
        self._config = config
        self._model = RoverModel.of(rig, config.motion, KEYFRAME_FLOW_RATIO)
        self._max_corners = max_corners(rig, config)
        self._tracker = Tracker(config.min_tracked, rig.camera)
        self._relocaliser = Relocaliser(self._tracker, config, rig.camera, self._max_corners)
        self._keyframes = KeyframeMaker(rig, config)
        shape = (rig.height, rig.width)
        self._motion_tools = MotionTools(self._tracker, self._relocaliser, rig.camera, shape, config.min_tracked)
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
        """Set an external pose. The pose is valid at its stamp, or at the next pair if it has no stamp.

        The pose replaces an earlier external pose that is not applied yet. Before the first pair, the pose replaces the
        start pose. A stamp more than `path.MAX_AHEAD_NS` after the next pair (for a start pose:
        `path.MAX_START_AHEAD_NS`) indicates a different clock. The pose then applies at the next pair.

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
        """Compile or load all kernels on a small drive, so that later calls take no time for this."""
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

        LocalisationError, and no change, if the pair is not a `StereoPair`, if the image size is not the rig's, or if
        the stamp of the pair is not later than that of the previous pair. GeometryError, and no change, if the
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
        observations (`candidate.tracks`), and for a keyframe contain all landmarks.
        """
        # 1 check the images
        images = stale_images.compare(pair, state.image_memory)
        state = state.arrived(images, pair.stamp_ns)
        landmark_map = state.landmark_map
        findings = guards.check_images(pair, images, has_map=landmark_map is not None)
        verdict = decide(findings)
        if verdict.refuses:
            return self._keep_or_lose(state, verdict, pair.stamp_ns, None)
        with clock.stage("pyramid"):
            frame = StereoFrame.of(images.pair, pair, has_frozen_image=images.is_one_frozen)
        # 2 check the map
        if landmark_map is None:
            return self._begin_or_refuse(state, verdict, frame, findings, None)
        verdict = decide(findings | guards.check_landmarks(frame, landmark_map.landmarks, self._config.min_tracked))
        if verdict.refuses:
            return self._begin_or_refuse(state, verdict, frame, findings, None)
        # 3 predict
        prediction = state.path.last.predict(pair.stamp_ns, odometry, self._model.T_rb_left)
        offset = state.calibration.offset
        # 4 track; beside it, stage 6 begins with a comparison of images, which requires no pose
        change = beside(changed_cells, frame, state.ground_memory)
        with clock.stage("align"):
            coarse = self._tracker.align(frame.left, landmark_map.aligned, prediction.guesses)
        with clock.stage("refine"):
            tracks = self._tracker.refine(frame, landmark_map.tracked, coarse, offset)
        # 5 relocalise
        if not tracks.is_trusted:
            with clock.stage("relocate"):
                found = self._relocaliser.relocalise(frame, landmark_map.tracked, state.recovery, offset)
            if found is not None:
                tracks = found
        # 6 select the ground's motion; landmarks that do not move with the ground are no longer tracked
        changed = change.result()
        if images.is_left_frozen or images.has_stale_rows:
            ground = Ground.unselected(tracks, state.ground_memory)
        else:
            tools = self._motion_tools
            ground = select_ground(
                tools, frame, tracks, prediction, offset, state.ground_memory, state.recovery, changed
            )
        candidate = Candidate(
            frame=frame,
            landmark_map=landmark_map.deactivated(ground.not_ground),
            ground=ground,
            tracks=ground.tracks,
            calibration=state.calibration,
            shear_mean=state.shear_mean,
        )
        # 7 correct the right camera
        candidate = self._with_right_camera(candidate)
        # 8 judge
        verdict = self._judge(state, candidate, findings | ground.findings)
        if verdict.refuses:
            return self._begin_or_refuse(state.refused(candidate, verdict), verdict, frame, findings, candidate.tracks)
        # 9 complete: later pairs are compared with the left image of a reference, which must show enough landmarks
        has_landmarks = candidate.tracks.counts.in_left >= self._config.min_tracked
        is_reference = verdict.can_be_reference and has_landmarks
        is_keyframe = is_reference and self._keyframes.is_needed(candidate.tracks, candidate.landmark_map)
        if is_keyframe:
            with clock.stage("refine"):
                candidate = self._with_all_landmarks(state.path.last, candidate)
        # 10 accept
        return self._accept(state, candidate, verdict, is_reference=is_reference, is_keyframe=is_keyframe)

    def _with_right_camera(self, candidate: Candidate) -> Candidate:
        """Estimate the yaw of the right camera, and correct the right observations for a drift of the right camera.

        Tracks that are not trusted remain unchanged, because stage 8 refuses them.
        """
        tracks = candidate.tracks
        if not tracks.is_trusted:
            return candidate
        camera = self._rig.camera
        shape = (self._rig.height, self._rig.width)
        lens_px = candidate.calibration.lens.likely_px
        yaw = pair_yaw(tracks.pose, tracks.landmarks.estimates, tracks.observed, camera, shape, lens_px)
        if yaw is None:
            return candidate
        calibration, drift_px = candidate.calibration.with_pair(yaw)
        if drift_px != 0.0:
            observations = tracks.observations.copy()
            observations[:, 2:] -= RightCameraOffset(yaw_px=drift_px).at(observations[:, 2:], camera)
            observed = tracks.observed._replace(uv=observations)
            tracks = self._tracker.solve(tracks.landmarks, observed, tracks.pose)
        return candidate._replace(
            tracks=tracks,
            calibration=calibration,
            shear_mean=candidate.shear_mean.with_pair(yaw.shear.chi2),
            shear=yaw.shear,
        )

    def _judge(self, state: State, candidate: Candidate, findings: frozenset[Finding]) -> Verdict:
        """Judge a pose by the findings of the earlier stages, and by the guards that examine a pose."""
        frame = candidate.frame
        tracks = candidate.tracks
        findings |= self._refusals_of_pose(state.path.last, frame, tracks)
        verdict = decide(findings)
        if verdict.refuses:  # the other guards require a valid pose
            return verdict
        findings |= guards.check_sides(frame, tracks, self._tracker, candidate.calibration.offset)
        findings |= guards.check_gap(state.gap_keyframes)
        findings |= guards.check_calibration(candidate.calibration)
        findings |= guards.check_shear(candidate.shear.chi2, candidate.shear_mean)
        return decide(findings)

    def _refusals_of_pose(self, last: LastPose, frame: StereoFrame, tracks: Tracks) -> frozenset[Finding]:
        """Return the findings of the fast guards that refuse poses; they are repeated for the pose of a keyframe."""
        of_pose = guards.check_pose(tracks, last, frame.stamp_ns, self._config.motion)
        return guards.check_tracks(frame, tracks) | of_pose

    def _with_all_landmarks(self, last: LastPose, candidate: Candidate) -> Candidate:
        """Track the remaining landmarks of the map, and solve for the pose from all landmarks.

        Only the errors of keyframes accumulate. Other poses are therefore estimated from fewer landmarks to save time.
        Findings about the images hold for the pose of all landmarks as well, so that only the pose is checked again. If
        that pose is refused, the judged tracks remain.
        """
        tracks = candidate.tracks
        landmark_map = candidate.landmark_map
        rest = landmark_map.rest_of(tracks.landmarks)
        if not len(rest.rows):
            return candidate
        offset = candidate.calibration.offset
        of_all = self._tracker.complete(candidate.frame, tracks, landmark_map.landmarks, rest, offset)
        if self._refusals_of_pose(last, candidate.frame, of_all):
            return candidate
        return candidate._replace(tracks=of_all)

    def _accept(
        self, state: State, candidate: Candidate, verdict: Verdict, *, is_reference: bool, is_keyframe: bool
    ) -> Outcome:
        """Accept a pose: compute its errors and the step to it, and learn from the pair."""
        tracks = candidate.tracks
        after, step = state.accepted(
            candidate, verdict, self._model, is_reference=is_reference, is_keyframe=is_keyframe
        )
        offset = after.calibration.offset
        statistics = TrackingStatistics(
            features=len(tracks.inliers),
            inliers=tracks.inlier_count,
            keyframes=after.keyframes,
            chi_median=tracks.chi_median,
            residual_px=tracks.median_residual_px,
            vertical_offset_px=offset.pitch_px,
            disparity_offset_px=-offset.yaw_px,
            roll_offset_px=offset.roll_px,
            masked_share=after.ground_memory.excluded.fraction,
        )
        keyframe = None
        if is_keyframe:
            mask = after.ground_memory.excluded.mask
            keyframe = KeyframeJob(candidate.frame, tracks, candidate.landmark_map, after.calibration, mask)
        return Outcome(after, statistics, tracks, step, keyframe)

    # ---- pairs without an accepted pose

    def _begin_or_refuse(
        self, state: State, verdict: Verdict, frame: StereoFrame, of_images: frozenset[Finding], tracks: Tracks | None
    ) -> Outcome:
        """Continue with a pair that has no pose in the map. The pair begins a window if it may, or else is refused.

        A pair begins a window if there is no map, or if several good images were refused. A pair that would be kept
        (`KEEP`) counts only while the localiser is lost: without this count, a localiser whose map contradicts all
        images would stay lost. No window begins with a pair that cannot be a reference. This includes a pair in which
        the selection of the ground found stale parts, because new landmarks in these parts would have wrong positions.

        Args:
            state: State before the consequences of the verdict.
            verdict: Verdict on the pair. Without a map, the verdict on its images.
            frame: Images of the pair.
            of_images: Findings about the images, which also hold for a new window.
            tracks: Tracked landmarks, for display; None if nothing was tracked.
        """
        landmark_map = state.landmark_map
        may_begin = landmark_map is None
        is_lost = state.status is TrackingState.LOST
        counts = verdict.action is Action.LOSE_OR_BEGIN or (verdict.action is Action.KEEP and is_lost)
        if landmark_map is not None and counts:
            is_good_image = self._relocaliser.is_good_image(frame, len(landmark_map.landmarks.rows))
            if is_good_image:
                state = state.recovery_failed()
                may_begin = state.failed_recoveries >= MAX_FAILED_RECOVERIES
        if may_begin and verdict.can_be_reference:
            return self._begin_window(state, frame, of_images, tracks)
        return self._keep_or_lose(state, verdict, frame.stamp_ns, tracks)

    def _keep_or_lose(self, state: State, verdict: Verdict, stamp_ns: int, tracks: Tracks | None) -> Outcome:
        """Keep the last pose if the verdict permits this (`KEEP`). Otherwise, the localiser is lost.

        The last pose is kept, with a larger covariance, until the motion since this pose is as uncertain as an unknown
        pose. While the localiser is lost, a pair that would be kept is lost, too, with the earlier reason.
        """
        is_repeated = verdict.finding is Finding.REPEATED_PAIR
        statistics = TrackingStatistics(repeated=1) if is_repeated else TrackingStatistics(inliers=0)
        may_keep = verdict.action is Action.KEEP
        if may_keep and state.status is TrackingState.LOST:
            return Outcome(state.lost(state.reason), statistics, tracks)
        if may_keep:
            kept, step = state.kept(verdict.reason, stamp_ns, self._model)
            if kept.path.errors.kept_motion.max() < LOST_VARIANCE:
                return Outcome(kept, statistics, tracks, step)
        return Outcome(state.lost(verdict.reason), statistics, tracks)

    def _begin_window(
        self, state: State, frame: StereoFrame, of_images: frozenset[Finding], tracks: Tracks | None
    ) -> Outcome:
        """Begin a window at the last known pose with a pair that can be a reference.

        The localiser is lost if the window has too few landmarks, or if the images are swapped. The state is degraded
        if the images have findings, if the motion since the last pose is unobserved, or if an adjustment has diverged.
        Findings about the pose of the pair concern the map that the window replaces, and do not hold for the window.
        """
        pose = Pose.of(state.path.last.T_world_left)
        mask = state.ground_memory.excluded.mask
        window = self._keyframes.begin_window(frame, pose, state.calibration, mask)
        landmarks = window.landmark_map.landmarks
        min_tracked = self._config.min_tracked
        gap_keyframes = state.gap_keyframes_at_window(frame.stamp_ns, self._config.window_keyframes)

        def count_if_swapped() -> int:
            return self._keyframes.landmark_count(frame.swapped(), pose, state.calibration, mask)

        findings = of_images | guards.check_gap(gap_keyframes)
        findings |= guards.check_adjustment(has_diverged=state.has_diverged)
        findings |= guards.check_landmarks(frame, landmarks, min_tracked)
        findings |= guards.check_order(len(landmarks.rows), count_if_swapped, min_tracked, self._max_corners)
        statistics = TrackingStatistics(features=len(landmarks.rows))
        verdict = decide(findings)
        if verdict.refuses:
            if verdict.finding is Finding.FEW_LANDMARKS:  # the excluded cells may be the cause
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
            is_usable = not adjustment_diverged(result.landmark_map, state.path.last.T_world_left)
            self._state = state.adjusted(result, self._model) if is_usable else state.diverged()

    def _commit(self, outcome: Outcome, stamp_ns: int, clock: StageClock) -> PoseEstimate:
        """Store the state after a pair, start its keyframe in the background, and return the estimate."""
        self._state = outcome.state.pose_applied(stamp_ns, self._model)
        # A keyframe implies an accepted pose. Only an external pose with a later stamp would discard the map.
        assert outcome.keyframe is None or self._state.landmark_map is not None
        estimate = self._estimate(stamp_ns, self._state, outcome, clock)
        if outcome.keyframe is not None:
            self._pending = self._background.submit(self._keyframes.make, outcome.keyframe)
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


def _displayed(tracks: Tracks) -> LandmarkTracks:
    """Return copies of the displayed values of tracks."""
    residual = np.sqrt(tracks.chi2_per_dof / INLIER_CHI2_PER_DOF)
    return LandmarkTracks(tracks.observations[:, :2].copy(), tracks.landmarks.last_seen[:, :2].copy(), residual)

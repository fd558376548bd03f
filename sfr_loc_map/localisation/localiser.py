"""The localiser: one call per stereo pair.

A sparse, keyframe-based stereo odometry with a sliding window, in the order of `Localiser._locate`:

1. Check the images: a repeated pair keeps the last pose, stale parts are blanked (`guards`).
2. Predict the pose: constant velocity, standstill, missed pairs, wheel odometry (`motion_model`).
3. Track: align the landmarks of the window as one (direct image alignment, SVO, Forster et al. 2017), then track each
   patch, warped by its local plane, in both images (Lucas and Kanade 1981), and solve for the pose with robust weights.
4. Relocalise if the pose is not trusted: optical flow, then SIFT descriptors (`relocalisation`).
5. Select the ground's motion among the motions in the image (`ground_motion`).
6. Correct the right camera: estimate its rotation, and correct a drift (`backend/online_calibration`).
7. Judge: the findings of all guards and one table decide whether the pose is accepted (`guards.RULES`).
8. Accept: the new path, the covariance of the pose and of the motion since the last one (`path`, `uncertainty`).
9. Keyframe: if few landmarks are left or they moved far, the pair joins the window, which is adjusted in the background
   (bundle adjustment with marginalisation, OKVIS, Leutenegger et al. 2015; `keyframes`).

The state between two pairs is one immutable value (`state.State`); each stage takes values and returns values. What a
pair changes in the state:

| pair | changes |
|---|---|
| accepted (`_accept`) | all fields: only here path, map, calibration, ground and references learn from a pose |
| kept (`_keep`) | images (not by a repeated pair), ground (doubt about it), covariance and step in the path |
| lost (`_lost`) | images, attempts to relocalise; the path forgets its velocity |
| begins a window (`_begin`) | all fields: the window starts at the last known pose |

A pose from outside is applied after each pair (`_with_pose_from_outside`). The result of a keyframe is taken over
before the next pair (`_finish_keyframe`).
"""

from __future__ import annotations

from concurrent.futures import Future, wait
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map import __version__
from sfr_loc_map.config import checked
from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.arrays import FloatArray, median
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation import guards, path
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import (
    LandmarkTracks,
    PoseEstimate,
    StartPose,
    StateReason,
    TrackingState,
    TrackingStatistics,
    lost_covariance,
)
from sfr_loc_map.localisation.frontend.patch import SIDE
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset, right_shift
from sfr_loc_map.localisation.frontend.sparse_stereo import refine_slopes
from sfr_loc_map.localisation.frontend.tracking import INLIER_CHI2_PER_DOF, StereoFrame, Tracker, Tracks
from sfr_loc_map.localisation.ground_motion import Ground, GroundMemory, GroundSelector, Prediction
from sfr_loc_map.localisation.guards import Action, Finding, ImageCheck, ShearMean, Verdict
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW, KeyframeJob, KeyframeMaker, KeyframeResult
from sfr_loc_map.localisation.motion_model import is_plausible
from sfr_loc_map.localisation.parallel import BACKGROUND
from sfr_loc_map.localisation.relocalisation import MAX_ATTEMPTS, KnownImage, References, Relocaliser
from sfr_loc_map.localisation.state import Outcome, StageClock, State
from sfr_loc_map.localisation.uncertainty import RoverModel, pose_covariance, symmetric

BEST_LEFT_RATIO = 0.5  #: Ratio of inliers in the left image from which an image is kept for descriptors.


class CorrectedTracks(NamedTuple):
    """Tracks and calibration after the correction of the right camera."""

    tracks: Tracks  #: Tracks with corrected right observations.
    calibration: OnlineCalibration  #: The calibration, updated by the pair.
    shear_mean: ShearMean  #: The running mean, updated by the pair.
    shear: float = 0.0  #: Squared shear of the rows over its variance.


class Candidate(NamedTuple):
    """A pair whose pose is trusted but not accepted yet."""

    frame: StereoFrame
    tracks: Tracks  #: Tracks of the ground, with corrected right observations.
    landmark_map: LandmarkMap  #: The map without the landmarks that do not move with the ground.
    ground: Ground
    corrected: CorrectedTracks


class Localiser:
    """Estimates the pose of RB in DS at each stereo pair.

    The work of a keyframe is done after its call in a background thread. The next call waits for it, so that results do
    not depend on timing.
    """

    version = __version__

    def __init__(
        self,
        rig: StereoRig,
        config: LocalisationConfig = LocalisationConfig(),  # noqa: B008 - frozen
        start: StartPose | Transform = Transform.identity(),  # noqa: B008 - frozen, nobody writes to it
    ) -> None:
        """Start at a pose of RB in DS; without a stamp it holds at the first pair.

        GeometryError if the rig has no extrinsics; ConfigError if a mask cannot be read or has another size.
        """
        config = checked(config)
        self._rig = rig
        self._config = config
        self._camera = rig.camera
        self._model = RoverModel.of(rig, config.motion, KEYFRAME_FLOW)
        self._tracker = Tracker(config.min_tracked, rig.camera)
        self._relocaliser = Relocaliser(self._tracker, config, rig.camera)
        self._ground = GroundSelector(
            self._tracker, self._relocaliser, rig.camera, (rig.height, rig.width), config.min_tracked
        )
        self._keyframes = KeyframeMaker(rig, config, self._tracker)
        self._pending: Future[KeyframeResult] | None = None
        self.reset(start)

    def reset(self, start: StartPose | Transform) -> None:
        """Forget everything and start again at a pose."""
        if self._pending is not None:
            wait([self._pending])
        self._pending = None
        self._state = State(
            path=path.started(StartPose.of(start), self._model),
            calibration=OnlineCalibration(self._camera, self._config.window_keyframes),
            ground=GroundMemory.none((self._rig.height, self._rig.width)),
        )

    def set_pose(self, pose: StartPose | Transform) -> None:
        """Apply a pose from outside: it holds at its stamp; without a stamp, at the next pair."""
        self._state = replace(self._state, path=path.given(self._state.path, StartPose.of(pose), self._model))

    @property
    def masks(self) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint8] | None]:
        """Masks `(H, W)` of the left and right image: no landmark is created where a mask is 0. None masks nothing."""
        return self._keyframes.masks(self._state.ground.excluded.mask)

    @staticmethod
    def warm_up() -> None:
        """Load or compile all kernels by a small drive, so that no call pays for it."""
        width, height = 320, 240
        rig = StereoRig(width, height, 300.0, 300.0, 160.0, 120.0, 0.1, Transform.identity())
        texture = np.random.default_rng(0).integers(0, 255, (height, width + 200), np.uint8)
        localiser = Localiser(rig, LocalisationConfig(window_keyframes=2, max_features=100, min_tracked=8))
        for stamp_ns, shift in enumerate((0, 4, 30, 60, 90, 150)):
            left, right = (np.ascontiguousarray(texture[:, s : s + width]) for s in (shift, shift + 10))
            localiser.process(StereoPair(stamp_ns, left, right))
        localiser.process(StereoPair(6, np.zeros_like(left), np.zeros_like(left)))
        # landmarks of large images, which the small rig does not have
        image = np.zeros((SIDE, SIDE), np.float32)
        at = np.zeros((1, 2))
        refine_slopes(image, np.zeros((1, 3, SIDE * SIDE), np.float32), at, at)
        localiser.reset(Transform.identity())  # waits for the last keyframe

    def process(self, pair: StereoPair, odometry: Transform | None = None) -> PoseEstimate:
        """Return the pose at a pair.

        The odometry, for example of the wheels, is the motion of RB since the last pair, `T_before_now`. It is used as
        an initial guess only.

        LocalisationError if the images have another size than the rig.
        """
        self._check_size(pair)
        clock = StageClock()
        with clock.stage("wait"):
            self._finish_keyframe(clock)
        state = replace(self._state, path=path.arrived(self._state.path, pair.stamp_ns))
        outcome = self._locate(state, pair, odometry, clock)
        self._state = self._with_pose_from_outside(outcome.state, pair.stamp_ns)
        estimate = self._estimate(pair.stamp_ns, self._state, outcome, clock)
        if outcome.keyframe is not None:
            self._pending = BACKGROUND.submit(self._keyframes.make, outcome.keyframe)
        return estimate

    # ---- the stages of a pair

    def _locate(self, state: State, pair: StereoPair, odometry: Transform | None, clock: StageClock) -> Outcome:
        """Find the pose of a pair; the stages are those of the module's text."""
        landmark_map = state.landmark_map
        images = guards.check_images(pair, state.images)
        if Finding.REPEATED_PAIR in images.findings and landmark_map is not None:
            return self._refuse(state, Finding.REPEATED_PAIR, pair.stamp_ns, TrackingStatistics(repeated=1))
        state = replace(state, images=images.memory)
        if guards.is_one_image(pair):
            return self._refuse(state, Finding.IDENTICAL_IMAGES, pair.stamp_ns)
        # the first window has no earlier landmarks to be compared with: it may begin with stale images
        with clock.stage("pyramid"):
            frame = StereoFrame.of(pair if landmark_map is None else images.pair)
        if landmark_map is None:
            return self._begin(state, frame)
        if Finding.STALE_ROWS in images.findings:
            state = replace(state, ground=state.ground.after_stale_rows(images.stale_rows))
        if len(landmark_map.landmarks.index) < self._config.min_tracked:
            return self._refuse(state, guards.of_few_landmarks(frame), pair.stamp_ns, frame=frame)

        guesses = state.path.motion.predict(pair.stamp_ns, odometry, self._model)
        prediction = Prediction(guesses, state.calibration.offset)
        tracks = self._track(frame, landmark_map, prediction, state.references, clock)
        ground = self._select_ground(frame, tracks, prediction, state, images)
        if Finding.CONTRADICTED in ground.findings:
            state = replace(state, ground=ground.memory)  # the doubt about the ground outlasts the pair
            return self._refuse(state, Finding.CONTRADICTED, pair.stamp_ns)
        if not ground.tracks.is_trusted:
            return self._refuse(state, guards.of_few_landmarks(frame), pair.stamp_ns, frame=frame, tracks=ground.tracks)
        corrected = self._correct_right_camera(ground.tracks, state.calibration, state.shear)
        candidate = Candidate(frame, corrected.tracks, landmark_map.without(ground.not_ground), ground, corrected)
        return self._judge(state, candidate, images.findings | ground.findings, clock)

    def _track(
        self,
        frame: StereoFrame,
        landmark_map: LandmarkMap,
        prediction: Prediction,
        references: References,
        clock: StageClock,
    ) -> Tracks:
        """Track the landmarks of the map; relocalise if the pose is not trusted."""
        landmarks = landmark_map.followed
        with clock.stage("align"):
            coarse = self._tracker.align(frame.left, landmark_map.aligned, prediction.guesses.all)
        with clock.stage("refine"):
            tracks = self._tracker.refine(frame, landmarks, coarse, prediction.offset)
        if tracks.is_trusted:
            return tracks
        with clock.stage("relocate"):
            found = self._relocaliser.relocalise(frame, landmarks, references, prediction.offset)
        return found or tracks

    def _select_ground(
        self, frame: StereoFrame, tracks: Tracks, prediction: Prediction, state: State, images: ImageCheck
    ) -> Ground:
        """Select the ground's motion. Images with blanked rows cannot be compared with earlier ones."""
        if Finding.STALE_ROWS in images.findings:
            return Ground(tracks, state.ground)
        return self._ground.select(frame, tracks, prediction, state.ground, state.references)

    def _correct_right_camera(
        self, tracks: Tracks, calibration: OnlineCalibration, shear: ShearMean
    ) -> CorrectedTracks:
        """Estimate the shift of the right image, and correct the right observations for a drift of the right camera."""
        lens_px = calibration.lens.likely_px
        shift = right_shift(tracks.pose, tracks.landmarks.estimates, tracks.seen, self._camera, lens_px)
        if not np.isfinite(shift.variance):  # too few landmarks in both images
            return CorrectedTracks(tracks, calibration, shear)
        calibration, drift_px = calibration.with_lens_residuals(shift).with_shift(shift)
        if drift_px != 0.0:
            observations = tracks.observations.copy()
            observations[:, 2:] -= RightOffset(u=drift_px).at(observations[:, 2:], self._camera)
            seen = tracks.seen._replace(uv=observations)
            tracks = self._tracker.solve(tracks.landmarks, seen, tracks.pose)
        return CorrectedTracks(tracks, calibration, shear.with_pair(shift.shear), shift.shear)

    def _judge(self, state: State, candidate: Candidate, findings: frozenset[Finding], clock: StageClock) -> Outcome:
        """Judge a pose by all guards; accept it if none refuses it."""
        frame, tracks, _, _, corrected = candidate
        refusal: Finding | None = None
        is_one_sided = guards.is_one_sided(frame, tracks)
        if not tracks.is_trusted:
            refusal = guards.of_few_landmarks(frame)
        elif not guards.is_determined(tracks):
            refusal = Finding.SINGULAR
        elif is_one_sided and self._tracker.fits_swapped(frame, tracks, corrected.calibration.offset):
            refusal = Finding.SWAPPED
        elif not is_plausible(state.path.motion, frame.stamp_ns, tracks.pose, self._config.motion):
            refusal = Finding.TOO_FAST
        if refusal is not None:
            return self._refuse(state, refusal, frame.stamp_ns, frame=frame, tracks=tracks)
        findings |= guards.check_shear(corrected.shear, corrected.shear_mean)
        findings |= guards.check_calibration(corrected.calibration)
        if is_one_sided:
            findings |= {Finding.ONE_SIDED}
        if state.keyframes < state.settled_from:
            findings |= {Finding.AFTER_GAP}
        return self._accept(state, candidate, guards.decide(findings), clock)

    def _accept(self, state: State, candidate: Candidate, verdict: Verdict, clock: StageClock) -> Outcome:
        """Accept a pose, and make the pair a keyframe if one is needed.

        In a keyframe all landmarks are tracked, and the pose is solved for once more by the same images. This pose
        replaces the judged one if it is trusted and determined.
        """
        frame, tracks, landmark_map, ground, corrected = candidate
        calibration = corrected.calibration
        # later pairs are only compared with complete left images
        may_be_keyframe = verdict.may_be_keyframe and tracks.left_inlier_count >= self._config.min_tracked
        is_keyframe = may_be_keyframe and self._keyframes.is_needed(tracks, landmark_map)
        if is_keyframe:
            with clock.stage("refine"):
                tracks = self._with_all_landmarks(candidate)
        chi_median, residual_px = residual_statistics(tracks)
        pair = path.TrackedPair(
            stamp_ns=frame.stamp_ns,
            tracks=tracks,
            chi_median=chi_median,
            was_known=state.status is not TrackingState.LOST,
            adds_unobserved=verdict.adds_unobserved,
            shear=corrected.shear,
            ambiguity=ground.ambiguity,
        )
        new_path, step = path.tracked(state.path, pair, landmark_map, calibration, self._model)
        state = replace(
            state,
            path=new_path,
            landmark_map=landmark_map,
            calibration=calibration,
            shear=corrected.shear_mean,
            ground=ground.accepted(is_compared=verdict.may_be_keyframe),
            references=_with_reference(state.references, frame, tracks)
            if may_be_keyframe
            else state.references.recognised(),
            keyframes=state.keyframes + int(is_keyframe),
            status=TrackingState.TRACKING if verdict.action is Action.ACCEPT else TrackingState.DEGRADED,
            reason=verdict.reason,
        )
        statistics = TrackingStatistics(
            features=len(tracks.inliers),
            inliers=tracks.inlier_count,
            keyframes=state.keyframes,
            chi_median=chi_median,
            residual_px=residual_px,
            vertical_offset_px=calibration.offset.v,
            disparity_offset_px=-calibration.offset.u,
            roll_offset_px=calibration.offset.roll,
            masked_share=state.ground.excluded.fraction,
        )
        keyframe = None
        if is_keyframe:
            keyframe = KeyframeJob(frame, tracks, landmark_map.window, calibration, state.ground.excluded.mask)
        return Outcome(state, statistics, tracks, step, keyframe)

    def _with_all_landmarks(self, candidate: Candidate) -> Tracks:
        """Track the remaining landmarks, too, because all of them are observed in a keyframe."""
        frame, tracks, landmark_map, _, corrected = candidate
        landmarks = landmark_map.landmarks
        if len(tracks.inliers) >= len(landmarks.index):
            return tracks
        if np.array_equal(tracks.landmarks.index, landmark_map.followed.index):
            rest = landmark_map.rest  # its patches are already copied
        else:
            rest = landmarks.subset(~landmarks.among(tracks.landmarks))
        complete = self._tracker.complete(frame, tracks, landmarks, rest, corrected.calibration.offset)
        return complete if complete.is_trusted and guards.is_determined(complete) else tracks

    # ---- pairs without an accepted pose

    def _refuse(
        self,
        state: State,
        finding: Finding,
        stamp_ns: int,
        statistics: TrackingStatistics = TrackingStatistics(inliers=0),  # noqa: B008 - frozen
        *,
        frame: StereoFrame | None = None,
        tracks: Tracks | None = None,
    ) -> Outcome:
        """Refuse a pair, by the action that `RULES` has for the finding."""
        action, reason, *_ = guards.RULES[finding]
        if action is Action.KEEP and state.status is not TrackingState.LOST:
            kept, step = path.kept(state.path, stamp_ns, self._model)
            state = replace(state, path=kept, status=TrackingState.DEGRADED, reason=reason)
            return Outcome(state, statistics, step=step)
        if action is Action.KEEP:  # a lost localiser stays lost, for the same reason
            return self._lost(state, state.reason, statistics)
        if action is Action.RESTART and frame is not None:
            count = 0 if state.landmark_map is None else len(state.landmark_map.landmarks.index)
            if self._relocaliser.is_good_image(frame, count):
                state = replace(state, references=state.references.after_attempt())
                if state.references.attempts > MAX_ATTEMPTS:
                    return self._begin(state, frame, tracks)
        return self._lost(state, reason, statistics, tracks)

    def _lost(
        self, state: State, reason: StateReason | None, statistics: TrackingStatistics, tracks: Tracks | None = None
    ) -> Outcome:
        """Report that the pose is unknown."""
        state = replace(state, path=path.lost(state.path), status=TrackingState.LOST, reason=reason)
        return Outcome(state, statistics, tracks)

    def _begin(self, state: State, frame: StereoFrame, tracks: Tracks | None = None) -> Outcome:
        """Begin a window at the last known pose; stay lost without enough landmarks.

        The window is degraded if no image has shown the motion since that pose.
        """
        pose = Pose.of(state.path.motion.T_world_left)
        result = self._keyframes.begin(frame, pose, state.calibration, state.ground.excluded.mask)
        found = len(result.landmark_map.landmarks.index)
        statistics = TrackingStatistics(features=found)
        if found < self._config.min_tracked:
            return self._lost(state, guards.RULES[guards.of_few_landmarks(frame)].reason, statistics, tracks)
        keyframes = state.keyframes + 1
        status = TrackingState.INITIALISING if keyframes == 1 else TrackingState.TRACKING
        reason: StateReason | None = None
        settled_from = state.settled_from
        if state.path.motion.unobserved_s(frame.stamp_ns) > 0.0:
            status = TrackingState.DEGRADED
            reason = guards.RULES[Finding.AFTER_GAP].reason
            settled_from = keyframes + self._config.window_keyframes - 1
        restarted, step = path.restarted(state.path, frame.stamp_ns, result.landmark_map, self._model)
        state = replace(
            state,
            path=restarted,
            landmark_map=result.landmark_map,
            calibration=result.calibration,
            references=References.of_first_keyframe(frame.image, result.landmark_map.landmarks),
            ground=state.ground.in_new_window(frame, pose),
            keyframes=keyframes,
            settled_from=settled_from,
            status=status,
            reason=reason,
        )
        return Outcome(state, statistics, tracks, step)

    # ---- before and after the stages

    def _check_size(self, pair: StereoPair) -> None:
        height, width = pair.left.shape
        if (height, width) != (self._rig.height, self._rig.width):
            raise LocalisationError(
                f"pair {pair.stamp_ns} has {width} x {height} pixels, the rig has {self._rig.width} x "
                f"{self._rig.height}: give images of the rig"
            )

    def _finish_keyframe(self, clock: StageClock) -> None:
        """Wait for the keyframe of the call before, and continue from its adjusted map, pose and calibration."""
        if self._pending is None:
            return
        pending = self._pending
        self._pending = None
        result = pending.result()
        clock.seconds["keyframe"] = result.seconds
        window = result.landmark_map.window
        state = self._state
        adjusted = path.adjusted(state.path, window.newest_pose, window.covariance, has_yaw_step=result.has_yaw_step)
        if adjusted is None:  # the adjustment diverged: a new window begins with the next pair
            calibration = OnlineCalibration(self._camera, self._config.window_keyframes)
            self._state = replace(state, landmark_map=None, calibration=calibration)
            return
        self._state = replace(
            state,
            path=adjusted,
            landmark_map=result.landmark_map,
            calibration=result.calibration,
            references=state.references.with_keyframe(result.landmark_map.landmarks),
        )

    def _with_pose_from_outside(self, state: State, stamp_ns: int) -> State:
        """Apply a pending pose from outside, if its stamp has come."""
        placed, is_map_forgotten = path.with_pending_pose(state.path, stamp_ns, self._model)
        return replace(state, path=placed, landmark_map=None if is_map_forgotten else state.landmark_map)

    def _estimate(self, stamp_ns: int, state: State, outcome: Outcome, clock: StageClock) -> PoseEstimate:
        """Return the pose of RB in DS with its covariance, from that of the left camera in the world."""
        datum = state.path.datum
        T_ds_left = datum.T_ds_world @ state.path.motion.T_world_left
        T_ds_rb = T_ds_left @ self._model.T_left_rb
        if state.status is TrackingState.LOST:
            covariance = lost_covariance()
        else:
            position = state.path.motion.T_world_left.translation
            depth_m = 0.0 if state.landmark_map is None else state.landmark_map.landmarks.median_depth
            of_left = pose_covariance(state.path.errors, position, depth_m, state.calibration, self._model)
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


def _with_reference(references: References, frame: StereoFrame, tracks: Tracks) -> References:
    """Return the images for relocalisation with a pair whose pose was accepted."""
    known = KnownImage(frame.image, tracks.observations[:, :2], tracks.landmarks)
    is_best = tracks.left_inlier_count >= BEST_LEFT_RATIO * len(tracks.inliers)
    return references.recognised().with_image(known, is_best=is_best)


def residual_statistics(tracks: Tracks) -> tuple[float, float]:
    """Return the median chi-square per degree of freedom, and the median residual of the inliers, px."""
    chi2 = tracks.chi2_per_dof
    found = np.isfinite(tracks.observations[:, ::2])
    mean_variance = 0.5 * (tracks.variance[:, :, 0] + tracks.variance[:, :, 2])
    total: FloatArray = np.where(found, mean_variance, 0.0).sum(axis=1)
    residuals = np.sqrt(chi2 * (total / np.maximum(found.sum(axis=1), 1)))
    return median(chi2[~np.isnan(chi2)]), median(residuals[tracks.inliers])


def displayed(tracks: Tracks) -> LandmarkTracks:
    """Return what is shown of tracks."""
    residual = np.sqrt(tracks.chi2_per_dof / INLIER_CHI2_PER_DOF)
    return LandmarkTracks(tracks.observations[:, :2], tracks.landmarks.last_seen[:, :2], residual)

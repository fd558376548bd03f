"""The localiser: one call per stereo pair."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map import __version__
from sfr_loc_map.config import checked
from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import UNSETTLED_PX
from sfr_loc_map.localisation.backend.sliding_window import SlidingWindow
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import (
    PoseEstimate,
    StartPose,
    StateReason,
    StepEstimate,
    TrackingState,
    TrackingStatistics,
    lost_covariance,
)
from sfr_loc_map.localisation.frontend.patch import SIDE, build_pyramid
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset, StereoObservations, right_shift
from sfr_loc_map.localisation.frontend.sparse_stereo import refine_slopes
from sfr_loc_map.localisation.frontend.tracking import MIN_TEXTURE, StereoFrame, Tracker, TrackingResult, is_textured
from sfr_loc_map.localisation.ground_motion import GroundMotion, GroundMotionFinder, Guesses
from sfr_loc_map.localisation.image_checks import StaleImageFilter
from sfr_loc_map.localisation.keyframe_backend import KEYFRAME_FLOW, KeyframeBackend
from sfr_loc_map.localisation.parallel import BACKGROUND, both
from sfr_loc_map.localisation.pose_track import PoseTrack
from sfr_loc_map.localisation.relocalisation import KnownImage, Relocaliser

MIN_RIGHT_SHARE = 0.3
"""Share of the landmarks seen in the left image that are seen in the right one too, below which the images may be
swapped, or one of them old."""

MAX_SHEAR = 7.0
"""Squared shear of the rows over its variance, per degree of freedom, of an image of one moment: at most 6.4 on clean
drives, 7 and more where the rows are sheared by a pixel."""
FIRST_SHEAR_SHARE = 0.2  #: Share of a pair in the mean of it, which is 1 before the first, and less with each
SHEAR_SHARE = 0.05  #: until it is this,
MAX_MEAN_SHEAR = 1.4  #: which is at most 1.3 on clean drives, real ones too, and 2 to 5 at a shear of 0.3 px.
KEYFRAME_SHARE = 0.65  #: Share of the last keyframe's landmarks below which a new keyframe is made.
Outcome = tuple[TrackingStatistics, StepEstimate | None, tuple[SlidingWindow, StereoFrame, TrackingResult] | None]
"""Figures of a call, the step to its pose (None when lost), and the keyframe to be made of its pair."""


class Localiser:
    """Estimates the pose of RB in DS at each stereo pair; `last_result` is what was tracked, trusted or not, or None.

    What a keyframe needs besides its pose (new landmarks, bundle adjustment) is done after its call, in a background
    thread; the next call waits for it, so that results do not depend on timing.
    """

    version = __version__

    def __init__(
        self,
        rig: StereoRig,
        config: LocalisationConfig = LocalisationConfig(),  # noqa: B008 - frozen
        start: StartPose | Transform = Transform.identity(),  # noqa: B008 - frozen, nobody writes to it
    ) -> None:
        """Start at a pose of RB in DS, without a stamp at the first pair; GeometryError if a rig has no extrinsics."""
        config = checked(config)
        self._rig, self._config, self._camera = rig, config, rig.camera
        self._tracker = Tracker(config, rig.camera)
        self._backend = KeyframeBackend(rig, config, self._tracker)
        self.reset(start)

    def reset(self, start: StartPose | Transform) -> None:
        """Forget everything and restart at this pose."""
        self._backend.reset()
        self._relocaliser = Relocaliser(self._tracker, self._config, self._rig.camera)
        self._ground = GroundMotionFinder(self._tracker, self._relocaliser, self._rig, self._config)
        self._track = PoseTrack(self._rig, self._config.motion, StartPose.of(start))
        self._stale = StaleImageFilter()
        self._state = TrackingState.INITIALISING
        self._reason: StateReason | None = None
        self._stage_s: dict[str, float] = {}
        self._doubted_keyframes, self._shear, self._shear_share = 0, 1.0, FIRST_SHEAR_SHARE
        self.last_result: TrackingResult | None = None

    def set_pose(self, pose: StartPose | Transform) -> None:
        """Take a pose from outside: it holds at its stamp; without one the next estimate starts there."""
        self._track.set_pose(StartPose.of(pose))

    @property
    def masks(self) -> tuple[NDArray[np.uint8] | None, NDArray[np.uint8] | None]:
        """Where no landmark is made in the left and the right image: `(H, W)` uint8, 0 there; None for nowhere."""
        return self._backend.masks

    @property
    def statistics(self) -> dict[str, float]:
        """Landmarks (`features`) of the last pair, and how many agree with its pose; empty where none was tracked."""
        result = self.last_result
        return {} if result is None else {"features": len(result.inliers), "inliers": result.inlier_count}

    @staticmethod
    def warm_up() -> None:
        """Load or compile all kernels, the same for all rigs, by driving a small one, so that no call pays for it."""
        width, height = 320, 240
        rig = StereoRig(width, height, 300.0, 300.0, 160.0, 120.0, 0.1, Transform.identity())
        texture = np.random.default_rng(0).integers(0, 255, (height, width + 200), np.uint8)
        localiser = Localiser(rig, LocalisationConfig(window_keyframes=2, max_features=100, min_tracked=8))
        for stamp_ns, shift in enumerate((0, 4, 30, 60, 90, 150)):
            left, right = (np.ascontiguousarray(texture[:, s : s + width]) for s in (shift, shift + 10))
            localiser.process(StereoPair(stamp_ns, left, right))
        localiser.process(StereoPair(6, np.zeros_like(left), np.zeros_like(left)))
        # what the small rig has no use for: landmarks of large images
        image, at = np.zeros((SIDE, SIDE), np.float32), np.zeros((1, 2))
        refine_slopes(image, np.zeros((1, 3, SIDE * SIDE), np.float32), at, at)
        localiser.reset(Transform.identity())  # waits for the last keyframe

    def process(self, pair: StereoPair, motion: Transform | None = None) -> PoseEstimate:
        """Return the pose at a pair; `T_before_now`, by wheel odometry, say, is how RB moved since: one more guess."""
        rig, track, backend, relocaliser = self._rig, self._track, self._backend, self._relocaliser
        stamp_ns = pair.stamp_ns
        if pair.left.shape != (rig.height, rig.width):
            found, needed = f"{pair.left.shape[1]} x {pair.left.shape[0]}", f"{rig.width} x {rig.height}"
            raise LocalisationError(f"pair {stamp_ns} is {found}, the rig is {needed}: give images of the rig")
        self.last_result, self._stage_s, start = None, {}, perf_counter()
        if backend.pending is not None and backend.window is not None:
            self._stage_s["keyframe"], backend.pending = backend.pending.result(), None
            rotations, positions = backend.window.problem.keyframes
            if not track.adjusted(Pose(rotations[-1], positions[-1]), backend.window.covariance, backend.corrected):
                backend.reset()
            elif relocaliser.last is not None:  # that image is a keyframe now
                before, landmarks = relocaliser.last, backend.landmarks
                relocaliser.last = KnownImage(before.image, landmarks.last_seen[:, :2], landmarks)
                relocaliser.best = relocaliser.last if relocaliser.best is before else relocaliser.best
        self._stage_s["wait"] = perf_counter() - start
        if track.before_first_pair:
            track.arrive(stamp_ns)
        statistics, step, keyframe = self._see(pair, motion)
        if track.pending is not None and track.bind(track.pending, stamp_ns):
            backend.leave_window()
        T_ds_left = track.T_ds_world @ track.T_world_left
        T_ds_rb = T_ds_left @ track.T_left_rb
        if self._state is TrackingState.LOST:
            covariance = lost_covariance()
        else:
            of_left = track.covariance_of_left(backend.landmarks.median_depth, backend.calibration)
            lever = T_ds_rb.translation - T_ds_left.translation
            of_rb = propagated_covariance(of_left, lever, track.T_ds_world.rotation)
            covariance = np.asarray(0.5 * (of_rb + of_rb.T))
        stages = dict(self._stage_s)  # a keyframe in work adds to them
        if keyframe is not None:  # the backend belongs to its thread from here until the next call has waited
            backend.pending = BACKGROUND.submit(backend.add_keyframe, *keyframe)
        return PoseEstimate(stamp_ns, T_ds_rb, covariance, self._state, statistics, stages, self._reason, step)

    def _see(self, pair: StereoPair, motion: Transform | None) -> Outcome:
        """Find the pose of a pair: predict, align, refine, relocalise where that fails; follow the ground."""
        track, backend, tracker, camera = self._track, self._backend, self._tracker, self._camera
        stamp_ns, window, calibration = pair.stamp_ns, backend.window, backend.calibration
        fresh, doubt = self._stale.fresh(pair, may_repeat=window is not None)
        if fresh is None:
            return self._keep(stamp_ns, StateReason.REPEATED_IMAGES, TrackingStatistics(repeated=1))
        few = slice(len(pair.left) // 2, None, 64)  # rows that tell most others
        is_one_image = np.array_equal(pair.left[few], pair.right[few]) and np.array_equal(pair.left, pair.right)
        if is_one_image and float(np.std(pair.left)) > MIN_TEXTURE:
            return self._unknown(StateReason.NO_STEREO, TrackingStatistics())
        start = perf_counter()
        shown = pair if window is None else fresh
        frame = StereoFrame(stamp_ns, shown.left, *both(build_pyramid, (shown.left,), (shown.right,)))
        self._stage_s["pyramid"] = perf_counter() - start
        if window is None:
            return self._begin(frame)
        if doubt is StateReason.TORN_IMAGES:
            self._ground.tear(self._stale.rows)
        if len(backend.landmarks.index) < self._config.min_tracked:
            return self._lose(frame, _few_landmarks(frame))
        landmarks, start = backend.landmarks.followed, perf_counter()
        guesses = Guesses(track.guesses(stamp_ns, motion), calibration.offset)
        coarse = tracker.align(frame.left, landmarks.few, guesses.poses)
        aligned = perf_counter()
        result = tracker.refine(frame, landmarks, coarse, guesses.offset)
        refined = perf_counter()
        self._stage_s |= {"align": aligned - start, "refine": refined - aligned}
        if not result.trusted:
            result = self._relocaliser.relocalise(frame, landmarks, guesses.offset) or result
            self._stage_s["relocate"] = perf_counter() - refined
        ground = GroundMotion(result)
        if doubt is not StateReason.TORN_IMAGES:
            ground = self._ground.find(frame, result, guesses)
            if not ground.seen:
                return self._keep(stamp_ns, StateReason.MOVING_REGIONS, TrackingStatistics())
            result, backend.dynamic_mask = ground.result, self._ground.cells.mask
            if len(ground.dynamic):
                window.active[ground.dynamic] = False
                backend.landmarks = window.landmarks()
        if result.trusted:  # follow a drift of the right camera
            seen = StereoObservations(result.observations, result.variance)
            px, variance, shear, *residuals = right_shift(
                result.pose, result.landmarks.estimates, seen, camera, calibration.likely_lens_px
            )
            calibration.learn_lens(*residuals)
            self._shear_share = max(self._shear_share / (1.0 + self._shear_share), SHEAR_SHARE)
            self._shear += self._shear_share * (shear - self._shear)
            sheared = ground.sheared or shear > MAX_SHEAR or self._shear > MAX_MEAN_SHEAR
            ground = ground._replace(sheared=sheared, shear=shear)
            px = calibration.learn_shift(px, variance)
            if px != 0.0:
                observations = result.observations.copy()
                observations[:, 2:] -= RightOffset(u=px).at(observations[:, 2:], camera)
                shifted = replace(result, observations=observations)
                result = tracker.refine(frame, result.landmarks, result.pose, calibration.offset, shifted)
        self.last_result = result
        if not result.trusted:
            return self._lose(frame, _few_landmarks(frame))
        sign, size = np.linalg.slogdet(result.information)
        if not (sign > 0.0 and np.isfinite(size) and np.isfinite(np.column_stack(result.pose)).all()):
            return self._lose(frame, StateReason.IMPLAUSIBLE_MOTION)
        one_sided = result.right_share <= MIN_RIGHT_SHARE and is_textured(frame.right)
        if one_sided and tracker.fits_swapped(frame, result, calibration.offset):
            return self._unknown(StateReason.NO_STEREO, TrackingStatistics(inliers=0))  # no window begins with it
        # what the left image alone shows may be old: the right one shows something else
        return self._update(frame, window, ground._replace(result=result, sheared=ground.sheared or one_sided), doubt)

    def _update(
        self, frame: StereoFrame, window: SlidingWindow, ground: GroundMotion, doubt: StateReason | None
    ) -> Outcome:
        """Take the pose that was found, if it is plausible; make the pair a keyframe where one is wanted."""
        track, backend, calibration, result = self._track, self._backend, self._backend.calibration, ground.result
        depth_m, in_left = backend.landmarks.median_depth, np.isfinite(result.observations[:, 0])
        # the right image alone gives a pose, but nothing that later pairs can start from, nor do parts of images
        left_inliers = int(np.count_nonzero(result.inliers & in_left))
        by_left = doubt is None and ground.whole and left_inliers >= self._config.min_tracked
        # a keyframe where few landmarks of the last one are left, or they moved far
        last_seen = result.landmarks.last_seen
        flow = np.linalg.norm(result.observations[:, :2] - last_seen[:, :2], axis=1)[result.inliers]
        flow = np.sort(flow[np.isfinite(flow)])
        if result.landmarks is not backend.landmarks.followed:
            last_seen = last_seen[result.landmarks.among(backend.landmarks)]
        wanted = by_left and (
            len(flow) < KEYFRAME_SHARE * np.count_nonzero(np.isfinite(last_seen[:, 0]))
            or (
                len(flow) > 0
                and flow[(len(flow) - 1) // 2] + flow[len(flow) // 2] > 2 * KEYFRAME_FLOW * self._rig.width
            )
        )
        if wanted:
            start = perf_counter()
            if len(result.inliers) < len(backend.landmarks.index):  # in a keyframe all landmarks are tracked
                all_of_them = self._tracker.refine(frame, backend.landmarks, result.pose, calibration.offset, result)
                result = all_of_them if all_of_them.trusted else result
            self._stage_s["refine"] += perf_counter() - start
            left_inliers = int(np.count_nonzero(result.inliers & np.isfinite(result.observations[:, 0])))
        # typical residual: root of chi2 per degree of freedom times the mean variance
        found, offset = np.isfinite(result.observations[:, ::2]), calibration.offset
        total = np.where(found, 0.5 * (result.variance[:, :, 0] + result.variance[:, :, 2]), 0.0).sum(axis=1)
        residuals = np.sqrt(result.chi2_per_dof * (total / np.maximum(found.sum(axis=1), 1)))
        in_order = np.sort(result.chi2_per_dof[~np.isnan(result.chi2_per_dof)]), np.sort(residuals[result.inliers])
        chi_median, residual_px = (float(0.5 * (x[(len(x) - 1) // 2] + x[len(x) // 2])) for x in in_order)
        step = track.moved(
            frame.stamp_ns,
            result,
            window,
            depth_m,
            calibration,
            chi_median,
            follows=self._state is not TrackingState.LOST,
            late=ground.sheared or not ground.whole,
            shear=ground.shear,
            doubt=ground.doubt,
        )
        if step is None:
            return self._lose(frame, StateReason.IMPLAUSIBLE_MOTION)
        reasons = (
            (doubt is not None, doubt),
            (backend.keyframe_count < self._doubted_keyframes, StateReason.UNSEEN_MOTION),
            (calibration.drifts or abs(calibration.remaining_u) > UNSETTLED_PX, StateReason.CALIBRATION_DRIFT),
            (ground.sheared or not ground.whole, StateReason.TORN_IMAGES),
            (ground.doubt is not None, StateReason.MOVING_REGIONS),
        )
        self._reason = next((reason for there, reason in reasons if there), None)
        self._state = TrackingState.TRACKING if self._reason is None else TrackingState.DEGRADED
        self._relocaliser.attempts = 0
        if by_left:
            self._relocaliser.last = known = KnownImage(frame.image, result.observations[:, :2], result.landmarks)
            if left_inliers >= 0.5 * len(result.inliers):
                self._relocaliser.best = known
        statistics = TrackingStatistics(
            features=len(result.inliers),
            inliers=result.inlier_count,
            keyframes=backend.keyframe_count + int(wanted),
            chi_median=chi_median,
            residual_px=residual_px,
            vertical_offset_px=offset.v,
            disparity_offset_px=-offset.u,
            roll_offset_px=offset.roll,
            masked_share=self._ground.cells.share,
        )
        return statistics, step, (window, frame, result) if wanted else None

    def _keep(self, stamp_ns: int, reason: StateReason, statistics: TrackingStatistics) -> Outcome:
        """Keep the last pose; the rover may stand still, or have moved."""
        if self._state is TrackingState.LOST:
            return self._unknown(self._reason, statistics)
        self._state, self._reason = TrackingState.DEGRADED, reason
        return statistics, self._track.kept(stamp_ns), None

    def _begin(self, frame: StereoFrame) -> Outcome:
        """Begin a window at the last known pose; stay lost without enough landmarks."""
        track, backend = self._track, self._backend
        found = backend.begin(frame, track.T_world_left)
        statistics = TrackingStatistics(features=found)
        if found < self._config.min_tracked or backend.window is None:
            return self._unknown(_few_landmarks(frame), statistics)
        self._state, self._reason = TrackingState.TRACKING, None
        if track.unseen_s(frame.stamp_ns) > 0.0:
            self._state, self._reason = TrackingState.DEGRADED, StateReason.UNSEEN_MOTION
            self._doubted_keyframes = backend.keyframe_count + self._config.window_keyframes - 1
        elif backend.keyframe_count == 1:
            self._state = TrackingState.INITIALISING
        landmarks = backend.landmarks
        self._ground.begin(frame, Pose.of(track.T_world_left))
        step = track.begin(frame.stamp_ns, backend.window.covariance, landmarks.median_depth)
        self._relocaliser.restart(frame.image, landmarks)
        return statistics, step, None

    def _lose(self, frame: StereoFrame, reason: StateReason) -> Outcome:
        """Report that the pose is unknown; begin a new window where good images come and none is recognised."""
        if self._relocaliser.gives_up(frame, self._backend.landmarks):
            return self._begin(frame)
        return self._unknown(reason, TrackingStatistics(inliers=0))

    def _unknown(self, reason: StateReason | None, statistics: TrackingStatistics) -> Outcome:
        self._track.stop()
        self._state, self._reason = TrackingState.LOST, reason
        return statistics, None, None


def _few_landmarks(frame: StereoFrame) -> StateReason:
    textured = is_textured(frame.left) and is_textured(frame.right)
    return StateReason.FEW_LANDMARKS if textured else StateReason.UNTEXTURED_IMAGES

"""The localiser: one call per stereo pair."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map import __version__
from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.arrays import median
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig, are_equal
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.sliding_window import SlidingWindow
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.covariance_model import StepModel, covariance_of_point
from sfr_loc_map.localisation.estimate import (
    PoseEstimate,
    StartPose,
    StateReason,
    StepEstimate,
    TrackingState,
    TrackingStatistics,
    lost_covariance,
)
from sfr_loc_map.localisation.frontend.dynamic_regions import stays
from sfr_loc_map.localisation.frontend.patch import SIDE, build_pyramid
from sfr_loc_map.localisation.frontend.pose_solver import RightOffset, StereoObservations, right_shift
from sfr_loc_map.localisation.frontend.sparse_stereo import refine_slopes
from sfr_loc_map.localisation.frontend.tracking import MIN_TEXTURE, StereoFrame, Tracker, TrackingResult, is_textured
from sfr_loc_map.localisation.ground_motion import GroundMotion, GroundMotionFinder, Guesses
from sfr_loc_map.localisation.image_checks import Exposure, StaleImageFilter
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend
from sfr_loc_map.localisation.parallel import both
from sfr_loc_map.localisation.pose_track import PoseTrack
from sfr_loc_map.localisation.relocalisation import Relocaliser

MIN_RIGHT_SHARE = 0.3
"""Share of the landmarks seen in the left image that are seen in the right one too, below which the images may be
swapped."""


class Localiser:
    """Estimates the pose of RB in DS at each stereo pair.

    What a keyframe needs besides its pose (new landmarks, bundle adjustment) is done after its call, in a background
    thread; the next call waits for it, so that results do not depend on timing.

    Attributes:
        last_result: Tracking result of the last pair, trusted or not; None where no landmark was tracked.
    """

    version = __version__

    def __init__(
        self,
        rig: StereoRig,
        config: LocalisationConfig = LocalisationConfig(),  # noqa: B008 - frozen
        start: StartPose | Transform = Transform.identity(),  # noqa: B008 - frozen, nobody writes to it
    ) -> None:
        """Start at a given pose.

        Args:
            rig: Rectified rig with its extrinsics.
            config: Parameters.
            start: Pose of RB in DS; one without a stamp holds at the first pair.

        Raises:
            GeometryError: If the extrinsics of the rig are unknown.
            ConfigError: If a mask cannot be read or has another size than the rig.
        """
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
        self._steps = StepModel(self._rig)
        self._stale = StaleImageFilter()
        self._state = TrackingState.INITIALISING
        self._reason: StateReason | None = None
        self._stage_s: dict[str, float] = {}
        self._doubted_keyframes = 0
        self.last_result: TrackingResult | None = None

    def set_pose(self, pose: StartPose | Transform) -> None:
        """Take a pose from outside: it holds at its stamp; without one the next estimate starts there."""
        self._finish_keyframe()
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
        """Load or compile all kernels, so that no call pays for it; they are the same for all rigs."""
        _warm_up()

    def process(self, pair: StereoPair, motion: Transform | None = None) -> PoseEstimate:
        """Return the pose at one pair; pairs come in the order of their stamps.

        Args:
            pair: Images of the rig's size.
            motion: One more initial guess, as by wheel odometry: motion of RB since the last pair, `T_before_now`.

        Raises:
            LocalisationError: If the pair does not have the rig's size.
        """
        rig, track, backend = self._rig, self._track, self._backend
        if pair.left.shape != (rig.height, rig.width):
            found, needed = f"{pair.left.shape[1]} x {pair.left.shape[0]}", f"{rig.width} x {rig.height}"
            raise LocalisationError(f"pair {pair.stamp_ns} is {found}, the rig is {needed}: give images of the rig")
        self.last_result, self._stage_s, start = None, {}, perf_counter()
        if backend.pending is not None:
            self._finish_keyframe()
        self._stage_s["wait"] = perf_counter() - start
        if track.before_first_pair:
            track.arrive(pair.stamp_ns)
        window = backend.window
        fresh, doubt = self._stale.fresh(pair, may_repeat=window is not None)
        if fresh is None:
            return self._repeat(pair.stamp_ns)
        if are_equal(pair.left, pair.right) and float(np.std(pair.left)) > MIN_TEXTURE:
            return self._unknown(pair.stamp_ns, StateReason.NO_STEREO, TrackingStatistics())
        start = perf_counter()
        shown = pair if window is None else fresh
        frame = StereoFrame(pair.stamp_ns, shown.left, *both(build_pyramid, (shown.left,), (shown.right,)))
        self._stage_s["pyramid"] = perf_counter() - start
        if window is None:
            return self._begin(frame)
        if len(backend.landmarks.index) < self._config.min_tracked:
            return self._lose(frame, _few_landmarks(frame))
        ground = self._find(frame, window, motion, torn=doubt is StateReason.TORN_IMAGES)
        self.last_result = result = ground.result
        if not result.trusted:
            return self._lose(frame, _few_landmarks(frame))
        sign, size = np.linalg.slogdet(result.information)
        if not (sign > 0.0 and np.isfinite(size)) or track.plausible(frame.stamp_ns, result.pose) is None:
            return self._lose(frame, StateReason.IMPLAUSIBLE_MOTION)
        one_sided = result.right_share <= MIN_RIGHT_SHARE and is_textured(frame.right)
        if one_sided and self._tracker.fits_swapped(frame, result, backend.calibration.offset):
            return self._lose(frame, StateReason.NO_STEREO)
        return self._update(frame, window, ground, doubt)

    def _find(self, frame: StereoFrame, window: SlidingWindow, motion: Transform | None, *, torn: bool) -> GroundMotion:
        """Predict, align, refine, relocalise where that fails; follow the ground, and a drift of the right camera."""
        backend, tracker = self._backend, self._tracker
        landmarks, calibration, start = backend.landmarks.followed, backend.calibration, perf_counter()
        guesses = Guesses(self._track.guesses(frame.stamp_ns, motion), calibration.offset)
        coarse = tracker.align(frame.left, landmarks.few, guesses.poses)
        aligned = perf_counter()
        result = tracker.refine(frame, landmarks, coarse, guesses.offset)
        refined = perf_counter()
        self._stage_s |= {"align": aligned - start, "refine": refined - aligned}
        if not result.trusted:
            result = self._relocaliser.relocalise(frame, landmarks, guesses.offset) or result
            self._stage_s["relocate"] = perf_counter() - refined
        if torn:
            self._ground.tears.tear(self._stale.rows)
            ground = GroundMotion(result)
        else:
            ground = self._ground.find(frame, result, guesses)
            result, backend.dynamic_mask = ground.result, self._ground.regions.mask
            if len(ground.dynamic):
                backend.stop_tracking(window, ground.dynamic)
        if not result.trusted:
            return ground
        seen, camera = StereoObservations(result.observations, result.variance), self._camera
        px = calibration.learn_shift(*right_shift(result.pose, result.landmarks.estimates, seen, camera))
        if px != 0.0:
            observations = result.observations.copy()
            observations[:, 2:] -= RightOffset(u=px).at(observations[:, 2:], camera)
            result = tracker.solve(result.pose, result.landmarks, observations, result.variance)
        return ground._replace(result=result)

    def _update(
        self, frame: StereoFrame, window: SlidingWindow, ground: GroundMotion, doubt: StateReason | None
    ) -> PoseEstimate:
        """Take the pose that was found; add a keyframe where one is wanted."""
        track, backend, calibration, result = self._track, self._backend, self._backend.calibration, ground.result
        follows = self._state is not TrackingState.LOST
        # the right image alone gives a pose, but nothing that later pairs can start from, nor do parts of images
        left_inliers = int(np.count_nonzero(result.inliers & np.isfinite(result.observations[:, 0])))
        whole = doubt is None and ground.exposure is not Exposure.TORN
        by_left = whole and left_inliers >= self._config.min_tracked
        wanted = by_left and backend.wants_keyframe(result)
        if wanted:
            start = perf_counter()
            result = backend.complete(frame, result)
            self._stage_s["refine"] += perf_counter() - start
            left_inliers = int(np.count_nonzero(result.inliers & np.isfinite(result.observations[:, 0])))
        now, depth_m = Transform(*result.pose), backend.landmarks.median_depth
        reasons = (
            (doubt is not None, doubt),
            (ground.exposure is not Exposure.WHOLE, StateReason.TORN_IMAGES),
            (backend.keyframe_count < self._doubted_keyframes, StateReason.UNSEEN_MOTION),
            (calibration.drifts, StateReason.CALIBRATION_DRIFT),
            (ground.doubt is not None, StateReason.MOVING_REGIONS),
        )
        self._reason = next((reason for there, reason in reasons if there), None)
        self._state = TrackingState.TRACKING if self._reason is None else TrackingState.DEGRADED
        if ground.doubt is not None:
            track.covariance.doubt(now.translation, ground.doubt)
        in_window = np.asarray(np.linalg.inv(result.information) + window.covariance)
        position, step = now.translation, now.translation - track.T_world_left.translation
        mark = track.covariance.follow(position, step, in_window, depth_m, calibration.constant_u)
        late = ground.exposure is not Exposure.WHOLE
        unseen = track.allow_unseen(frame.stamp_ns) if late else np.zeros((6, 6))
        track.moved(frame.stamp_ns, now, mark, follows=follows)
        self._relocaliser.attempts = 0
        if by_left:
            self._relocaliser.remember(frame.image, result, left_inliers)
        chi_median = median(result.chi2_per_dof[~np.isnan(result.chi2_per_dof)])
        # typical residual: root of chi2 per degree of freedom times the mean variance
        found, offset = np.isfinite(result.observations[:, ::2]), calibration.offset
        total = np.where(found, 0.5 * (result.variance[:, :, 0] + result.variance[:, :, 2]), 0.0).sum(axis=1)
        residuals = np.sqrt(result.chi2_per_dof * (total / np.maximum(found.sum(axis=1), 1)))
        statistics = TrackingStatistics(
            features=len(result.inliers),
            inliers=result.inlier_count,
            keyframes=backend.keyframe_count + wanted,
            chi_median=chi_median,
            residual_px=median(residuals[result.inliers]),
            vertical_offset_px=offset.v,
            disparity_offset_px=-offset.u,
            roll_offset_px=offset.roll,
            masked_share=self._ground.regions.share,
        )
        moved = self._steps.tracked(
            frame.stamp_ns, now, result, chi_median, window.drift, calibration, unseen, ground.doubt
        )
        estimate = self._estimate(frame.stamp_ns, statistics, moved)
        if wanted:  # the backend belongs to its thread from here until the next call has waited
            backend.add_keyframe(window, frame, result)
        return estimate

    def _repeat(self, stamp_ns: int) -> PoseEstimate:
        """Return the last pose again; the rover may stand still, or have moved."""
        statistics = TrackingStatistics(repeated=1)
        if self._state is TrackingState.LOST:
            return self._unknown(stamp_ns, self._reason, statistics)
        self._track.allow_unseen(stamp_ns)
        self._state, self._reason = TrackingState.DEGRADED, StateReason.REPEATED_IMAGES
        return self._estimate(stamp_ns, statistics, self._unseen_step(stamp_ns))

    def _begin(self, frame: StereoFrame) -> PoseEstimate:
        """Begin a window at the last known pose; stay lost without enough landmarks."""
        track, backend = self._track, self._backend
        found = backend.begin(frame, track.T_world_left)
        if found < self._config.min_tracked or backend.window is None:
            return self._unknown(frame.stamp_ns, _few_landmarks(frame), TrackingStatistics(features=found))
        self._state, self._reason = TrackingState.TRACKING, None
        if track.unseen_s(frame.stamp_ns) > 0.0:
            self._state, self._reason = TrackingState.DEGRADED, StateReason.UNSEEN_MOTION
            self._doubted_keyframes = backend.keyframe_count + self._config.window_keyframes - 1
        elif backend.keyframe_count == 1:
            self._state = TrackingState.INITIALISING
        landmarks, position = backend.landmarks, track.T_world_left.translation
        covariance = track.covariance.of_start_and_drift(position) + track.unseen(frame.stamp_ns)
        step = self._unseen_step(frame.stamp_ns)
        in_window = backend.window.covariance
        track.begin(frame.stamp_ns, track.covariance.start(position, covariance, in_window, landmarks.median_depth))
        self._relocaliser.restart(frame.image, landmarks)
        return self._estimate(frame.stamp_ns, TrackingStatistics(features=found), step)

    def _unseen_step(self, stamp_ns: int) -> StepEstimate:
        return self._steps.unseen(stamp_ns, self._track.T_world_left, self._track.unseen_of_rb(stamp_ns))

    def _lose(self, frame: StereoFrame, reason: StateReason) -> PoseEstimate:
        """Report that the pose is unknown; begin a new window where good images come and none is recognised."""
        if self._relocaliser.gives_up(frame, self._backend.landmarks):
            return self._begin(frame)
        return self._unknown(frame.stamp_ns, reason, TrackingStatistics(inliers=0))

    def _unknown(self, stamp_ns: int, reason: StateReason | None, statistics: TrackingStatistics) -> PoseEstimate:
        """Return the last pose as lost."""
        self._track.stop()
        self._state, self._reason = TrackingState.LOST, reason
        return self._estimate(stamp_ns, statistics, None)

    def _finish_keyframe(self) -> None:
        """Wait for the keyframe in work, and go on from its adjusted pose; leave a window that is not plausible."""
        backend, track = self._backend, self._track
        seconds, window = backend.wait(), backend.window
        if seconds is None or window is None:
            return
        self._stage_s["keyframe"] = seconds
        adjusted = track.plausible(track.known_ns or 0, window.pose)
        if adjusted is None or not np.isfinite(window.covariance).all():
            backend.reset()
            return
        track.T_world_left = adjusted
        track.covariance.set_in_window(window.covariance)
        self._relocaliser.update(backend.landmarks)

    def _estimate(self, stamp_ns: int, statistics: TrackingStatistics, step: StepEstimate | None) -> PoseEstimate:
        track, backend = self._track, self._backend
        if track.pending is not None and track.bind(track.pending, stamp_ns):
            backend.leave_window()
        T_ds_left = track.T_ds_world @ track.T_world_left
        T_ds_rb = T_ds_left @ track.T_left_rb
        if self._state is TrackingState.LOST:
            covariance = lost_covariance()
        else:
            depth_m, position = backend.landmarks.median_depth, track.T_world_left.translation
            of_left = track.covariance.of_left(position, depth_m, backend.calibration)
            lever = T_ds_rb.translation - T_ds_left.translation
            covariance = covariance_of_point(of_left, track.T_ds_world.rotation, lever)
        stages = dict(self._stage_s)  # a keyframe in work adds to them
        return PoseEstimate(stamp_ns, T_ds_rb, covariance, self._state, statistics, stages, self._reason, step)


def _few_landmarks(frame: StereoFrame) -> StateReason:
    """Return why a pair gives too few landmarks."""
    textured = is_textured(frame.left) and is_textured(frame.right)
    return StateReason.FEW_LANDMARKS if textured else StateReason.UNTEXTURED_IMAGES


def _warm_up() -> None:
    """Drive a small rig: small steps until a keyframe leaves the window, a leap that flow recovers, black images."""
    width, height = 320, 240
    rig = StereoRig(width, height, 300.0, 300.0, 160.0, 120.0, 0.1, Transform.identity())
    texture = np.random.default_rng(0).integers(0, 255, (height, width + 200), np.uint8)
    config = LocalisationConfig(window_keyframes=2, max_features=100, min_tracked=8)
    localiser = Localiser(rig, config, Transform.identity())
    for stamp_ns, shift in enumerate((0, 4, 30, 60, 90, 150)):
        left, right = (np.ascontiguousarray(texture[:, s : s + width]) for s in (shift, shift + 10))
        localiser.process(StereoPair(stamp_ns, left, right))
    localiser.process(StereoPair(6, np.zeros_like(left), np.zeros_like(left)))
    # what the small rig has no use for: a body at rest in the image, landmarks of large images
    image, at = np.zeros((SIDE, SIDE), np.float32), np.zeros((1, 2))
    stays(image, np.zeros((1, SIDE * SIDE), np.float32), at)
    refine_slopes(image, np.zeros((1, 3, SIDE * SIDE), np.float32), at, at)
    localiser.set_pose(Transform.identity())  # waits for the last keyframe

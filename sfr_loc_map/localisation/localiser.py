"""The localiser: one call per stereo pair."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.covariance_model import CovarianceModel, covariance_of_rb
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState, TrackingStatistics, lost_covariance
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend
from sfr_loc_map.localisation.motion_model import MotionModel
from sfr_loc_map.localisation.relocalisation import Relocaliser
from sfr_loc_map.localisation.stage_timer import StageTimer


class Localiser:
    """Estimates the pose of RB in DS at each stereo pair.

    What a keyframe needs besides its pose (new landmarks, bundle adjustment) is done after its call, in a background
    thread; the next call waits for it, so that results do not depend on timing.
    """

    def __init__(self, rig: StereoRig, config: LocalisationConfig, T_ds_rb: Transform) -> None:
        """Start at a given pose.

        Args:
            rig: Rectified rig with its extrinsics.
            config: Parameters.
            T_ds_rb: Pose of RB in DS at the first pair.

        Raises:
            GeometryError: If the extrinsics of the rig are unknown.
            ConfigError: If a mask cannot be read or has another size than the rig.
        """
        self._rig, self._config, self._T_rb_left = rig, config, rig.T_rb_left
        self._camera = rig.camera
        self._tracker = Tracker(config, self._camera)
        self._backend = KeyframeBackend(rig, config, self._camera, self._tracker)
        self.reset(T_ds_rb)

    def reset(self, T_ds_rb: Transform) -> None:
        """Forget everything and restart at this pose."""
        self._backend.reset()
        self._motion = MotionModel(self._T_rb_left)
        self._covariance = CovarianceModel(self._rig, self._config)
        self._relocaliser = Relocaliser(self._tracker, self._config, self._camera)
        self._T_ds_world, self._T_world_left = T_ds_rb @ self._T_rb_left, Transform.identity()
        self._state, self._timer = TrackingState.INITIALISING, StageTimer()
        self._last_pair: StereoPair | None = None
        self._last_result: TrackingResult | None = None

    @property
    def last_result(self) -> TrackingResult | None:
        """Tracking result of the last pair, trusted or not; None where no landmark was tracked."""
        return self._last_result

    def set_pose(self, T_ds_rb: Transform) -> None:
        """Let the next estimate start at this pose."""
        self._finish_keyframe()
        self._T_ds_world = T_ds_rb @ self._T_rb_left @ self._T_world_left.inverse()

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
        _check_size(pair, self._rig)
        self._timer = StageTimer()
        with self._timer("wait"):
            self._finish_keyframe()
        if self._is_repeated(pair):
            return self._repeat(pair)
        self._last_pair, self._last_result = pair, None
        with self._timer("pyramid"):
            frame = StereoFrame.of(pair)
        if not self._backend.started:
            return self._begin(frame, np.zeros((6, 6)))
        if len(self._backend.landmarks) >= self._config.min_tracked:
            self._last_result = self._track(frame, motion)
        if self._last_result is None or not self._believes(frame, self._last_result):
            return self._lose(frame)
        return self._update(frame, self._last_result)

    def _track(self, frame: StereoFrame, motion: Transform | None) -> TrackingResult:
        """Predict, align, refine, and relocalise where that fails."""
        landmarks, offset = self._backend.landmarks, self._backend.calibration.offset
        with self._timer("align"):
            guesses = self._motion.predictions(self._T_world_left, frame.stamp_ns, motion)
            start = self._tracker.align(frame.left, landmarks, guesses)
        with self._timer("refine"):
            result = self._tracker.refine(frame, landmarks, start, offset)
        if self._tracker.trusts(result):
            return result
        with self._timer("relocate"):
            return self._relocaliser.relocalise(frame, landmarks, offset) or result

    def _believes(self, frame: StereoFrame, result: TrackingResult) -> bool:
        offset = self._backend.calibration.offset
        return self._tracker.trusts(result) and not self._tracker.left_right_swapped(frame, result, offset)

    def _update(self, frame: StereoFrame, result: TrackingResult) -> PoseEstimate:
        """Take the pose that was found; add a keyframe where one is wanted."""
        last, self._T_world_left = self._T_world_left, result.T_world_left
        self._state = TrackingState.TRACKING
        self._motion.update(frame.stamp_ns, last.inverse() @ self._T_world_left)
        backend, step = self._backend, self._T_world_left.translation - last.translation
        self._covariance.step(step, backend.landmarks.median_depth, backend.calibration.offset.u)
        self._covariance.set_in_window(np.asarray(np.linalg.inv(result.information) + backend.covariance))
        # the right image alone gives a pose, but nothing that later pairs can start from
        by_left = result.left_inlier_count >= self._config.min_tracked
        self._relocaliser.recovered()
        if by_left:
            self._relocaliser.remember(frame.image, result)
        wanted = by_left and backend.wants_keyframe(result)
        statistics = _statistics(result, backend.calibration.offset, backend.keyframe_count + wanted)
        estimate = self._estimate(frame.stamp_ns, statistics)
        if wanted:  # the backend belongs to its thread from here until the next call has waited
            backend.add_keyframe(frame, result)
        return estimate

    def _repeat(self, pair: StereoPair) -> PoseEstimate:
        """Return the last pose again; the rover may stand still, or have moved on as before."""
        self._covariance.repeat(self._motion.step)
        self._state = TrackingState.TRACKING
        return self._estimate(pair.stamp_ns, TrackingStatistics(repeated=1))

    def _begin(self, frame: StereoFrame, covariance: FloatArray) -> PoseEstimate:
        """Begin a window at the last known pose with its covariance `(6, 6)`; stay lost without enough landmarks."""
        found = self._backend.begin(frame, self._T_world_left)
        if found < self._config.min_tracked:
            self._state = TrackingState.LOST
            return self._estimate(frame.stamp_ns, TrackingStatistics(features=found))
        first = self._backend.keyframe_count == 1
        self._state = TrackingState.INITIALISING if first else TrackingState.TRACKING
        landmarks, position = self._backend.landmarks, self._T_world_left.translation
        self._motion.restart(frame.stamp_ns)
        self._covariance.start(position, covariance, self._backend.covariance, landmarks.median_depth)
        self._relocaliser.restart(frame.image, landmarks)
        return self._estimate(frame.stamp_ns, TrackingStatistics(features=found))

    def _lose(self, frame: StereoFrame) -> PoseEstimate:
        """Report that the pose is unknown; begin a new window where good images come and none is recognised."""
        self._state = TrackingState.LOST
        self._motion.stop()
        if self._relocaliser.gives_up(frame, self._backend.landmarks):
            position = self._T_world_left.translation
            return self._begin(frame, self._covariance.after_gap(position, self._backend.covariance))
        return self._estimate(frame.stamp_ns, TrackingStatistics(inliers=0))

    def _finish_keyframe(self) -> None:
        """Wait for the keyframe in work, and go on from its adjusted pose."""
        seconds = self._backend.wait()
        if seconds is None:
            return
        self._timer.seconds["keyframe"] = seconds
        self._T_world_left = self._backend.T_world_left
        self._covariance.set_in_window(self._backend.covariance)
        self._relocaliser.update(self._backend.landmarks)

    def _estimate(self, stamp_ns: int, statistics: TrackingStatistics) -> PoseEstimate:
        T_ds_left = self._T_ds_world @ self._T_world_left
        T_ds_rb = T_ds_left @ self._T_rb_left.inverse()
        covariance = lost_covariance()
        if self._state is not TrackingState.LOST:
            depth_m, calibration = self._backend.landmarks.median_depth, self._backend.calibration
            of_left = self._covariance.of_left(self._T_world_left.translation, depth_m, calibration)
            lever = T_ds_rb.translation - T_ds_left.translation
            covariance = covariance_of_rb(of_left, self._T_ds_world.rotation, lever)
        return PoseEstimate(stamp_ns, T_ds_rb, covariance, self._state, statistics, self._timer.seconds)

    def _is_repeated(self, pair: StereoPair) -> bool:
        """Tell whether the last pair came again while its pose was known."""
        known = self._backend.started and self._state is not TrackingState.LOST
        return known and self._last_pair is not None and is_duplicate_pair(self._last_pair, pair)


def is_duplicate_pair(before: StereoPair, now: StereoPair) -> bool:
    """Tell whether two pairs have bit-identical images."""
    return np.array_equal(before.left, now.left) and np.array_equal(before.right, now.right)


def _check_size(pair: StereoPair, rig: StereoRig) -> None:
    if pair.left.shape != (rig.height, rig.width):
        found = f"{pair.left.shape[1]} x {pair.left.shape[0]}"
        needed = f"{rig.width} x {rig.height}"
        raise LocalisationError(f"pair {pair.stamp_ns} is {found}, the rig is {needed}: give images of the rig")


def _statistics(result: TrackingResult, offset: RightOffset, keyframes: int) -> TrackingStatistics:
    return TrackingStatistics(
        features=len(result.landmarks),
        inliers=int(result.inliers.sum()),
        keyframes=keyframes,
        chi_median=float(np.nanmedian(result.chi2_per_dof)),
        residual_px=result.residual_px,
        vertical_offset_px=offset.v,
        disparity_offset_px=-offset.u,
        roll_offset_px=offset.roll,
    )


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
    localiser.set_pose(Transform.identity())  # waits for the last keyframe

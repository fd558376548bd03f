"""The localiser: one call per stereo pair."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import LocalisationError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.belief import are_finite, blindness, disbelief, reason_to_doubt
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import (
    PoseEstimate,
    StateReason,
    Status,
    StepEstimate,
    TrackingState,
    TrackingStatistics,
    lost_covariance,
)
from sfr_loc_map.localisation.frontend.foreign_regions import stays
from sfr_loc_map.localisation.frontend.patch import SIDE
from sfr_loc_map.localisation.frontend.patch_slopes import refine_slopes
from sfr_loc_map.localisation.frontend.tracking import MIN_TEXTURE, StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.ground_motion import GroundMotionFinder, Guesses
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend
from sfr_loc_map.localisation.motion_model import MotionModel
from sfr_loc_map.localisation.pose_track import PoseTrack
from sfr_loc_map.localisation.relocalisation import Relocaliser
from sfr_loc_map.localisation.reporter import Reporter
from sfr_loc_map.localisation.stage_timer import StageTimer
from sfr_loc_map.localisation.stale_images import StaleImageFilter
from sfr_loc_map.localisation.start_pose import StartPose
from sfr_loc_map.localisation.step_uncertainty import StepModel
from sfr_loc_map.localisation.torn_images import Wholeness


class Localiser(Reporter):
    """Estimates the pose of RB in DS at each stereo pair.

    What a keyframe needs besides its pose (new landmarks, bundle adjustment) is done after its call, in a background
    thread; the next call waits for it, so that results do not depend on timing.
    """

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
        self._rig, self._config = rig, config
        self._tracker = Tracker(config, rig.camera)
        self._backend = KeyframeBackend(rig, config, rig.camera, self._tracker)
        self.reset(start)

    def reset(self, start: StartPose | Transform) -> None:
        """Forget everything and restart at this pose."""
        self._backend.reset()
        self._motion = MotionModel(self._rig.T_rb_left)
        self._relocaliser = Relocaliser(self._tracker, self._config, self._rig.camera)
        self._ground = GroundMotionFinder(self._tracker, self._relocaliser, self._rig, self._config)
        self._track = PoseTrack(self._rig, self._config, StartPose.of(start))
        self._steps = StepModel(self._rig, self._config)
        self._stale = StaleImageFilter()
        self._status, self._timer = Status(TrackingState.INITIALISING), StageTimer()
        self._doubted_keyframes = 0
        self._last_result: TrackingResult | None = None

    def set_pose(self, pose: StartPose | Transform) -> None:
        """Take a pose from outside: it holds at its stamp; without one the next estimate starts there."""
        self._finish_keyframe()
        self._track.set_pose(StartPose.of(pose))

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
        self._timer, self._last_result = StageTimer(), None
        with self._timer("wait"):
            self._finish_keyframe()
        self._track.arrive(pair.stamp_ns)
        if (stale := self._stale.compare(pair)).is_repeated and self._backend.started:
            return self._repeat(pair)
        fresh, doubt = self._stale.fresh(pair, stale)
        if pair.identical_images and float(np.std(pair.left)) > MIN_TEXTURE:
            return self._unknown(pair.stamp_ns, StateReason.NO_STEREO, TrackingStatistics())
        with self._timer("pyramid"):
            frame = StereoFrame.of(fresh if self._backend.started else pair)
        if not self._backend.started:
            return self._begin(frame)
        if len(self._backend.landmarks) >= self._config.min_tracked:
            self._last_result = self._find(frame, motion, torn=doubt is StateReason.TORN_IMAGES)
        if (result := self._last_result) is None:
            return self._lose(frame, blindness(frame))
        if (reason := disbelief(frame, result, self._tracker, self._track, self._backend.calibration)) is not None:
            return self._lose(frame, reason)
        return self._update(frame, result, doubt)

    @property
    def _known(self) -> bool:
        """Whether the pose of the last pair is known."""
        return self._backend.started and self._status.state is not TrackingState.LOST

    def _find(self, frame: StereoFrame, motion: Transform | None, *, torn: bool) -> TrackingResult:
        """Predict, align, refine, and relocalise where that fails."""
        landmarks, offset = self._backend.landmarks.followed, self._backend.calibration.offset
        with self._timer("align"):
            guesses = self._motion.predictions(self._track.T_world_left, frame.stamp_ns, motion)
            start = self._tracker.align(frame.left, landmarks, guesses)
        with self._timer("refine"):
            result = self._tracker.refine(frame, landmarks, start, offset)
        if not self._tracker.trusts(result):
            with self._timer("relocate"):
                result = self._relocaliser.relocalise(frame, landmarks, offset) or result
        if torn:
            self._ground.skip(self._stale.rows)
        else:
            result, foreign = self._ground.find(frame, result, Guesses(guesses, offset))
            self._backend.leave_out(foreign, self._ground.regions.mask)
        return self._backend.without_drift(result) if self._tracker.trusts(result) else result

    def _update(self, frame: StereoFrame, result: TrackingResult, doubt: StateReason | None) -> PoseEstimate:
        """Take the pose that was found; add a keyframe where one is wanted."""
        track, backend, follows = self._track, self._backend, self._known
        ground, early = self._ground, backend.keyframe_count < self._doubted_keyframes
        # the right image alone gives a pose, but nothing that later pairs can start from, nor do parts of images
        whole = doubt is None and ground.wholeness is not Wholeness.TORN
        by_left = whole and result.left_inlier_count >= self._config.min_tracked
        wanted = by_left and backend.wants_keyframe(result)
        with self._timer("refine"):
            result = backend.complete(frame, result) if wanted else result
        now = result.T_world_left
        motion, step = track.T_world_left.inverse() @ now, now.translation - track.T_world_left.translation
        self._status = Status.of_tracked(doubt or reason_to_doubt(ground, backend.calibration, early=early))
        if ground.doubt is not None:
            track.covariance.doubt(now.translation, ground.doubt)
        self._motion.update(frame.stamp_ns, motion)
        track.covariance.step(step, backend.landmarks.median_depth, backend.calibration.constant_u)
        track.covariance.set_in_window(np.asarray(np.linalg.inv(result.information) + backend.covariance))
        unseen = np.zeros((6, 6)) if ground.wholeness is Wholeness.WHOLE else track.allow_unseen(frame.stamp_ns)
        track.moved(frame.stamp_ns, now, motion if follows else None)
        self._relocaliser.recovered()
        if by_left:
            self._relocaliser.remember(frame.image, result)
        statistics = _statistics(result, backend, backend.keyframe_count + wanted, ground.regions.share)
        moved = self._steps.tracked(frame.stamp_ns, result, backend.drift, backend.calibration, unseen, ground.doubt)
        estimate = self._estimate(frame.stamp_ns, statistics, moved)
        if wanted:  # the backend belongs to its thread from here until the next call has waited
            backend.add_keyframe(frame, result)
        return estimate

    def _repeat(self, pair: StereoPair) -> PoseEstimate:
        """Return the last pose again; the rover may stand still, or have moved."""
        if not self._known:
            return self._unknown(pair.stamp_ns, self._status.reason, TrackingStatistics(repeated=1))
        self._track.allow_unseen(pair.stamp_ns)
        self._status = Status(TrackingState.DEGRADED, StateReason.REPEATED_IMAGES)
        return self._estimate(pair.stamp_ns, TrackingStatistics(repeated=1), self._unseen_step(pair.stamp_ns))

    def _begin(self, frame: StereoFrame) -> PoseEstimate:
        """Begin a window at the last known pose; stay lost without enough landmarks."""
        track, backend = self._track, self._backend
        if (found := backend.begin(frame, track.T_world_left)) < self._config.min_tracked:
            return self._unknown(frame.stamp_ns, blindness(frame), TrackingStatistics(features=found))
        self._status = Status(TrackingState.INITIALISING if backend.keyframe_count == 1 else TrackingState.TRACKING)
        if track.unseen_s(frame.stamp_ns) > 0.0:
            self._status = Status(TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
            self._doubted_keyframes = backend.keyframe_count + self._config.window_keyframes - 1
        landmarks, position = backend.landmarks, track.T_world_left.translation
        covariance = track.covariance.after_gap(position, track.unseen(frame.stamp_ns))
        step = self._unseen_step(frame.stamp_ns)
        self._motion.restart(frame.stamp_ns)
        track.covariance.start(position, covariance, backend.covariance, landmarks.median_depth)
        track.moved(frame.stamp_ns, track.T_world_left, None)
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
        self._motion.stop()
        self._status = Status(TrackingState.LOST, reason)
        return self._estimate(stamp_ns, statistics, None)

    def _finish_keyframe(self) -> None:
        """Wait for the keyframe in work, and go on from its adjusted pose; leave a window that is not plausible."""
        if (seconds := self._backend.wait()) is None:
            return
        self._timer.seconds["keyframe"] = seconds
        pose, covariance, track = self._backend.pose, self._backend.covariance, self._track
        if not are_finite(*pose, covariance) or not track.plausible(track.known_ns or 0, now := Transform(*pose)):
            self._backend.reset()
            return
        track.T_world_left = now
        track.covariance.set_in_window(covariance)
        self._relocaliser.update(self._backend.landmarks)

    def _estimate(self, stamp_ns: int, statistics: TrackingStatistics, step: StepEstimate | None) -> PoseEstimate:
        track, status = self._track, self._status
        if track.bind(stamp_ns):
            self._backend.leave_window()
        covariance = lost_covariance()
        if status.state is not TrackingState.LOST:
            covariance = track.covariance_of_rb(self._backend.landmarks.median_depth, self._backend.calibration)
        stages = self._timer.seconds
        return PoseEstimate(stamp_ns, track.T_ds_rb, covariance, status.state, statistics, stages, status.reason, step)


def _check_size(pair: StereoPair, rig: StereoRig) -> None:
    if pair.left.shape != (rig.height, rig.width):
        found = f"{pair.left.shape[1]} x {pair.left.shape[0]}"
        needed = f"{rig.width} x {rig.height}"
        raise LocalisationError(f"pair {pair.stamp_ns} is {found}, the rig is {needed}: give images of the rig")


def _statistics(
    result: TrackingResult, backend: KeyframeBackend, keyframes: int, masked_share: float
) -> TrackingStatistics:
    offset = backend.calibration.offset
    return TrackingStatistics(
        features=len(result.landmarks),
        inliers=result.inlier_count,
        keyframes=keyframes,
        chi_median=result.chi_median,
        residual_px=result.residual_px,
        vertical_offset_px=offset.v,
        disparity_offset_px=-offset.u,
        roll_offset_px=offset.roll,
        masked_share=masked_share,
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
    # what the small rig has no use for: a body at rest in the image, landmarks of large images
    image, at = np.zeros((SIDE, SIDE), np.float32), np.zeros((1, 2))
    stays(image, np.zeros((1, SIDE * SIDE), np.float32), at)
    refine_slopes(image, np.zeros((1, 3, SIDE * SIDE), np.float32), at, at)
    localiser.set_pose(Transform.identity())  # waits for the last keyframe

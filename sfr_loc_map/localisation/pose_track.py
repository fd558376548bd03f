"""The poses so far, how well they are known, where the left camera may be next, and the world's place in DS.

The covariance of a pose is that since the start: drift of the window, start, calibration, and errors that all landmarks
share. Two poses share most of it, and it shrinks when the right camera's yaw is learnt, so it does not tell how well
the motion between them is known. That is made of steps:

- drift, independent from step to step: the covariance of the newest keyframe given the one before, of their joint
  adjustment, in proportion to the size of the step and to the variance factor: the residuals found, over those stated
  (the variance factor of least squares, as in Foerstner and Wrobel, Photogrammetric Computer Vision, chapter 4);
- a common error of all disparities, alike in all steps: it scales each by `depth / (fx baseline)`, and adds up with
  its sign; one that differs over the image turns the path and bends it aside;
- what no image showed: it is in the step to a pose that was kept or may be late, and in the step from it.

Positions are `(3,)`, metres, in the world, depths the median ones of the landmarks. A covariance `(6, 6)` is of
position and rotation about fixed axes, of the left camera in the world if not said otherwise.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, interpolated, propagated_covariance
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import SlidingWindow
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.estimate import StartPose, StepEstimate
from sfr_loc_map.localisation.frontend.tracking import TrackingResult
from sfr_loc_map.localisation.keyframe_backend import KEYFRAME_FLOW

HISTORY_PAIRS: Final = 1000  #: Pairs back to which a pose from outside can be bound.
MAX_AHEAD_NS: Final = 10 * NS_PER_S
"""A pose with a stamp farther ahead of the pairs is of another clock: it is taken for the next pair."""
MAX_START_AHEAD_NS: Final = 600 * NS_PER_S  #: Of the pose that a run starts with: a truth may begin later than images.
MAX_MISSED_PAIRS: Final = 4  #: Missing pairs over which a constant velocity is still extrapolated.
CLIMB_SHARE: Final = 0.3  #: Vertical against horizontal speed of an unseen motion.
TILT_SHARE: Final = 0.2  #: Rates of roll and pitch against that of the heading.
MAX_ANGLE: Final = np.pi / np.sqrt(3.0)  #: Standard deviation, radians, of a heading of which nothing is known.
SLACK_M: Final = 1.0
SLACK_RAD: Final = 1.0  #: Motion that is never implausible, whatever the stamps say.

COMMON_PX: Final = 0.03
"""Standard deviation of the error of a whole image (blur, jitter), pixels: it is unobservable."""
COMMON_DISPARITY_PX: Final = 0.01
"""Standard deviation of the error that all disparities share, pixels: it scales the path."""
SHAPE_PX: Final = 0.0007
"""Standard deviation of the disparity error that differs over the image (lens, matching) of a rig whose residuals show
none, pixels, alike in all steps: landmarks too near on one side and too far on the other turn each step by
`metres / (fx baseline)` a pixel."""
SHAPE_SHARE: Final = 0.17  #: The same as a share of what the residuals show.
INFLATION: Final = 2.0  #: Factor on the covariance of an adjustment: errors of neighbouring landmarks are correlated.
DRIFT_SHARE: Final = 0.1
"""Standard deviation of the attitude that a drift of the right camera leaves, as a share of the drift followed."""
ATTITUDE_SHARE: Final = 0.25
"""Standard deviation of the attitude that a yaw of the right camera bends before it is found, as a share of the yaw."""
UNSETTLED_SHARE: Final = 0.5
"""Standard deviation of a yaw of the right camera, as a share of what is left to correct: it is found smaller than it
is as long as the path is bent by it."""
KEYFRAME_PX: Final = 0.01
"""Standard deviation of the position error of a keyframe that its landmarks share, pixels at their median depth."""
MIN_SHARE: Final = 0.02
"""Share of a keyframe's drift that the smallest step has: no pose is exactly that of the one before."""
MIN_SIZE_SHARE: Final = 0.25  #: Smallest size of a keyframe interval, in intervals as the flow triggers them.
EXPECTED_CHI_MEDIAN: Final = 0.839
"""Median of chi-square with four degrees of freedom, divided by them: of a landmark whose variances are as stated."""
FACTOR_SHARE: Final = 0.1
"""Share of a pair in the variance factor: it follows the light and the ground within some ten pairs."""
MIN_FACTOR: Final = 0.2  #: Smallest variance factor: below it errors dominate that a residual does not show.
STEP_INFLATION: Final = 1.5
"""Factor on `INFLATION` where the variance factor is known: what neighbours have alike is in no residual."""
WHITE_SHARE: Final = 0.5
"""Share of the covariance of a pose given its landmarks that is independent from pair to pair: the noise of the images.
The rest is the error of the landmarks, which neighbouring pairs share."""
WHITE_RAD: Final = 1e-5
"""Standard deviation of the attitude of a whole image, independent from pair to pair: that of its mean exposure is not
that of its stamp. No residual shows it. With vibration and an exposure of 30 ms it is four times as large."""
FIRST_VARIANCE: Final = 1e-12  #: Keeps each covariance of a step positive definite (m^2, rad^2).
NOTHING: Final = np.zeros((6, 6))


class Known(NamedTuple):
    """A position `(3,)`, metres, in some frame, and the covariance `(6, 6)` of the pose there about its fixed axes."""

    position: FloatArray
    covariance: FloatArray


class TrackedPose(NamedTuple):
    """A pose of the past, and what its covariance was made of, so that a later one can be taken relative to it."""

    stamp_ns: int
    T_world_left: Transform
    follows: bool  #: Whether the pair before was tracked.
    window: int  #: Number of its window.
    in_window: Known  #: The pose in its window.
    per_disparity_bias: FloatArray  #: `(3,)` path integral of position over disparity error up to it.
    corrected_bias: FloatArray  #: `(3,)` the part of it that was corrected.
    doubt: FloatArray  #: `(2,)` metres and radians by which motions up to it may have been other ones.


class PoseTrack:
    """The poses so far, their uncertainty, and the world's place in DS.

    The path integral of position over disparity error tells how far a constant error of all disparities has moved the
    pose: a disparity error of 1 px scales a step by `depth / (fx baseline)`.

    Attributes:
        T_ds_world: Takes points in the world to DS.
        T_world_left: Left camera at the last stamp at which it is known.
        T_left_rb: Takes points in RB to the left camera.
        known_ns: That stamp; None before the first pair.
        before_first_pair: Whether no pair has arrived yet.
        pending: A pose from outside that has not got its place yet.
    """

    def __init__(self, rig: StereoRig, bounds: MotionBounds, start: StartPose) -> None:
        """Start at a pose; raises GeometryError if the extrinsics of the rig are unknown."""
        self._T_rb_left, self.T_left_rb, self._bounds = rig.T_rb_left, rig.T_rb_left.inverse(), bounds
        self._fx, self._per_px = rig.fx, rig.fx * rig.baseline_m
        self._interval = KEYFRAME_FLOW * rig.width / rig.fx
        """Size of the motion between two keyframes, radians of optical flow."""
        self._history: deque[TrackedPose] = deque(maxlen=HISTORY_PAIRS)
        self.pending: StartPose | None = None
        self.before_first_pair = True
        self.known_ns: int | None = None
        self.T_world_left = self._T_before_last = Transform.identity()
        self._tracked_ns, self._period_ns = 0, 0
        # the last pose that was given out, what no image showed of the motion to it, in RB, and the variance factor
        self._given_out: tuple[int, Transform] | None = None
        self._unseen_to_given = self._noise = NOTHING
        self._variance_factor: float | None = None
        self._window, self._doubt = 0, np.zeros(2)
        self._bias = self._corrected_bias = np.zeros(3)
        self._doubted = Known(np.zeros(3), NOTHING)
        self._reference: Known | None = None
        self._place(start, start.stamp_ns)

    # ---- poses from images

    def guesses(self, stamp_ns: int, T_rb_motion: Transform | None) -> list[Pose]:
        """Return initial guesses: constant velocity, standstill, missed pairs, wheel odometry.

        The last is a motion of RB since the last pair, `T_before_now`, by another source.
        """
        last, step = self.T_world_left, self._T_before_last
        guesses = [last @ step, last]
        missed = round((stamp_ns - self._tracked_ns) / self._period_ns) - 1 if self._period_ns > 0 else 0
        if 0 < missed <= MAX_MISSED_PAIRS:
            further = guesses[0]
            for _ in range(missed):
                further = further @ step
            guesses.append(further)
        if T_rb_motion is not None:
            guesses.append(last @ self.T_left_rb @ T_rb_motion @ self._T_rb_left)
        return [Pose(guess.rotation, guess.translation) for guess in guesses]

    def moved(
        self,
        stamp_ns: int,
        result: TrackingResult,
        window: SlidingWindow,
        depth_m: float,
        calibration: OnlineCalibration,
        chi_median: float,
        *,
        follows: bool,
        late: bool = False,
        shear: float = 0.0,
        doubt: tuple[float, float] | None = None,
    ) -> StepEstimate | None:
        """Take a pose that was tracked; return the step to it, None if no rover moves like that since the last one.

        Args:
            stamp_ns: Stamp of the pair.
            result: Its tracking.
            window: Window that it was tracked in.
            depth_m: Median depth of the landmarks of the window.
            calibration: Rotation error of the right camera.
            chi_median: Median of the squared Mahalanobis residuals per degree of freedom; NaN without any.
            follows: Whether the pair before was tracked, too.
            late: Whether the pair may not show all of the motion.
            shear: Squared shear of the rows over its variance, which counts as noise of the pose.
            doubt: Metres and radians by which it may be another one, always the same way, if that is more than it is.
        """
        now, last = Transform(*result.pose), self.T_world_left
        seconds = abs(stamp_ns - (self.known_ns or 0)) / NS_PER_S
        motion = last.inverse() @ now
        metres, angle = np.linalg.norm(motion.translation), np.linalg.norm(rotvec_from_matrix(motion.rotation))
        most_m, most_rad = self._bounds.max_speed_m_s * seconds, self._bounds.max_turn_rad_s * seconds
        if not (metres <= SLACK_M + most_m and angle <= SLACK_RAD + most_rad):
            return None
        # what bends the path does so always the same way
        turn_per_m = np.hypot(SHAPE_PX, SHAPE_SHARE * calibration.lens_px) / self._per_px
        self._add_doubt(now.translation, (0.0, turn_per_m * float(metres)))
        if doubt is not None:  # at least what no image shows
            allowed = np.sqrt(self._unseen_in(seconds).diagonal())
            doubt = max(doubt[0], metres, allowed[0]), max(doubt[1], angle, allowed[5])
            self._add_doubt(now.translation, doubt)
        # the path, and what the covariance of the pose is made of; the step was corrected by an offset, pixels
        per_bias = (now.translation - last.translation) * depth_m / self._per_px
        self._bias = self._bias + per_bias
        self._corrected_bias = self._corrected_bias + per_bias * calibration.constant_u
        of_pose = np.asarray(np.linalg.inv(result.information))
        self._in_window, self._unseen, unseen = of_pose + window.covariance, NOTHING, NOTHING
        if late:
            unseen = self._allow_unseen(stamp_ns)
        if doubt is not None:
            unseen = unseen + covariance_of_doubt(doubt)
        # the variance factor, from the residuals of this pair and of those before it
        found, factor = chi_median / EXPECTED_CHI_MEDIAN, self._variance_factor
        if np.isfinite(found):
            self._variance_factor = factor = found if factor is None else factor + FACTOR_SHARE * (found - factor)
        stated = 1.0 if factor is None else STEP_INFLATION * max(factor, MIN_FACTOR)
        # drift of the left camera since the pose given out before, in the world
        before_ns, before = (stamp_ns, now) if self._given_out is None else self._given_out
        from_before, depth_m = before.inverse(), result.landmarks.median_depth
        of_left, drift = from_before @ now, window.drift
        size = np.linalg.norm(of_left.translation) / depth_m + np.linalg.norm(rotvec_from_matrix(of_left.rotation))
        if drift is None:  # the pose given the landmarks stands for the drift of the first keyframe
            covariance, interval = of_pose, self._interval
        else:
            covariance = drift.covariance
            interval = max(drift.metres / depth_m + drift.radians, MIN_SIZE_SHARE * self._interval)
        common = np.zeros(6)
        common[:3] = (KEYFRAME_PX * depth_m / self._fx) ** 2
        share = max(float(size) / interval, MIN_SHARE)
        covariance = stated * np.asarray(share * (INFLATION * covariance + np.diag(common)))
        # the same of RB, in RB before
        T_rb_left = self._T_rb_left
        of_rb = T_rb_left @ from_before @ now @ self.T_left_rb
        to_rb = T_rb_left.rotation @ before.rotation.T
        covariance = propagated_covariance(covariance, -of_rb.rotation @ T_rb_left.translation, to_rb)
        covariance = 0.5 * (covariance + covariance.T) + FIRST_VARIANCE * np.eye(6) + self._unseen_to_given + unseen
        # white noise of this pose, in RB
        white = WHITE_SHARE * (1.0 if factor is None else max(factor, MIN_FACTOR)) * max(shear, 1.0) * of_pose
        white = propagated_covariance(white, -T_rb_left.translation, T_rb_left.rotation @ now.rotation.T)
        white[3:, 3:] += WHITE_RAD**2 * np.eye(3)
        noise_before, self._noise = self._noise, 0.5 * (white + white.T)
        # one standard deviation of what the common error of all disparities adds
        sigma_px = np.sqrt(COMMON_DISPARITY_PX**2 + calibration.sigma_u**2 + calibration.remaining_u**2)
        systematic = sigma_px * depth_m / self._per_px * (now.translation - before.translation)
        self._given_out, self._unseen_to_given = (stamp_ns, now), unseen
        if follows:
            self._speed = (float(metres) / seconds, float(angle) / seconds) if seconds > 0.0 else (0.0, 0.0)
        self.T_world_left, self.known_ns, self._T_before_last = now, stamp_ns, motion
        self._tracked_ns, self._period_ns = stamp_ns, stamp_ns - self._tracked_ns
        of_window = Known(now.translation, self._in_window)
        self._history.append(
            TrackedPose(stamp_ns, now, follows, self._window, of_window, self._bias, self._corrected_bias, self._doubt)
        )
        vector = np.concatenate((of_rb.translation, rotvec_from_matrix(of_rb.rotation)))
        turned = turn_per_m * np.copysign(np.linalg.norm(of_left.translation), vector[0])
        systematic = np.concatenate((to_rb @ systematic, np.full(3, turned)))
        seconds = (stamp_ns - before_ns) / NS_PER_S
        unsteady = NOTHING if follows else self._unseen_in(seconds)
        return StepEstimate(seconds, vector, covariance, systematic, self._noise, noise_before, unsteady)

    def adjusted(self, pose: Pose, covariance: FloatArray, corrected: bool) -> bool:
        """Go on from the adjusted pose of the last pair and its covariance `(6, 6)`; tell whether it is plausible.

        Where it was corrected for an error of the right camera, the step that follows is as uncertain as that is far.
        """
        if not (np.isfinite(np.column_stack(pose)).all() and np.isfinite(covariance).all()):
            return False
        T_world_left = Transform(*pose)
        motion = self.T_world_left.inverse() @ T_world_left
        metres, angle = np.linalg.norm(motion.translation), np.linalg.norm(rotvec_from_matrix(motion.rotation))
        if not (metres <= SLACK_M and angle <= SLACK_RAD):
            return False
        self.T_world_left, self._in_window, self._unseen = T_world_left, covariance, NOTHING
        if corrected:
            self._unseen_to_given = self._unseen_to_given + covariance_of_doubt((float(metres), float(angle)))
        return True

    def begin(self, stamp_ns: int, in_window: FloatArray, depth_m: float) -> StepEstimate:
        """Take the last pose for that of a pair with which a window begins, at rest; return the step to it.

        The period is unknown. The covariance `(6, 6)` of the pose in the window is given. The first image has the error
        of any whole image.
        """
        position, angle = self.T_world_left.translation, COMMON_PX / self._fx
        to_world = self.T_world_left.rotation @ self._T_rb_left.rotation.T
        unseen = self._of_left(self._unseen_in(self.unseen_s(stamp_ns)), to_world)
        known = self.covariance_of_left(depth_m, None) + unseen
        step = self._step_to_kept(stamp_ns)
        self._start = Known(position, known + covariance_of_doubt((angle * depth_m, angle)))
        self._reference, self._in_window, self._unseen = None, in_window, NOTHING
        self._window += 1
        self.stop()
        self.known_ns = self._tracked_ns = stamp_ns
        self._period_ns = 0
        bias, corrected = self._bias, self._corrected_bias
        of_pose = Known(position, in_window)
        self._history.append(
            TrackedPose(stamp_ns, self.T_world_left, False, self._window, of_pose, bias, corrected, self._doubt)
        )
        return step

    def kept(self, stamp_ns: int) -> StepEstimate:
        """Keep the last pose up to a stamp, and allow for a motion that no image may show; return the step to it."""
        self._allow_unseen(stamp_ns)
        return self._step_to_kept(stamp_ns)

    def stop(self) -> None:
        """Assume rest, as after lost tracking."""
        self._T_before_last = Transform.identity()

    # ---- what is known of them

    def covariance_of_left(self, depth_m: float, calibration: OnlineCalibration | None) -> FloatArray:
        """Return the covariance `(6, 6)` of the left camera in the world.

        Without a calibration it is that of the drift since the window's start, or a pose given, and of that pose. A
        rotation error of the start swings the path.
        """
        position, drift, start = self.T_world_left.translation, self._in_window, self._start
        if self._reference is not None:
            before = self._reference
            growth = drift - propagated_covariance(before.covariance, position - before.position)
            values, vectors = np.linalg.eigh(0.5 * (growth + growth.T))
            drift = (vectors * np.maximum(values, 0.0)) @ vectors.T
        covariance = drift * INFLATION + propagated_covariance(start.covariance, position - start.position)
        if calibration is None:
            return np.asarray(covariance)
        doubted = self._doubted
        covariance = covariance + propagated_covariance(doubted.covariance, position - doubted.position)
        angle = COMMON_PX / self._fx  # the error of a whole image
        covariance = covariance + np.diag(np.repeat(np.square([angle * depth_m, angle]), 3))
        # errors that all disparities share: a constant one, the yaw of the right camera as far as it is unknown, and
        # the path travelled before the yaw was found
        bias = self._bias - self._bias_before[0]
        uncorrected = calibration.target_u * bias - (self._corrected_bias - self._bias_before[1])
        variance = COMMON_DISPARITY_PX**2 + calibration.sigma_u**2 + (UNSETTLED_SHARE * calibration.remaining_u) ** 2
        covariance[:3, :3] += variance * np.outer(bias, bias) + np.outer(uncorrected, uncorrected)
        turned_px = ATTITUDE_SHARE * np.hypot(calibration.sigma_u, calibration.target_u)
        turned_px = np.hypot(turned_px, DRIFT_SHARE * calibration.followed_px)
        covariance[3:, 3:] += np.eye(3) * (turned_px / self._fx) ** 2
        return np.asarray(covariance + self._unseen)

    def unseen_s(self, stamp_ns: int) -> float:
        """Return how long before a stamp, seconds, the pose was known last."""
        return 0.0 if self.known_ns is None else abs(stamp_ns - self.known_ns) / NS_PER_S

    def _unseen_in(self, seconds: float) -> FloatArray:
        """Return the covariance `(6, 6)` of a motion that nothing showed for so long, in RB where it began.

        A rover may go on as fast as it did.
        """
        metres_s, radians_s = self._speed
        metres = max(self._bounds.unseen_speed_m_s, metres_s) * seconds
        heading = max(self._bounds.unseen_turn_rad_s, radians_s) * seconds
        tilt = min(TILT_SHARE * heading, MAX_ANGLE)
        return np.diag(np.square([metres, metres, CLIMB_SHARE * metres, tilt, tilt, min(heading, MAX_ANGLE)]))

    def _allow_unseen(self, stamp_ns: int) -> FloatArray:
        """Allow for the motion up to a stamp, which no image may show, until the next pose; return it of RB."""
        of_rb = self._unseen_in(self.unseen_s(stamp_ns))
        self._unseen = self._of_left(of_rb, self.T_world_left.rotation @ self._T_rb_left.rotation.T)
        return of_rb

    def _step_to_kept(self, stamp_ns: int) -> StepEstimate:
        """Return the step to a pose that stays; all that was not seen since the pose was known is in it once."""
        seconds = 0.0 if self._given_out is None else (stamp_ns - self._given_out[0]) / NS_PER_S
        before, self._unseen_to_given = self._unseen_to_given, self._unseen_in(self.unseen_s(stamp_ns))
        self._given_out = stamp_ns, self.T_world_left
        more = np.maximum(self._unseen_to_given - before, self._unseen_in(seconds)) + FIRST_VARIANCE * np.eye(6)
        return StepEstimate(seconds, np.zeros(6), more, np.zeros(6), self._noise, self._noise, NOTHING)

    def _add_doubt(self, position: FloatArray, step: tuple[float, float]) -> None:
        """Allow for a motion that may have been another one: it may err by metres and radians, always the same way."""
        before, self._doubt = self._doubt, self._doubt + step
        more = covariance_of_doubt(self._doubt) - covariance_of_doubt(before)
        swung = propagated_covariance(self._doubted.covariance, position - self._doubted.position)
        self._doubted = Known(position, swung + more)

    # ---- poses from outside

    def set_pose(self, pose: StartPose) -> None:
        """Take a pose from outside, which gets its place with the pair at or after its stamp."""
        if self.before_first_pair:
            self._place(pose, pose.stamp_ns)
        else:
            self.pending = pose

    def arrive(self, stamp_ns: int) -> None:
        """Note the first pair: a start pose without a stamp holds there, whatever that shows.

        A start pose of a later stamp is taken for one of the first pair until its own, as badly known as that makes it.
        """
        self.before_first_pair = False
        if self.known_ns is None or self.known_ns > stamp_ns + MAX_START_AHEAD_NS:
            self.known_ns = stamp_ns
        elif self.known_ns > stamp_ns:
            self.pending = self._given

    def bind(self, pose: StartPose, stamp_ns: int) -> bool:
        """Give a pending pose its place, after the pair of a stamp; tell whether nothing was seen since its own stamp.

        What was seen before is to be forgotten then.
        """
        given = pose.stamp_ns
        ahead_ns = MAX_START_AHEAD_NS if pose is self._given else MAX_AHEAD_NS
        at_ns = stamp_ns if given is None or given > stamp_ns + ahead_ns else given
        if at_ns > stamp_ns:
            return False
        self.pending = None
        if not self._history or at_ns > self._history[-1].stamp_ns:
            self._place(pose, at_ns)
            return True
        self._rebase(pose, at_ns)
        return False

    def _place(self, pose: StartPose, stamp_ns: int | None) -> None:
        """Let the last pose of the camera be this one, known at a stamp; the path so far is forgotten."""
        position = self.T_world_left.translation
        self._given = pose
        self.T_ds_world = pose.T_ds_rb @ self._T_rb_left @ self.T_world_left.inverse()
        self.known_ns, self._speed = stamp_ns, (0.0, 0.0)
        self._history.clear()
        self._start = Known(position, self._of_left(pose.covariance, self.T_ds_world.rotation.T))
        self._reference = None
        self._doubt, self._doubted = np.zeros(2), Known(position, NOTHING)
        self._in_window = self._unseen = NOTHING
        self._bias_before = self._bias, self._corrected_bias

    def _rebase(self, pose: StartPose, at_ns: int) -> None:
        """Let the camera have been at this pose at a stamp of the past, and count from there."""
        past, apart_s = self._past(at_ns)
        self.T_ds_world = pose.T_ds_rb @ self._T_rb_left @ past.T_world_left.inverse()
        unseen = propagated_covariance(self._unseen_in(apart_s), np.zeros(3), pose.T_ds_rb.rotation)
        unseen = 0.5 * (unseen + unseen.T)
        covariance = self._of_left(pose.covariance + unseen, self.T_ds_world.rotation.T, past.T_world_left)
        self._bias_before = past.per_disparity_bias, past.corrected_bias
        self._doubt, at = self._doubt - past.doubt, past.in_window.position
        self._doubted = Known(at, covariance_of_doubt(self._doubt))
        if past.window == self._window:
            self._start, self._reference = Known(at, covariance), past.in_window
            return
        position, known = self._start  # what was not seen between the windows is in the present start
        self._start = Known(position, known + propagated_covariance(covariance, position - at))
        self._reference = None

    def _past(self, stamp_ns: int) -> tuple[TrackedPose, float]:
        """Return the pose of a stamp that is not after the last one, and how far from it, seconds, it is known."""
        stamps = [pose.stamp_ns for pose in self._history]
        after = bisect_left(stamps, stamp_ns)
        later = self._history[after]
        if later.stamp_ns == stamp_ns:
            return later, 0.0
        if after == 0:
            return later, (later.stamp_ns - stamp_ns) / NS_PER_S
        earlier = self._history[after - 1]
        if later.follows:
            share = (stamp_ns - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
            between = interpolated(earlier.T_world_left, later.T_world_left, share)
            return later._replace(stamp_ns=stamp_ns, T_world_left=between), 0.0
        nearest = min(earlier, later, key=lambda pose: abs(pose.stamp_ns - stamp_ns))
        return nearest, abs(nearest.stamp_ns - stamp_ns) / NS_PER_S

    def _of_left(self, covariance: FloatArray, rotation: FloatArray, at: Transform | None = None) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB; rotation takes its axes there."""
        R_world_left = (at or self.T_world_left).rotation
        lever = R_world_left @ self._T_rb_left.rotation.T @ self._T_rb_left.translation
        of_left = propagated_covariance(covariance, lever, rotation)
        return np.asarray(0.5 * (of_left + of_left.T))


def covariance_of_doubt(doubt: tuple[float, float] | FloatArray) -> FloatArray:
    """Return the covariance `(6, 6)` of errors of so many metres and radians."""
    return np.diag(np.repeat(np.square(doubt), 3))

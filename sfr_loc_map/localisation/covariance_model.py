"""How well the rover's pose is known, and how well the motion between two poses.

The covariance of a pose is that since the start: drift of the window, start, calibration, and errors that all landmarks
share. Two poses share most of it, and it shrinks when the right camera's yaw is learnt, so it does not tell how well
the motion between them is known. That is made of steps:

- drift, independent from step to step: the covariance of the newest keyframe given the one before, of their joint
  adjustment, in proportion to the size of the step and to the variance factor: the residuals found, over those stated
  (the variance factor of least squares, as in Foerstner and Wrobel, Photogrammetric Computer Vision, chapter 4);
- a common error of all disparities, alike in all steps: it scales each by `depth / (fx baseline)`, and adds up with
  its sign;
- what no image showed: it is in the step to a pose that was kept or may be late, and in the step from it.

Positions are `(3,)`, metres, in the world, depths the median ones of the landmarks. A covariance `(6, 6)` is of
position and rotation about fixed axes, of the left camera in the world if not said otherwise.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix, skew
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import KeyframeDrift
from sfr_loc_map.localisation.estimate import StepEstimate
from sfr_loc_map.localisation.frontend.tracking import TrackingResult
from sfr_loc_map.localisation.keyframe_backend import KEYFRAME_FLOW

COMMON_PX: Final = 0.03
"""Standard deviation of the error of a whole image (blur, jitter), pixels: it is unobservable."""
COMMON_DISPARITY_PX: Final = 0.01
"""Standard deviation of the error that all disparities share, pixels: it scales the path."""
INFLATION: Final = 2.0
"""Factor on the covariance of an adjustment: errors of neighbouring landmarks are correlated."""
DRIFT_SHARE: Final = 0.1
"""Standard deviation of the attitude that a drift of the right camera leaves, as a share of the drift followed."""
KEYFRAME_PX: Final = 0.01
"""Standard deviation of the position error of a keyframe that its landmarks share, pixels at their median depth."""
MIN_SHARE: Final = 0.02
"""Share of a keyframe's drift that the smallest step has: no pose is exactly that of the one before."""
MIN_SIZE_SHARE: Final = 0.25
"""Smallest size of a keyframe interval, in intervals as the flow triggers them."""
EXPECTED_CHI_MEDIAN: Final = 0.839
"""Median of chi-square with four degrees of freedom, divided by them: of a landmark whose variances are as stated."""
FACTOR_SHARE: Final = 0.1
"""Share of a pair in the variance factor: it follows the light and the ground within some ten pairs."""
MIN_FACTOR: Final = 0.2
"""Smallest variance factor: below it errors dominate that a residual does not show."""
STEP_INFLATION: Final = 1.5
"""Factor on `INFLATION` where the variance factor is known: what neighbours have alike is in no residual."""
FIRST_VARIANCE: Final = 1e-12
"""Keeps each covariance of a step positive definite (m^2, rad^2)."""
NOTHING: Final = np.zeros((6, 6))


class Start(NamedTuple):
    """A position `(3,)`, metres, in some frame, and the covariance `(6, 6)` of the pose there about its fixed axes."""

    position: FloatArray
    covariance: FloatArray


class CovarianceMark(NamedTuple):
    """What the covariance of one pose was made of, so that a later one can be taken relative to it."""

    window: int  #: Number of its window.
    position: FloatArray  #: `(3,)` of the pose, metres, world.
    in_window: FloatArray  #: `(6, 6)` of it in its window.
    per_disparity_bias: FloatArray  #: `(3,)` path integral of position over disparity error up to it.
    corrected_bias: FloatArray  #: `(3,)` the part of it that was corrected.
    doubt: FloatArray  #: `(2,)` metres and radians by which motions up to it may have been other ones.


class CovarianceModel:
    """Adds to the covariance of a pose in its window what the window does not contain.

    The path integral of position over disparity error tells how far a constant error of all disparities has moved the
    pose: a disparity error of 1 px scales a step by `depth / (fx baseline)`.

    Attributes:
        unseen: `(6, 6)` of a motion that no image shows, until the window gives a pose again.
    """

    def __init__(self, rig: StereoRig) -> None:
        """Start without a path."""
        self._focal_px, self._baseline_m = rig.fx, rig.baseline_m
        self._in_window = self.unseen = NOTHING
        self._start = Start(np.zeros(3), NOTHING)
        self._reference: Start | None = None
        self._window = 0
        self._doubt, self._doubted = np.zeros(2), self._start
        self._bias, self._corrected_bias = np.zeros(3), np.zeros(3)
        self._bias_before = np.zeros(3), np.zeros(3)

    def start(
        self, position: FloatArray, covariance: FloatArray, in_window: FloatArray, depth_m: float
    ) -> CovarianceMark:
        """Begin a window at a pose with a covariance; return what that of its first pose is made of.

        The first image has the error of any whole image.
        """
        angle = COMMON_PX / self._focal_px
        self._start = Start(position, covariance + covariance_of_doubt((angle * depth_m, angle)))
        self._reference = None
        self._window += 1
        return self.follow(position, np.zeros(3), in_window, depth_m, 0.0)

    def restart(self, position: FloatArray, covariance: FloatArray) -> None:
        """Forget the path: the covariance `(6, 6)` at the last known position `(3,)` is given."""
        self._start, self._reference = Start(position, covariance), None
        self._doubt, self._doubted = np.zeros(2), Start(position, NOTHING)
        self.set_in_window(NOTHING)
        self._bias_before = self._bias, self._corrected_bias

    def rebase(self, mark: CovarianceMark, covariance: FloatArray) -> None:
        """Count from a pose of the past, whose covariance `(6, 6)` is given."""
        self._bias_before = mark.per_disparity_bias, mark.corrected_bias
        self._doubt = self._doubt - mark.doubt
        self._doubted = Start(mark.position, covariance_of_doubt(self._doubt))
        if mark.window == self._window:
            self._start, self._reference = Start(mark.position, covariance), Start(mark.position, mark.in_window)
            return
        position, known = self._start  # what was not seen between the windows is in the present start
        self._start = Start(position, known + propagated_covariance(covariance, position - mark.position))
        self._reference = None

    def doubt(self, position: FloatArray, step: tuple[float, float]) -> None:
        """Allow for a motion that may have been another one: it may err by metres and radians, always the same way."""
        before, self._doubt = self._doubt, self._doubt + step
        more = covariance_of_doubt(self._doubt) - covariance_of_doubt(before)
        swung = propagated_covariance(self._doubted.covariance, position - self._doubted.position)
        self._doubted = Start(position, swung + more)

    def follow(
        self, position: FloatArray, step: FloatArray, in_window: FloatArray, depth_m: float, right_offset_u: float
    ) -> CovarianceMark:
        """Extend the path to a pose; return what its covariance is made of, which is `in_window` by the window alone.

        The step to it was corrected by some offset of the right image, pixels.
        """
        per_bias = step * depth_m / (self._focal_px * self._baseline_m)
        self._bias = self._bias + per_bias
        self._corrected_bias = self._corrected_bias + per_bias * right_offset_u
        self._in_window, self.unseen = in_window, NOTHING
        return CovarianceMark(self._window, position, in_window, self._bias, self._corrected_bias, self._doubt)

    def set_in_window(self, covariance: FloatArray) -> None:
        """Take the covariance `(6, 6)` of the last pose given by the window."""
        self._in_window, self.unseen = covariance, NOTHING

    def of_start_and_drift(self, position: FloatArray) -> FloatArray:
        """Return the covariance `(6, 6)` of the drift since the window's start or a pose given, and of that pose.

        A rotation error of the start swings the path.
        """
        drift, start = self._in_window, self._start
        if self._reference is not None:
            before = self._reference
            growth = drift - propagated_covariance(before.covariance, position - before.position)
            values, vectors = np.linalg.eigh(0.5 * (growth + growth.T))
            drift = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return np.asarray(drift * INFLATION + propagated_covariance(start.covariance, position - start.position))

    def of_left(self, position: FloatArray, depth_m: float, calibration: OnlineCalibration) -> FloatArray:
        """Return the covariance `(6, 6)` of the left camera in the world."""
        covariance = self.of_start_and_drift(position)
        if self._doubt.any():
            doubted = self._doubted
            covariance = covariance + propagated_covariance(doubted.covariance, position - doubted.position)
        angle = COMMON_PX / self._focal_px  # the error of a whole image
        covariance = covariance + np.diag(np.repeat(np.square([angle * depth_m, angle]), 3))
        # errors that all disparities share: a constant one, the yaw of the right camera as far as it is unknown, and
        # the path travelled before the yaw was found
        bias = self._bias - self._bias_before[0]
        uncorrected = calibration.target_u * bias - (self._corrected_bias - self._bias_before[1])
        variance = COMMON_DISPARITY_PX**2 + calibration.sigma_u**2
        covariance[:3, :3] += variance * np.outer(bias, bias) + np.outer(uncorrected, uncorrected)
        covariance[3:, 3:] += np.eye(3) * (DRIFT_SHARE * calibration.followed_px / self._focal_px) ** 2
        return np.asarray(covariance + self.unseen)


class StepModel:
    """Follows the poses that are given out, and gives the step to each its covariance."""

    def __init__(self, rig: StereoRig) -> None:
        """Start without a pose.

        Raises:
            GeometryError: If the extrinsics of the rig are unknown.
        """
        self._fx, self._per_px = rig.fx, rig.fx * rig.baseline_m
        self._T_rb_left, self._T_left_rb = rig.T_rb_left, rig.T_rb_left.inverse()
        self._interval = KEYFRAME_FLOW * rig.width / rig.fx
        """Size of the motion between two keyframes, radians of optical flow."""
        self._before: tuple[int, Transform] | None = None
        self._unseen = NOTHING
        self._variance_factor: float | None = None

    def unseen(self, stamp_ns: int, T_world_left: Transform, covariance: FloatArray) -> StepEstimate:
        """Return the step to a pose that stays; the covariance is of all motion since it was known, in RB."""
        seconds = 0.0 if self._before is None else (stamp_ns - self._before[0]) / NS_PER_S
        self._before, before = (stamp_ns, T_world_left), self._unseen
        self._unseen = covariance
        more = covariance - before + FIRST_VARIANCE * np.eye(6)
        return StepEstimate(seconds, np.zeros(6), more, np.zeros(6))

    def tracked(
        self,
        stamp_ns: int,
        T_world_left: Transform,
        result: TrackingResult,
        chi_median: float,
        drift: KeyframeDrift | None,
        calibration: OnlineCalibration,
        unseen: FloatArray,
        doubt: tuple[float, float] | None = None,
    ) -> StepEstimate:
        """Return the step to a pose that was tracked.

        What the pair may not show of the motion has the covariance `unseen`, in RB. The drift of the newest keyframe is
        None in the first of a window; a doubt is metres and radians by which it may be another motion.
        """
        depth_m = result.landmarks.median_depth
        before_ns, before = (stamp_ns, T_world_left) if self._before is None else self._before
        self._before, before_unseen, self._unseen = (stamp_ns, T_world_left), self._unseen, unseen
        # the variance factor, from the residuals of this pair and of those before it
        found, factor = chi_median / EXPECTED_CHI_MEDIAN, self._variance_factor
        if np.isfinite(found):
            self._variance_factor = factor = found if factor is None else factor + FACTOR_SHARE * (found - factor)
        stated = 1.0 if factor is None else STEP_INFLATION * max(factor, MIN_FACTOR)
        # drift of the left camera, in the world
        from_before = before.inverse()
        of_left = from_before @ T_world_left
        metres, radians = np.linalg.norm(of_left.translation), np.linalg.norm(rotvec_from_matrix(of_left.rotation))
        if drift is None:  # the pose given the landmarks stands for the drift of the first keyframe
            covariance, interval = np.asarray(np.linalg.inv(result.information)), self._interval
        else:
            size = drift.metres / depth_m + drift.radians
            covariance, interval = drift.covariance, max(size, MIN_SIZE_SHARE * self._interval)
        common = np.zeros(6)
        common[:3] = (KEYFRAME_PX * depth_m / self._fx) ** 2
        share = max(float(metres / depth_m + radians) / interval, MIN_SHARE)
        covariance = stated * np.asarray(share * (INFLATION * covariance + np.diag(common)))
        # the same of RB, in RB before
        T_rb_left = self._T_rb_left
        motion = T_rb_left @ from_before @ T_world_left @ self._T_left_rb
        to_rb = T_rb_left.rotation @ before.rotation.T
        lever = -motion.rotation @ T_rb_left.translation
        of_rb = covariance_of_point(covariance, to_rb, lever) + FIRST_VARIANCE * np.eye(6) + before_unseen + unseen
        if doubt is not None:
            of_rb = of_rb + covariance_of_doubt(doubt)
        # one standard deviation of what the common error of all disparities adds
        remaining = calibration.target_u - calibration.constant_u
        sigma_px = np.sqrt(COMMON_DISPARITY_PX**2 + calibration.sigma_u**2 + remaining**2)
        systematic = sigma_px * depth_m / self._per_px * (T_world_left.translation - before.translation)
        vector = np.concatenate((motion.translation, rotvec_from_matrix(motion.rotation)))
        seconds = (stamp_ns - before_ns) / NS_PER_S
        return StepEstimate(seconds, vector, of_rb, np.concatenate((to_rb @ systematic, np.zeros(3))))


def covariance_of_doubt(doubt: tuple[float, float] | FloatArray) -> FloatArray:
    """Return the covariance `(6, 6)` of errors of so many metres and radians."""
    return np.diag(np.repeat(np.square(doubt), 3))


def covariance_of_point(covariance: FloatArray, rotation: FloatArray, lever: FloatArray) -> FloatArray:
    """Return the covariance of the pose of another point of a rigid body, in other axes.

    The rotation takes components in the old axes to those in the others, in which the lever goes from the point to the
    one whose covariance is given.
    """
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = rotation
    jacobian[:3, 3:] = -skew(lever) @ rotation
    result = jacobian @ covariance @ jacobian.T
    return np.asarray(0.5 * (result + result.T))

"""How well the motion between two poses is known: from it follows the relative covariance of any two poses.

The pose covariance is that since the start, most of which two poses share, and it shrinks when the right camera's yaw
is learnt; it does not tell how well the motion between two poses is known. That is made of steps:

- drift, independent from step to step: the covariance of the newest keyframe given the one before, of their joint
  adjustment, in proportion to the size of the step and to the variance factor: the residuals found, over those stated
  (the variance factor of least squares, as in Foerstner and Wrobel, Photogrammetric Computer Vision, chapter 4);
- a common error of all disparities, alike in all steps: it scales each by `depth / (fx baseline)`, and adds up with
  its sign.
- what no image showed: it is in the step to a pose that was kept or may be late, and in the step from it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import KeyframeDrift
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.covariance_model import covariance_of_doubt, covariance_of_point
from sfr_loc_map.localisation.estimate import StepEstimate
from sfr_loc_map.localisation.frontend.tracking import TrackingResult

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
"""Factor on `inflation` where the variance factor is known: what neighbours have alike is in no residual."""
FIRST_VARIANCE: Final = 1e-12
"""Keeps each covariance of a step positive definite (m^2, rad^2)."""


class StepModel:
    """Follows the poses that are given out, and gives the step to each its covariance."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig) -> None:
        """Start without a pose.

        Raises:
            GeometryError: If the extrinsics of the rig are unknown.
        """
        self._rig, self._config = rig, config
        self._T_rb_left, self._T_left_rb = rig.T_rb_left, rig.T_rb_left.inverse()
        self._interval = config.keyframe_flow * rig.width / rig.fx
        """Size of the motion between two keyframes, radians of optical flow."""
        self._before: tuple[int, Transform] | None = None
        self._unseen = np.zeros((6, 6))
        self._variance_factor: float | None = None

    def unseen(self, stamp_ns: int, T_world_left: Transform, covariance: FloatArray) -> StepEstimate:
        """Return the step to a pose that stays because nothing is seen.

        Args:
            stamp_ns: Its stamp.
            T_world_left: Left camera.
            covariance: `(6, 6)` of all motion since the pose was known, in RB.
        """
        seconds = 0.0 if self._before is None else (stamp_ns - self._before[0]) / NS_PER_S
        self._before, before = (stamp_ns, T_world_left), self._unseen
        self._unseen = covariance
        more = covariance - before + FIRST_VARIANCE * np.eye(6)
        return StepEstimate(seconds, np.zeros(6), more, np.zeros(6))

    def tracked(
        self,
        stamp_ns: int,
        result: TrackingResult,
        drift: KeyframeDrift | None,
        calibration: OnlineCalibration,
        unseen: FloatArray,
        doubt: tuple[float, float] | None = None,
    ) -> StepEstimate:
        """Return the step to a pose that was tracked.

        Args:
            stamp_ns: Its stamp.
            result: How it was tracked.
            drift: Of the newest keyframe; None in the first of a window.
            calibration: What is known of the right camera.
            unseen: `(6, 6)` of what the pair may not show of the motion to it, in RB.
            doubt: Metres and radians by which it may be another motion; None without a doubt.
        """
        now, depth_m = result.T_world_left, result.landmarks.median_depth
        before_ns, before = (stamp_ns, now) if self._before is None else self._before
        self._before, before_unseen, self._unseen = (stamp_ns, now), self._unseen, unseen
        factor = self._follow_residuals(result.chi_median)
        from_before = before.inverse()
        covariance = factor * self._drift(from_before @ now, depth_m, drift, result)
        # the same of RB, in RB before
        T_rb_left = self._T_rb_left
        motion = T_rb_left @ from_before @ now @ self._T_left_rb
        to_rb = T_rb_left.rotation @ before.rotation.T
        lever = -motion.rotation @ T_rb_left.translation
        of_rb = covariance_of_point(covariance, to_rb, lever) + FIRST_VARIANCE * np.eye(6) + before_unseen + unseen
        if doubt is not None:
            of_rb = of_rb + covariance_of_doubt(doubt)
        systematic = to_rb @ self._systematic(now.translation - before.translation, depth_m, calibration)
        vector = np.concatenate((motion.translation, rotvec_from_matrix(motion.rotation)))
        seconds = (stamp_ns - before_ns) / NS_PER_S
        return StepEstimate(seconds, vector, of_rb, np.concatenate((systematic, np.zeros(3))))

    def _follow_residuals(self, chi_median: float) -> float:
        """Return the factor on stated variances, from the residuals of this pair and of those before it."""
        found, before = chi_median / EXPECTED_CHI_MEDIAN, self._variance_factor
        if np.isfinite(found):
            self._variance_factor = found if before is None else before + FACTOR_SHARE * (found - before)
        return 1.0 if self._variance_factor is None else STEP_INFLATION * max(self._variance_factor, MIN_FACTOR)

    def _drift(
        self, motion: Transform, depth_m: float, drift: KeyframeDrift | None, result: TrackingResult
    ) -> FloatArray:
        """Return the covariance `(6, 6)` of a motion of the left camera, in the world."""
        metres, radians = np.linalg.norm(motion.translation), np.linalg.norm(rotvec_from_matrix(motion.rotation))
        if drift is None:  # the pose given the landmarks stands for the drift of the first keyframe
            covariance, interval = np.asarray(np.linalg.inv(result.information)), self._interval
        else:
            size = drift.metres / depth_m + drift.radians
            covariance, interval = drift.covariance, max(size, MIN_SIZE_SHARE * self._interval)
        share = max(float(metres / depth_m + radians) / interval, MIN_SHARE)
        common = np.zeros(6)
        common[:3] = (KEYFRAME_PX * depth_m / self._rig.fx) ** 2
        return np.asarray(share * (self._config.inflation * covariance + np.diag(common)))

    def _systematic(self, step: FloatArray, depth_m: float, calibration: OnlineCalibration) -> FloatArray:
        """Return one standard deviation `(3,)` of what the common error of all disparities adds to a step `(3,)`."""
        remaining = calibration.target_u - calibration.constant_u
        sigma_px = np.sqrt(self._config.common_disparity_px**2 + calibration.sigma_u**2 + remaining**2)
        return np.asarray(sigma_px * depth_m / (self._rig.fx * self._rig.baseline_m) * step)

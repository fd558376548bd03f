"""The named error sources of the localiser, the constants of a run, and what unobserved motions and findings add.

The package docstring of `uncertainty` lists the formulas that use the error sources. The values in the table also enter
the covariances. They are defined in the modules that use them:

| value | module | enters |
|---|---|---|
| `PIXEL_FLOOR`, `RESIDUAL_GAIN`, `EDGE_RESIDUALS` | `frontend.noise` | noise of observations |
| `FIRST_SIGMA_PX`, `YAW_WALK_PX`, `DRIFT_ERROR_RATIO` | `backend.online_calibration` | `yaw_sigma_px` |
| `START_VARIANCE` | `backend.sliding_window` | first pose of a window, hence `keyframes` |
| `MIN_VARIANCE` | `step_covariance` | variance added to each step |
| `unseen_speed_m_s`, `unseen_turn_rad_s` | `config.MotionBounds` | unobserved motion |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, read_only
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance, symmetric
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.motion_size import MAX_ANGLE_RAD, NO_MOTION, MotionSize, Speed

ZERO = read_only(np.zeros((6, 6)))  #: Covariance `(6, 6)` without errors.


@dataclass(frozen=True, slots=True)
class ErrorSources:
    """The error sources of the localiser: standard deviations, and ratios to estimated values.

    The values were chosen by hand so that NEES per degree of freedom is near 1 on rendered drives (`make nees`). If a
    value is too large, the covariance exceeds the errors and this NEES falls below 1. If a value is too small, this
    NEES exceeds 1. NEES is one number for all values together, and therefore determines only their total. The order of
    magnitude of each value follows from the physical error that its description names.

    The words at the beginning of each description name the formulas that use the field: the covariance of a pose, parts
    of the covariance of a step (step, noise, systematic), and the unobserved motion, which enters both covariances.
    """

    blur_px: float = 0.03
    """Pose. Error of a whole image (blur, jitter), px, which is common to all landmarks and therefore unobservable."""
    exposure_rad: float = 1e-5
    """Noise. Attitude noise of a whole image, rad, because the stamp is not at mid-exposure (4e-5 with vibration)."""
    disparity_px: float = 0.01
    """Pose, systematic. Error common to all disparities, px, which scales the path."""
    lens_px: float = 0.0007
    """Pose (`correlated`), systematic. Disparity error that varies over the image and bends the path, px, if the
    residuals show no lens distortion."""
    lens_ratio: float = 0.17
    """Pose (`correlated`), systematic. Ratio of the disparity error that bends the path (as `lens_px`) to the RMS of
    the residual disparities."""
    unsettled_yaw_ratio: float = 0.5
    """Pose. Ratio of the error of the right camera's yaw to the part of this yaw that is not corrected yet."""
    bent_attitude_ratio: float = 0.25
    """Pose. Ratio of the attitude error to the right camera's yaw before its correction, because the yaw bends the
    path."""
    drift_attitude_ratio: float = 0.1
    """Pose. Ratio of the attitude error to the drift corrections of the right camera."""
    adjustment_inflation: float = 2.0
    """Pose, step. Factor on the covariance of the bundle adjustment, because errors of neighbouring landmarks are
    correlated."""
    keyframe_px: float = 0.01
    """Step. Position error of a keyframe, common to all its landmarks, px at their median depth."""
    min_step_ratio: float = 0.02
    """Step. Minimum ratio of a step to the keyframe interval, because a step at rest has an error, too."""
    min_interval_ratio: float = 0.25
    """Step. Ratio of the minimum keyframe interval to the interval that triggers a keyframe."""
    variance_gain: float = 0.1
    """Step, noise. Gain of the variance factor per pair. The factor adapts to light and ground within ten pairs."""
    min_variance_factor: float = 0.2
    """Step, noise. Minimum variance factor. Below this value, the dominant errors do not appear in residuals."""
    step_inflation: float = 1.5
    """Step. Factor on the variance of a step, in addition to the variance factor, because errors common to neighbouring
    landmarks do not appear in residuals."""
    white_ratio: float = 0.5
    """Noise. Fraction of the covariance of a pose that is independent from pair to pair (image noise)."""
    climb_ratio: float = 0.3
    """Unobserved. Ratio of vertical to horizontal speed in an unobserved motion: slopes of 17 deg."""
    tilt_ratio: float = 0.2
    """Unobserved. Ratio of roll and pitch rate to turn rate in an unobserved motion."""


@dataclass(frozen=True, slots=True, eq=False)
class RoverModel:
    """Constants of a run, which the motion model and the covariances share."""

    T_rb_left: Transform  #: Takes points in the left optical frame to RB.
    T_left_rb: Transform  #: Takes points in RB to the left optical frame.
    fx: float  #: Focal length, px.
    focal_baseline: float  #: Focal length times baseline, px m.
    keyframe_rad: float  #: Optical flow that triggers a keyframe, rad.
    bounds: MotionBounds
    sources: ErrorSources = ErrorSources()

    @classmethod
    def of(cls, rig: StereoRig, bounds: MotionBounds, keyframe_flow_ratio: float) -> RoverModel:
        """Return the model of a rig; GeometryError if the extrinsics are unknown.

        `keyframe_flow_ratio` is the optical flow that triggers a keyframe, as a fraction of the image width.
        """
        return cls(
            T_rb_left=rig.T_rb_left,
            T_left_rb=rig.T_rb_left.inverse(),
            fx=rig.fx,
            focal_baseline=rig.fx * rig.baseline_m,
            keyframe_rad=keyframe_flow_ratio * rig.width / rig.fx,
            bounds=bounds,
        )

    def blur(self, depth_m: float) -> MotionSize:
        """Return the standard deviations that an error of the whole image causes in a pose, for the median depth Z_map.

            blur = (Z_map blur_px / f, blur_px / f)

        An error of a whole image rotates all landmarks by blur_px / f. The pose is displaced by this angle times Z_map.
        """
        blur_rad = self.sources.blur_px / self.fx
        return MotionSize(blur_rad * depth_m, blur_rad)

    def lens_turn_per_m(self, calibration: OnlineCalibration) -> float:
        """Return the rotation per metre, rad/m, by which residual lens distortion bends the path.

            lens_turn = hypot(lens_px, lens_ratio RMS of the residual disparities) / (f b)

        If landmarks are too near on one side and too far on the other by 1 px of disparity, each step is turned by
        its length / (f b), rad.
        """
        lens_px = np.hypot(self.sources.lens_px, self.sources.lens_ratio * calibration.lens.rms_px)
        return float(lens_px / self.focal_baseline)

    def covariance_of_left(
        self, covariance: FloatArray, *, R_world_frame: FloatArray, R_world_left: FloatArray
    ) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB in another frame."""
        lever = R_world_left @ self.T_rb_left.rotation.T @ self.T_rb_left.translation
        return symmetric(propagated_covariance(covariance, lever, R_world_frame))

    def covariance_at(self, T_world_left: Transform, covariance: FloatArray) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB in RB, at a pose of the left camera."""
        R_world_left = T_world_left.rotation
        R_world_rb = R_world_left @ self.T_rb_left.rotation.T
        return self.covariance_of_left(covariance, R_world_frame=R_world_rb, R_world_left=R_world_left)


# ---- what an unobserved motion, and the findings of the guards, add to the covariances


def unobserved_size(speed: Speed, seconds: float, bounds: MotionBounds) -> MotionSize:
    """Return the standard deviations of length and heading of a motion that no image showed.

        metres  = seconds min(max(unseen_speed_m_s, speed), max_speed_m_s)
        radians = seconds min(max(unseen_turn_rad_s, turn rate), max_turn_rad_s)

    Speed and turn rate are those of the last motion, because the rover may have continued. They are at least the
    configured values of an unobserved motion, and at most the configured maximum values, because two pairs with nearly
    the same stamp may show any speed.
    """
    m_s = min(max(bounds.unseen_speed_m_s, speed.m_s), bounds.max_speed_m_s)
    rad_s = min(max(bounds.unseen_turn_rad_s, speed.rad_s), bounds.max_turn_rad_s)
    return MotionSize(m_s * seconds, rad_s * seconds)


def unobserved_motion(size: MotionSize, sources: ErrorSources) -> FloatArray:
    """Return the covariance `unobserved` `(6, 6)` of a motion that no image showed, in RB at its start.

        unobserved = diag(metres, metres, climb_ratio metres,
                          tilt_ratio radians, tilt_ratio radians, radians)^2

    `metres` and `radians` are the standard deviations of length and heading (`unobserved_size`). The standard deviation
    of each angle is at most `MAX_ANGLE_RAD`.
    """
    metres, radians = size
    tilt = min(sources.tilt_ratio * radians, MAX_ANGLE_RAD)
    climb = sources.climb_ratio * metres
    return np.diag(np.square([metres, metres, climb, tilt, tilt, min(radians, MAX_ANGLE_RAD)]))


def unobserved_during(speed: Speed, seconds: float, model: RoverModel) -> FloatArray:
    """Return the covariance `(6, 6)` of the motion of RB during `seconds` without images, in RB at the start."""
    return unobserved_motion(unobserved_size(speed, seconds, model.bounds), model.sources)


class AddedError(NamedTuple):
    """What findings add to the covariance of a pose, and of the steps to and from this pose."""

    #: `(6, 6)` covariance of the motion since the last pose, treated as unobserved, in RB at that pose; zero if no
    #: finding requires this covariance.
    unobserved_rb: FloatArray
    ambiguity: MotionSize  #: Error if another motion is the true motion. Zero if no finding requires this error.

    @property
    def of_step(self) -> FloatArray:
        """Covariance `(6, 6)` added to a step."""
        return self.unobserved_rb + self.ambiguity.covariance


def inflation_of(
    inflation: Inflation,
    *,
    unobserved: MotionSize,
    moved: MotionSize,
    other_distance: MotionSize,
    sources: ErrorSources,
) -> AddedError:
    """Return what findings add to covariances, by the kinds of inflation that they require (`findings.RULES`).

        ambiguity = max(other_distance, moved, unobserved), for the length and for the angle

    The true motion may be the other motion, a standstill, or a motion that was not found.

    Args:
        inflation: Kinds of inflation that the findings of the pair require.
        unobserved: Size of an unobserved motion since the last pose. The angle enters the ambiguity with at most
            `MAX_ANGLE_RAD`.
        moved: Length and angle of the estimated motion since the last pose.
        other_distance: Distance between the poses of two possible motions; zero if only one motion was found.
        sources: Error sources of an unobserved motion.
    """
    unobserved_rb = ZERO
    if Inflation.UNOBSERVED in inflation:
        unobserved_rb = unobserved_motion(unobserved, sources)
    ambiguity = NO_MOTION
    if Inflation.AMBIGUITY in inflation:
        ambiguity = MotionSize(
            max(other_distance.metres, moved.metres, unobserved.metres),
            max(other_distance.radians, moved.radians, min(unobserved.radians, MAX_ANGLE_RAD)),
        )
    return AddedError(unobserved_rb, ambiguity)

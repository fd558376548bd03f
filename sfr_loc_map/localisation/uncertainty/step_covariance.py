"""Covariance of a step, the motion of RB between two poses, in RB at the previous pose (table in `uncertainty`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import KeyframeMotion
from sfr_loc_map.localisation.motion_size import MotionSize, size_of
from sfr_loc_map.localisation.symmetric_matrices import symmetric
from sfr_loc_map.localisation.uncertainty.error_sources import ErrorSources
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel

EXPECTED_CHI_MEDIAN = 0.839
"""Median of chi-square with four degrees of freedom, divided by four, as for a landmark observed in both images. A
landmark observed in one image has two degrees of freedom, with a median of 0.693. The variance factor is therefore
slightly too small if many landmarks are observed in one image only (a quarter of them on KITTI)."""
MIN_VARIANCE = 1e-12  #: Added to the variances of a step, so that each is positive, m^2 and rad^2.


@dataclass(frozen=True, slots=True, eq=False)
class StepMotion:
    """Motion between the pose published last and the present pose."""

    of_rb: Transform  #: `T_rb_before_now`.
    vector: FloatArray  #: `(6,)` motion of RB: translation, m, and rotation vector, rad.
    displacement: FloatArray  #: `(3,)` displacement of the left camera in the world, m.
    size: MotionSize  #: Size of the motion of the left camera.
    R_rb_world: FloatArray  #: `(3, 3)` rotates vectors from the world to RB at the previous pose.

    @classmethod
    def between(cls, before: Transform, now: Transform, model: RoverModel) -> StepMotion:
        """Return the motion between two poses of the left camera in the world."""
        T_before_world = before.inverse()
        of_left = T_before_world @ now
        of_rb = model.T_rb_left @ T_before_world @ now @ model.T_left_rb
        return cls(
            of_rb=of_rb,
            vector=np.concatenate((of_rb.translation, rotvec_from_matrix(of_rb.rotation))),
            displacement=now.translation - before.translation,
            size=size_of(of_left),
            R_rb_world=model.T_rb_left.rotation @ before.rotation.T,
        )


def updated_variance_factor(before: float | None, chi_median: float, sources: ErrorSources) -> float | None:
    """Return the variance factor after a pair: the ratio of the squared residuals to their stated variance.

        variance_factor += variance_gain (chi_median / EXPECTED_CHI_MEDIAN - variance_factor)

    The first pair with residuals sets the factor. `chi_median` is per degree of freedom, and NaN without residuals.
    """
    found = chi_median / EXPECTED_CHI_MEDIAN
    if not np.isfinite(found):
        return before
    return found if before is None else before + sources.variance_gain * (found - before)


def step_covariance(
    step: StepMotion,
    keyframes: KeyframeMotion | None,
    given_keyframes: FloatArray,
    depth_m: float,
    variance_factor: float | None,
    model: RoverModel,
) -> FloatArray:
    """Return the covariance `step` `(6, 6)` without `added`, for the motion of RB, in RB at the previous pose.

        step = step_inflation max(variance_factor, min_variance_factor) step_ratio
               (adjustment_inflation between_keyframes + common)
        common = (keyframe_px Z_tracked / f)^2 diag(1, 1, 1, 0, 0, 0)
        step_ratio = max(flow of the step / max(flow of the keyframes, min_interval_ratio usual flow), min_step_ratio)
        flow = length / Z_tracked + angle, rad

    Errors from images are independent from step to step. `between_keyframes` is the covariance of the newest keyframe
    given the previous keyframe (`KeyframeMotion.covariance`), and the flow of the keyframes is that of the motion
    between these keyframes. In a window of one keyframe, `given_keyframes` and the usual flow
    (`RoverModel.keyframe_rad`) are used instead. Before the first residuals, the factor before `step_ratio` is 1. The
    covariance of the left camera is then propagated to RB, and `MIN_VARIANCE` is added to each variance.

    Args:
        step: The motion.
        keyframes: Motion between the two newest keyframes.
        given_keyframes: `(6, 6)` covariance of the pose given the keyframes, used if there is no second keyframe.
        depth_m: Median depth of the landmarks.
        variance_factor: Ratio of the squared residuals to their stated variance; None before the first residuals.
        model: Extrinsics, camera geometry and error sources.
    """
    sources = model.sources
    if keyframes is None:
        between_keyframes = given_keyframes
        keyframe_rad = model.keyframe_rad
    else:
        between_keyframes = keyframes.covariance
        min_rad = sources.min_interval_ratio * model.keyframe_rad
        keyframe_rad = max(_flow_rad(keyframes.size, depth_m), min_rad)
    step_ratio = max(_flow_rad(step.size, depth_m) / keyframe_rad, sources.min_step_ratio)
    common = np.zeros(6)
    common[:3] = (sources.keyframe_px * depth_m / model.fx) ** 2
    factor = 1.0
    if variance_factor is not None:
        factor = sources.step_inflation * max(variance_factor, sources.min_variance_factor)
    of_left = factor * (step_ratio * (sources.adjustment_inflation * between_keyframes + np.diag(common)))
    lever = -step.of_rb.rotation @ model.T_rb_left.translation
    of_rb = propagated_covariance(of_left, lever, step.R_rb_world)
    return symmetric(of_rb) + MIN_VARIANCE * np.eye(6)


def _flow_rad(size: MotionSize, depth_m: float) -> float:
    """Return the optical flow of a motion, rad, for a median depth."""
    return size.metres / depth_m + size.radians


def pose_noise(
    given_keyframes: FloatArray,
    *,
    R_world_left: FloatArray,
    variance_factor: float | None,
    shear_chi2: float,
    model: RoverModel,
) -> FloatArray:
    """Return the covariance `noise` `(6, 6)` of the white noise of a pose of RB, in RB.

        noise = white_ratio max(variance_factor, min_variance_factor) max(shear_chi2, 1) given_keyframes
                + exposure_rad^2 (attitude)

    `shear_chi2` is the squared shear of the rows of the image divided by its variance, per degree of freedom.
    """
    sources = model.sources
    factor = 1.0 if variance_factor is None else max(variance_factor, sources.min_variance_factor)
    noise = sources.white_ratio * factor * max(shear_chi2, 1.0) * given_keyframes
    T_rb_left = model.T_rb_left
    noise = propagated_covariance(noise, -T_rb_left.translation, T_rb_left.rotation @ R_world_left.T)
    noise[3:, 3:] += sources.exposure_rad**2 * np.eye(3)
    return symmetric(noise)


def systematic_step(step: StepMotion, depth_m: float, calibration: OnlineCalibration, model: RoverModel) -> FloatArray:
    """Return `systematic` `(6,)`, in RB: signed effects (one sigma) that errors common to all steps have on one step.

        systematic = (position, attitude, attitude, attitude)
        position = hypot(disparity_px, yaw_sigma_px, remaining_px) Z_tracked / (f b) displacement
        attitude = lens_turn length sign(x of the motion of RB)

    The sign makes the effects of a step forwards and of a step backwards cancel. The terms of a pose for the same
    errors differ from these formulas in two points. `correlated` sums the lengths without the sign, which is an upper
    bound. In `disparity`, the remaining yaw is multiplied by `unsettled_yaw_ratio`, because that term also contains
    `uncorrected`.
    """
    disparity_px = np.sqrt(
        model.sources.disparity_px**2 + calibration.yaw.sigma_px**2 + calibration.yaw.remaining_px**2
    )
    position = disparity_px * depth_m / model.focal_baseline * step.displacement
    attitude = model.lens_turn_per_m(calibration) * np.copysign(step.size.metres, step.vector[0])
    return np.concatenate((step.R_rb_world @ position, np.full(3, attitude)))

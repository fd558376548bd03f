"""Covariance of a step, the motion of RB between two published poses, in RB at the first of them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, diagonal_matrix, read_only
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform, propagated_covariance, symmetric
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import KeyframeMotion
from sfr_loc_map.localisation.estimate import StepEstimate
from sfr_loc_map.localisation.frontend.right_camera import RowShear
from sfr_loc_map.localisation.motion_size import MotionSize, Speed, size_of
from sfr_loc_map.localisation.uncertainty.error_sources import (
    ZERO,
    AddedError,
    ErrorSources,
    RoverModel,
    unobserved_during,
)
from sfr_loc_map.localisation.uncertainty.pose_covariance import AcceptedPair
from sfr_loc_map.message_stamps import NS_PER_S

EXPECTED_CHI_MEDIAN = 0.839
"""Median of chi-square with four degrees of freedom, divided by four, as for a landmark observed in both images. A
landmark observed in one image has two degrees of freedom, with a median of 0.693. The variance factor is therefore
slightly too small if many landmarks are observed in one image only (a quarter of them on KITTI)."""
MIN_VARIANCE = 1e-12  #: Value added to each variance of a step, m^2 and rad^2, so that each variance is positive.
MIN_COVARIANCE = read_only(MIN_VARIANCE * np.eye(6))


class StepMotion(NamedTuple):
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
    if not math.isfinite(found):
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
    common_m2 = (sources.keyframe_px * depth_m / model.fx) ** 2
    common = diagonal_matrix((common_m2, common_m2, common_m2, 0.0, 0.0, 0.0))
    factor = 1.0
    if variance_factor is not None:
        factor = sources.step_inflation * max(variance_factor, sources.min_variance_factor)
    of_left = factor * (step_ratio * (sources.adjustment_inflation * between_keyframes + common))
    lever = -step.of_rb.rotation @ model.T_rb_left.translation
    of_rb = propagated_covariance(of_left, lever, step.R_rb_world)
    return symmetric(of_rb) + MIN_COVARIANCE


def _flow_rad(size: MotionSize, depth_m: float) -> float:
    """Return the optical flow of a motion, rad, for a median depth."""
    return size.metres / depth_m + size.radians


def pose_noise(
    given_keyframes: FloatArray,
    *,
    R_world_left: FloatArray,
    variance_factor: float | None,
    shear: RowShear,
    model: RoverModel,
) -> FloatArray:
    """Return the covariance `noise` `(6, 6)` of the white noise of a pose of RB, in RB.

    noise = white_ratio max(variance_factor, min_variance_factor) given_keyframes
            + shear (`RowShear.covariance`) + exposure_rad^2 (attitude)
    """
    sources = model.sources
    factor = 1.0 if variance_factor is None else max(variance_factor, sources.min_variance_factor)
    noise = sources.white_ratio * factor * given_keyframes + shear.covariance
    T_rb_left = model.T_rb_left
    noise = propagated_covariance(noise, -T_rb_left.translation, T_rb_left.rotation @ R_world_left.T)
    exposure_rad2 = sources.exposure_rad**2
    noise[3:, 3:] += diagonal_matrix((exposure_rad2, exposure_rad2, exposure_rad2))
    return symmetric(noise)


def systematic_step(step: StepMotion, depth_m: float, calibration: OnlineCalibration, model: RoverModel) -> FloatArray:
    """Return `systematic` `(6,)`, in RB: signed effects (one sigma) that errors common to all steps have on one step.

        systematic = (position, attitude, attitude, attitude)
        position = hypot(disparity_px, yaw_sigma_px, remaining_px) Z_tracked / (f b) displacement
        attitude = lens_turn length sign(x of the motion of RB)

    The sign makes the effects of a step forwards and of a step backwards cancel. The terms of a pose for the same
    errors differ from these formulas. `correlated` sums the lengths without the sign, which is an upper bound. In
    `disparity`, the depth is that of the map, and the remaining yaw is multiplied by `unsettled_yaw_ratio`, because
    that term also contains `uncorrected`. The position of a pose has the covariance of one error along the path. The
    six components of a step are used as independent errors (`StepEstimate`), which neglects their correlation.
    """
    disparity_px = math.sqrt(
        model.sources.disparity_px**2 + calibration.yaw.sigma_px**2 + calibration.yaw.remaining_px**2
    )
    position = disparity_px * depth_m / model.focal_baseline * step.displacement
    attitude = model.lens_turn_per_m(calibration) * math.copysign(step.size.metres, step.vector[0])
    return np.concatenate((step.R_rb_world @ position, [attitude, attitude, attitude]))


class PublishedPose(NamedTuple):
    """The last published pose that was not lost, at which the next step starts."""

    stamp_ns: int | None = None  #: Stamp of the pose; None before the first pose.
    T_world_left: Transform | None = None  #: The pose as it was published; adjustments do not move it.
    #: Covariance `(6, 6)` of errors that concern this pose alone, in RB at the pose before this pose. These errors are
    #: the inflation by findings, and the displacement by a correction of the yaw. Such an error is part of the step to
    #: this pose and, with the opposite sign, of the next step. The covariance is therefore added to both steps, and the
    #: rotation of RB between the two poses is neglected.
    shared_with_next_step: FloatArray = ZERO
    #: Time for which the last known pose was kept up to this pose, s; 0 if the pair of this pose was accepted or began
    #: a window. The next step contains the unobserved motion during this time.
    kept_s: float = 0.0
    noise: FloatArray = ZERO  #: White noise `(6, 6)` of this pose, in RB at this pose.
    variance_factor: float | None = None  #: Variance factor (`step_covariance`); None before the first residuals.

    @property
    def is_kept(self) -> bool:
        """Whether the pose was kept for some time, so that the motion up to its stamp is unobserved."""
        return self.kept_s > 0.0

    def seconds_until(self, stamp_ns: int) -> float:
        """Return the time from this pose to a stamp, s; 0 before the first pose."""
        return 0.0 if self.stamp_ns is None else (stamp_ns - self.stamp_ns) / NS_PER_S

    def accepted(
        self, pair: AcceptedPair, speed: Speed, added: AddedError, model: RoverModel
    ) -> tuple[PublishedPose, StepEstimate]:
        """Return the pose of an accepted pair, and the step to it.

        The step to the first pose is from that pose to itself, so that its motion is zero.

        Args:
            pair: The pair.
            speed: Last speed before the pair.
            added: What the findings of the pair add.
            model: Extrinsics, camera geometry, bounds and error sources.
        """
        variance_factor = updated_variance_factor(self.variance_factor, pair.chi_median, model.sources)
        noise = pose_noise(
            pair.given_keyframes,
            R_world_left=pair.T_world_left.rotation,
            variance_factor=variance_factor,
            shear=pair.shear,
            model=model,
        )
        published = PublishedPose(
            stamp_ns=pair.stamp_ns,
            T_world_left=pair.T_world_left,
            shared_with_next_step=added.of_step,
            noise=noise,
            variance_factor=variance_factor,
        )
        motion = StepMotion.between(self.T_world_left or pair.T_world_left, pair.T_world_left, model)
        depth_m = pair.tracked_depth_m
        keyframes = pair.landmark_map.last_motion
        of_images = step_covariance(motion, keyframes, pair.given_keyframes, depth_m, variance_factor, model)
        seconds = self.seconds_until(pair.stamp_ns)
        while_kept = unobserved_during(speed, self.kept_s, model) if self.is_kept else ZERO
        step = StepEstimate(
            seconds=seconds,
            motion=motion.vector,
            covariance=of_images + self.shared_with_next_step + while_kept + published.shared_with_next_step,
            systematic=systematic_step(motion, depth_m, pair.calibration, model),
            noise=noise.copy(),  # a caller may overwrite the arrays of a step
            noise_before=self.noise.copy(),
            speed_change=ZERO if pair.was_known else unobserved_during(speed, seconds, model),
        )
        return published, step

    def kept(
        self, stamp_ns: int, T_world_left: Transform, *, unobserved_s: float, speed: Speed, model: RoverModel
    ) -> tuple[PublishedPose, StepEstimate]:
        """Return the last known pose, kept at a stamp, and the step to it.

        The motion of the step is the displacement of the pose by an adjustment of its keyframe; zero without
        adjustment. The covariance of the step is the growth of the covariance of the unobserved motion.

        Args:
            stamp_ns: Stamp at which the pose is kept.
            T_world_left: Last known pose of the left camera in the world.
            unobserved_s: Time between the last known pose and the stamp.
            speed: Last speed.
            model: Extrinsics, bounds and error sources.
        """
        seconds = self.seconds_until(stamp_ns)
        added = unobserved_during(speed, unobserved_s, model) - unobserved_during(speed, self.kept_s, model)
        # both are diagonal, so that the larger elements form a covariance
        growth = np.maximum(added, unobserved_during(speed, seconds, model))
        motion = np.zeros(6)
        if self.T_world_left is not None:
            motion = StepMotion.between(self.T_world_left, T_world_left, model).vector
        step = StepEstimate(
            seconds=seconds,
            motion=motion,
            covariance=growth + MIN_COVARIANCE,
            systematic=np.zeros(6),
            noise=self.noise.copy(),
            noise_before=self.noise.copy(),
            speed_change=ZERO,
        )
        kept = self._replace(stamp_ns=stamp_ns, T_world_left=T_world_left, kept_s=unobserved_s)
        return kept, step

    def window_begun(self) -> PublishedPose:
        """Return the pose of a pair that begins a window.

        The next step is measured from the image of this pair. It therefore contains no errors and no noise of the
        earlier poses.
        """
        return self._replace(shared_with_next_step=ZERO, kept_s=0.0, noise=ZERO)

    def adjusted(self, moved: MotionSize) -> PublishedPose:
        """Return the pose after the last known pose was displaced by a change of the yaw correction.

        The covariance of the next step to a new pose grows by the square of the displacement. If the pose is kept
        first, the step to the kept pose contains the displacement itself, and its covariance is that of an unobserved
        motion.
        """
        return self._replace(shared_with_next_step=self.shared_with_next_step + moved.covariance)

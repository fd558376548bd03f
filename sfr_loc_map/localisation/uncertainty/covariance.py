"""Covariances of the estimates, composed of the named error sources.

The docstring of each function contains its formula, which defines one covariance by name:

| name | covariance of | function |
|---|---|---|
| `pose` | a pose of the left camera in the world | `pose_covariance` |
| `step` | the motion of RB in a step, in RB at the previous pose | `step_covariance`, and `added` (below) |
| `noise` | the white noise of a pose of RB, in RB, which cancels between consecutive steps | `pose_noise` |
| `systematic` | errors common to all steps, in RB, which add up with their sign; a vector | `systematic_step` |
| `unobserved` | an unobserved motion of RB, in RB at its start | `unobserved_motion` |

Consecutive poses share most of `pose`, which shrinks when the yaw is estimated. The uncertainty of the motion between
two poses is therefore composed of steps and not computed from `pose`. The covariance of the motion of a step, and
thereby of the twist, is `step + noise + noise_before + systematic^2 + speed_change`
(`StepEstimate.motion_covariance`).

The other names in the formulas are fields of `error_sources.ErrorSources`, unless the text below the formula explains
them, or one of these:

- f and b: focal length, px, and baseline, m (`RoverModel.fx`; f b is `RoverModel.focal_baseline`).
- Z: median depth of the landmarks, m; of the map in `pose`, of the tracked landmarks in `step` and `systematic`.
- `given_keyframes`: covariance of a pose given the keyframes, the inverse of `Tracks.information`.
- `variance_factor`: ratio of the squared residuals to their stated variance (Foerstner and Wrobel, Photogrammetric
  Computer Vision, chapter 4; `updated_variance_factor`).
- `yaw_sigma_px`, `yaw.target_px`, `remaining_px`: standard deviation of the right camera's yaw, the yaw to be
  corrected, and the part of this yaw that is not corrected yet (`OnlineCalibration`).

`added` in the step (`trajectory._step_to_new_pose`) has three parts: the inflation by findings of the two poses of the
step (`inflation_of`), the displacement of the previous pose by a correction of the yaw, and `unobserved` while the
previous pose was kept (`PublishedPose.unobserved_rb`). An added error of a pose has opposite signs in the steps to and
from that pose. Each of the two steps contains its covariance, which is conservative
(`PublishedPose.undone_by_next_step`). The parts of the previous pose are zero if its pair began a window, because the
step is measured from its image.

What enlarges the covariance of a pose:

| event | adds | until |
|---|---|---|
| accepted pair | covariance given the keyframes; `blur_px` of the image | next accepted pair |
| step | yaw and lens errors in proportion to its length | external pose |
| correction of a drift of the right camera | attitude, by `followed_attitude_ratio` | external pose |
| yaw of the right camera is detected or uncertain | attitude, by `bent_attitude_ratio` | better estimate of the yaw |
| keyframe | drift of the window by the adjustment, times `adjustment_inflation` | external pose |
| finding with `Inflation.UNOBSERVED` | speed times the time since the last accepted pair | next accepted pair |
| finding with `Inflation.AMBIGUITY` | distance between two motions, at least the above; sigmas add up | external pose |
| kept pair | speed times the time since the last accepted pair | next accepted pair |
| a window begins | speed times the time since the last known pose; `blur_px` of the image | external pose |
| external pose for a past pair | what that pair added until the next accepted pair | external pose |
| external pose between pairs that are not consecutive | speed times the time to the nearer pair | external pose |
| lost pair | the covariance of an unknown pose replaces all | next pair that is not lost |

The speed is the last one, but at least `motion.unseen_speed_m_s` and at most `motion.max_speed_m_s`. The turn rate and
the angle are treated likewise.

A new error source requires a field of `ErrorSources`, and a term in one of the formulas:

| the error | is a term of |
|---|---|
| of one pose, from its images or its calibration | `pose_covariance`, and `step_covariance` or `pose_noise` |
| common to all steps, with a constant direction | `pose_covariance` by `PathErrors.bias`, and `systematic_step` |
| required by findings | `inflation_of`, with a flag of `findings.Inflation` |
| that accumulates along the path | `PathErrors`, added in `trajectory._errors_at` |

An error that accumulates along the path also requires a field of `path_errors.PathErrors`, which only the methods of
that class change, and its increment in `trajectory._errors_at`. The table of that class shows what each event does to
each field. An error that an external pose ends is a sum that is never reset, as `directed`. A field of
`path_errors.Origin` and a field of `history.PastPose`, set in `trajectory._past_pose`, hold this sum at the origin and
at a past pose.

Positions are `(3,)`, m, in the world. A covariance `(6, 6)` is that of position and rotation about fixed axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import KeyframeMotion
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.motion_size import MAX_ANGLE_RAD, MotionSize, Speed, size_of
from sfr_loc_map.localisation.symmetric_matrices import symmetric
from sfr_loc_map.localisation.uncertainty.error_sources import ErrorSources
from sfr_loc_map.localisation.uncertainty.path_errors import ZERO, DirectedError, PathErrors
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel

EXPECTED_CHI_MEDIAN = 0.839  #: Median of chi-square with four degrees of freedom, divided by four.
MIN_VARIANCE = 1e-12  #: Added to the variances of a step, so that each is positive, m^2 and rad^2.


# ---- the pose


def pose_covariance(
    errors: PathErrors, position: FloatArray, depth_m: float, calibration: OnlineCalibration, model: RoverModel
) -> FloatArray:
    """Return the covariance `pose` of the left camera at a position, relative to the pose that placed the world in DS.

        pose = start + adjustment_inflation drift + directed + blur + attitude + unobserved
               + (disparity_px^2 + yaw_sigma_px^2 + (unsettled_yaw_ratio remaining_px)^2) bias bias'
               + uncorrected uncorrected'

    - start (`Origin.start`): covariance of that pose, propagated to the present position. If the pose was applied to a
      past pose, `start` contains the errors that no other pose shares with the past pose (`PastPose.alone`):
      `adjustment_inflation given_keyframes`, `blur`, and `unobserved` to the past pose. A new window adds to `start`
      `adjustment_inflation drift`, `unobserved` and `blur` of the pose at which the window begins.
    - drift: covariance that arose within the window, `of_keyframe - past_of_keyframe + given_keyframes`.
      `PathErrors.of_keyframe` is the covariance of the newest keyframe in its window, from the bundle adjustment.
      `given_keyframes` is zero once the pose itself is an adjusted keyframe. `Origin.past_of_keyframe` is zero unless
      an external pose applies to a past pose of this window. It is then `of_keyframe` of that past pose, propagated to
      the present position, and negative eigenvalues of the difference are replaced by zero.
    - directed: errors that add up along the path (ambiguous motions, bending of the path by the lens), propagated to
      the present position (`PathErrors.directed_covariance`).
    - blur: standard deviation blur_px / f, rad, about each axis, and this angle times Z in position (`blur_of`).
    - attitude: (bent_attitude_ratio hypot(yaw_sigma_px, yaw.target_px))^2 + (followed_attitude_ratio followed_px)^2,
      divided by f^2. `followed_px` is the sum of the absolute drift corrections of the right camera since the origin,
      px. The term of the yaw depends on the present calibration only. An external pose does not end it.
    - unobserved (`PathErrors.unobserved`): `unobserved` of two motions. The motion to the last accepted pose counts as
      unobserved if the findings of that pose require this (`findings.RULES`). The motion since that pose is unobserved
      while the pose is kept.
    - bias: position error per pixel of a constant disparity error, m/px: the sum of displacement Z / (f b) over the
      steps since the origin.
    - uncorrected: position error of the path that was travelled before the yaw was corrected, m: the sum over the steps
      of (`yaw.target_px` - yaw corrected at the step) displacement Z / (f b).

    `trajectory._errors_at` computes the increments of each pair, and `PathErrors` accumulates them.
    """
    sources = model.sources
    blur = blur_of(depth_m, model).covariance
    # errors common to all disparities: a constant error, the uncertainty of the yaw, and the path travelled before the
    # yaw was corrected
    bias, corrected = errors.bias_since_origin
    uncorrected = calibration.yaw.target_px * bias - corrected
    unsettled_px = sources.unsettled_yaw_ratio * calibration.remaining_px
    variance_px2 = sources.disparity_px**2 + calibration.yaw_sigma_px**2 + unsettled_px**2
    disparity = np.zeros((6, 6))
    disparity[:3, :3] = variance_px2 * np.outer(bias, bias) + np.outer(uncorrected, uncorrected)
    # attitude errors from an uncorrected yaw, which bends the path, and from the drift of the right camera
    bent_px = sources.bent_attitude_ratio * np.hypot(calibration.yaw_sigma_px, calibration.yaw.target_px)
    attitude_px = np.hypot(bent_px, sources.followed_attitude_ratio * errors.followed_since_origin_px)
    attitude = np.zeros((6, 6))
    attitude[3:, 3:] = np.eye(3) * (attitude_px / model.fx) ** 2
    drift = errors.since_origin(position, sources.adjustment_inflation)
    directed = errors.directed_covariance.at(position)
    return np.asarray(drift + directed + blur + disparity + attitude + errors.unobserved)


def blur_of(depth_m: float, model: RoverModel) -> MotionSize:
    """Return the standard deviations of a pose that an error of the whole image causes, for a median depth."""
    blur_rad = model.sources.blur_px / model.fx
    return MotionSize(blur_rad * depth_m, blur_rad)


def lens_turn_per_m(calibration: OnlineCalibration, model: RoverModel) -> float:
    """Return the rotation per metre, rad/m, by which residual lens distortion bends the path.

    If landmarks are too near on one side and too far on the other by 1 px of disparity, each step is turned by its
    length divided by (fx baseline).
    """
    sources = model.sources
    return float(np.hypot(sources.lens_px, sources.lens_ratio * calibration.lens.rms_px) / model.focal_baseline)


# ---- what findings add


def unobserved_size(speed: Speed, seconds: float, bounds: MotionBounds) -> MotionSize:
    """Return the standard deviations of length and heading of a motion that no image showed.

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

    `metres` and `radians` are the standard deviations of length and heading (`unobserved_size`). Each angle is at most
    `MAX_ANGLE_RAD`.
    """
    metres, radians = size
    tilt = min(sources.tilt_ratio * radians, MAX_ANGLE_RAD)
    climb = sources.climb_ratio * metres
    return np.diag(np.square([metres, metres, climb, tilt, tilt, min(radians, MAX_ANGLE_RAD)]))


class AddedError(NamedTuple):
    """What findings add to the covariance of a pose, and of the steps to and from this pose."""

    #: `(6, 6)` covariance of the motion since the last pose as if unobserved, in RB at that pose; None if not required.
    unobserved_rb: FloatArray | None
    ambiguity: DirectedError | None  #: Error if another motion is the true one; None if not required.

    @property
    def of_step(self) -> FloatArray:
        """Covariance `(6, 6)` added to a step."""
        unobserved = ZERO if self.unobserved_rb is None else self.unobserved_rb
        return unobserved if self.ambiguity is None else unobserved + self.ambiguity.covariance


def inflation_of(
    inflation: Inflation,
    *,
    unobserved: MotionSize,
    moved: MotionSize,
    other_distance: MotionSize,
    sources: ErrorSources,
) -> AddedError:
    """Return what findings add to covariances, by the kinds of inflation that they require (`findings.RULES`).

    Args:
        inflation: Kinds of inflation that the findings of the pair require.
        unobserved: Size of the motion since the last pose as if unobserved.
        moved: Length and angle of the estimated motion since the last pose.
        other_distance: Distance between the poses of two possible motions; zero if only one was found.
        sources: Error sources of an unobserved motion.
    """
    unobserved_rb = None
    if Inflation.UNOBSERVED in inflation:
        unobserved_rb = unobserved_motion(unobserved, sources)
    ambiguity = None
    if Inflation.AMBIGUITY in inflation:  # either motion, or a standstill, may be the true one
        ambiguity = DirectedError(
            max(other_distance.metres, moved.metres, unobserved.metres),
            max(other_distance.radians, moved.radians, min(unobserved.radians, MAX_ANGLE_RAD)),
        )
    return AddedError(unobserved_rb, ambiguity)


# ---- a step


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
    """Return the variance factor after a pair. `chi_median` is per degree of freedom, and NaN without residuals."""
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
        common = (keyframe_px Z / f)^2 diag(1, 1, 1, 0, 0, 0)
        step_ratio = max(flow of the step / max(flow of the keyframes, min_interval_ratio usual flow), min_step_ratio)

    Errors from images are independent from step to step. `between_keyframes` is the covariance of the newest keyframe
    given the previous keyframe (`KeyframeMotion.covariance`), and the flow of the keyframes is that of the motion
    between the two. In a window of one keyframe, `given_keyframes` and the usual flow (`RoverModel.keyframe_rad`) are
    used instead. Flow is optical flow, rad. Before the first residuals, the factor before `step_ratio` is 1.
    `MIN_VARIANCE` is added to each variance.

    Args:
        step: The motion.
        keyframes: Motion between the two newest keyframes.
        given_keyframes: `(6, 6)` covariance of the pose given the keyframes, used if there is no second keyframe.
        depth_m: Median depth of the landmarks.
        variance_factor: Ratio of the squared residuals to their stated variance; None before the first residuals.
        model: Extrinsics, camera geometry and error sources.
    """
    sources = model.sources
    size = step.size.metres / depth_m + step.size.radians
    if keyframes is None:
        covariance = given_keyframes
        interval = model.keyframe_rad
    else:
        covariance = keyframes.covariance
        shortest = sources.min_interval_ratio * model.keyframe_rad
        interval = max(keyframes.size.metres / depth_m + keyframes.size.radians, shortest)
    common = np.zeros(6)
    common[:3] = (sources.keyframe_px * depth_m / model.fx) ** 2
    ratio = max(size / interval, sources.min_step_ratio)
    factor = 1.0
    if variance_factor is not None:
        factor = sources.step_inflation * max(variance_factor, sources.min_variance_factor)
    covariance = factor * np.asarray(ratio * (sources.adjustment_inflation * covariance + np.diag(common)))
    lever = -step.of_rb.rotation @ model.T_rb_left.translation
    covariance = propagated_covariance(covariance, lever, step.R_rb_world)
    return symmetric(covariance) + MIN_VARIANCE * np.eye(6)


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
    """Return the signed one-sigma effects `systematic` `(6,)` on one step, in RB, of the errors that all steps share.

        systematic = (position, attitude)
        position = hypot(disparity_px, yaw_sigma_px, remaining_px) Z / (f b) displacement
        attitude = hypot(lens_px, lens_ratio RMS of the residual disparities) / (f b) length

    The remaining yaw enters a step in full. In the pose it is multiplied by `unsettled_yaw_ratio`, because `pose`
    also contains `uncorrected`. The depth Z is the median depth of the landmarks, m.
    """
    disparity_px = np.sqrt(model.sources.disparity_px**2 + calibration.yaw_sigma_px**2 + calibration.remaining_px**2)
    scaled = disparity_px * depth_m / model.focal_baseline * step.displacement
    turned = lens_turn_per_m(calibration, model) * np.copysign(step.size.metres, step.vector[0])
    return np.concatenate((step.R_rb_world @ scaled, np.full(3, turned)))

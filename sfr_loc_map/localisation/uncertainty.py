"""What the estimates may be wrong by: the named error sources, and the covariances that are composed of them.

The formulas name the fields of `ErrorSources`. They contain what the localiser estimates itself: `yaw_sigma`,
`yaw_target` and `yaw_remaining` are the standard deviation of the right camera's yaw, the yaw to be corrected, and the
part of it that is not corrected yet (`OnlineCalibration`), px. The *variance factor* v is the ratio of the residuals
found to those stated (Foerstner and Wrobel, Photogrammetric Computer Vision, chapter 4). Z is the median depth of the
landmarks, m, f the focal length, px, and b the baseline, m.

**Pose** (`pose_covariance`): left camera in the world, since the pose that placed the world in DS.

    P = start + adjustment_inflation D + A + blur + (disparity_px^2 + yaw_sigma^2 + (unsettled_yaw_ratio
        yaw_remaining)^2) B B' + U U' + attitude + unimaged

- start: covariance of that pose, propagated to the present position.
- D: drift within the window, from the bundle adjustment.
- A: directed errors (ambiguous motions; bending of the path by the lens), which add up along the path, propagated.
- blur: (blur_px / f) rad on each axis, and that angle times Z in position.
- B: path integral of the position over a constant disparity error, m/px. U: position error of the path that was
  travelled before the yaw was corrected, m.
- attitude: (bent_attitude_ratio hypot(yaw_sigma, yaw_target))^2 + (followed_attitude_ratio followed drift)^2, over f^2.
- unimaged: the motion up to the last accepted pose as if no image had shown it, for findings that ask for it
  (`findings.RULES`), and the motion since that pose while it is kept (`PathErrors.suspected`, `PathErrors.unseen`).

Two poses share most of P, and P shrinks when the yaw is learnt. P therefore does not give the uncertainty of the motion
between two poses, which is composed of steps.

**Step** (`step_covariance` without `added`, which `trajectory` adds): RB in RB at the pose before, independent from
step to step.

    Q = step_inflation max(v, min_variance_factor) r (adjustment_inflation K + (keyframe_px Z / f)^2) + added
    r = max(step / max(keyframe interval, min_interval_ratio usual interval), min_step_ratio)

- K: covariance of the newest keyframe given the one before. The sizes of step and interval are optical flow, rad.
- added: what findings add to the two poses of the step (`inflation_of`), the motion of the pose before by a correction
  of the yaw (`PublishedPose.shared`), and the motion while that pose was kept (`unseen`). The factor in front is 1
  before the first residuals.

**Noise** (`pose_noise`): white noise of a pose itself, which cancels between consecutive steps.

    N = white_ratio max(v, min_variance_factor) max(shear_chi2, 1) C + exposure_rad^2 (attitude)

- C: covariance of the pose given the landmarks.

**Systematic** (`systematic_step`): errors common to all steps, which add up with their sign.

    position = hypot(disparity_px, yaw_sigma, yaw_remaining) Z / (f b) displacement
    attitude = hypot(lens_px, lens_ratio residual disparity) / (f b) length

A yaw that is still to be corrected counts in full in a step and by half in the pose, which contains U as well.

**Twist** (`StepEstimate.motion_covariance`): the motion of a step over its duration. Its covariance is Q, N of both
poses, the squared systematic part, and a speed that may have changed while no image showed it.

**Unseen motion** (`unseen_motion`): in a time t at the speed (s, w), at least the configured one:

    diag(s t, s t, climb_ratio s t, tilt_ratio w t, tilt_ratio w t, w t)^2

Each angle is at most `MAX_ANGLE_RAD`, about which nothing is known then.

A new error source is a field of `ErrorSources` and a term in one of these formulas. If it accumulates along the path,
it is also a field of `PathErrors`, which only its methods change: `with_pose` or `with_directed` adds to it, `placed`
and `rebased` reset it, and `restarted` decides what of it a new window inherits. It is a field of `history.PastPose` as
well, from which `rebased` takes what arose before a past pose.

Positions are `(3,)`, m, in the world. A covariance `(6, 6)` is of position and rotation about fixed axes, of the left
camera in the world unless stated otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import KeyframeMotion
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.motion_size import MotionSize, Speed, size_of

MAX_ANGLE_RAD = np.pi / np.sqrt(3.0)  #: Standard deviation of an angle about which nothing is known (uniform), rad.
EXPECTED_CHI_MEDIAN = 0.839  #: Median of chi-square with four degrees of freedom, divided by four.
MIN_VARIANCE = 1e-12  #: Keeps each covariance of a step positive definite, m^2 and rad^2.
ZERO = np.zeros((6, 6))  #: No uncertainty; read only.


@dataclass(frozen=True, slots=True)
class ErrorSources:
    """The error sources of the localiser: standard deviations, and ratios to what is estimated.

    The values were chosen by hand so that NEES is near 1 on rendered drives (`make nees`).
    The letter at the beginning of each text says which formula of the module the field enters: P pose, Q step, N noise,
    S systematic, M unseen motion. The twist contains Q, N and S.
    """

    blur_px: float = 0.03
    """P. Error of a whole image (blur, jitter), px: it is common to all landmarks and therefore unobservable."""
    exposure_rad: float = 1e-5
    """N. Attitude noise of a whole image, rad, because its mean exposure is not at the stamp (vibration: 4e-5)."""
    disparity_px: float = 0.01
    """P, S. Error that all disparities share, px: it scales the path."""
    lens_px: float = 0.0007
    """P (in A), S. Disparity error that varies over the image, of a lens whose residuals show none, px. It bends the
    path."""
    lens_ratio: float = 0.17
    """P (in A), S. The same error as a ratio to the RMS of the residual disparities."""
    unsettled_yaw_ratio: float = 0.5
    """P. Error of the yaw of the right camera as a ratio to the yaw that is still to be corrected."""
    bent_attitude_ratio: float = 0.25
    """P. Attitude error as a ratio to the yaw: an uncorrected yaw bends the path."""
    followed_attitude_ratio: float = 0.1
    """P. Attitude error as a ratio to the drift of the right camera that was followed."""
    adjustment_inflation: float = 2.0
    """P, Q. Factor on the covariance of the bundle adjustment, because errors of neighbouring landmarks are
    correlated."""
    keyframe_px: float = 0.01
    """Q. Position error of a keyframe that its landmarks share, px at their median depth."""
    min_step_ratio: float = 0.02
    """Q. Ratio of the smallest step to a keyframe interval: no pose is exactly the one before."""
    min_interval_ratio: float = 0.25
    """Q. Smallest keyframe interval as a ratio to the interval that the optical flow triggers."""
    variance_gain: float = 0.1
    """Gain of a pair in the variance factor, which follows light and ground within some ten pairs."""
    min_variance_factor: float = 0.2
    """Q, N. Smallest variance factor: below it, errors dominate that no residual shows."""
    step_inflation: float = 1.5
    """Q. Factor on the variance factor in steps: errors that neighbouring landmarks share are in no residual."""
    white_ratio: float = 0.5
    """N. Fraction of the covariance of a pose that is independent from pair to pair (image noise)."""
    climb_ratio: float = 0.3
    """M. Vertical over horizontal speed of a motion that no image showed: slopes of up to 17 degrees."""
    tilt_ratio: float = 0.2
    """M. Roll and pitch rate over the turn rate of a motion that no image showed."""


@dataclass(frozen=True, slots=True, eq=False)
class RoverModel:
    """What is constant in a run: the mount of the left camera, its geometry, the motion bounds, the error sources."""

    T_rb_left: Transform  #: Takes points in the left camera to RB.
    T_left_rb: Transform  #: Takes points in RB to the left camera.
    fx: float  #: Focal length, px.
    focal_baseline: float  #: Focal length times baseline, px m.
    keyframe_rad: float  #: Size of the motion between two keyframes, rad of optical flow.
    bounds: MotionBounds
    sources: ErrorSources = ErrorSources()

    @classmethod
    def of(cls, rig: StereoRig, bounds: MotionBounds, keyframe_flow: float) -> RoverModel:
        """Return the model of a rig; GeometryError if the extrinsics are unknown.

        The flow that triggers a keyframe is a fraction of the image width.
        """
        return cls(
            T_rb_left=rig.T_rb_left,
            T_left_rb=rig.T_rb_left.inverse(),
            fx=rig.fx,
            focal_baseline=rig.fx * rig.baseline_m,
            keyframe_rad=keyframe_flow * rig.width / rig.fx,
            bounds=bounds,
        )

    def covariance_of_left(
        self, covariance: FloatArray, *, R_world_frame: FloatArray, R_world_left: FloatArray
    ) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB in some frame."""
        lever = R_world_left @ self.T_rb_left.rotation.T @ self.T_rb_left.translation
        return symmetric(propagated_covariance(covariance, lever, R_world_frame))


class LocatedCovariance(NamedTuple):
    """Covariance `(6, 6)` of a pose, and the position `(3,)`, m, where the error arose."""

    position: FloatArray
    covariance: FloatArray

    def at(self, position: FloatArray) -> FloatArray:
        """Return the covariance at another position: a rotation error swings the path."""
        return propagated_covariance(self.covariance, position - self.position)


class DisparityBias(NamedTuple):
    """Path integrals `(3,)` of position over a constant disparity error, m/px."""

    total: FloatArray  #: Of the whole path.
    corrected: FloatArray  #: Times the yaw, px, that was corrected at each step.


class DirectedError(MotionSize):
    """Standard deviations of errors of several steps that have the same direction: they add up."""

    def plus(self, other: DirectedError) -> DirectedError:
        """Return the sum with a further error."""
        return DirectedError(self.metres + other.metres, self.radians + other.radians)

    def since(self, earlier: DirectedError) -> DirectedError:
        """Return what was added since an earlier sum."""
        return DirectedError(self.metres - earlier.metres, self.radians - earlier.radians)


@dataclass(frozen=True, slots=True, eq=False)
class PathErrors:
    """What the covariance of the present pose is composed of, accumulated since the start pose.

    Two parts come from motions that no image showed, `suspected` and `unseen`:

    | event | `suspected` | `unseen` |
    |---|---|---|
    | accepted pair | of its findings: the next pose no longer contains it | ends |
    | kept pair | stays: the pose is the same | the motion since the accepted pose |
    | adjustment of a keyframe | stays: its images may be partly older | is zero already |
    | new window | ends in the start of the window | ends in the start of the window |
    """

    start: LocatedCovariance  #: Start of the run or of the window, or a pose from outside.
    #: What earlier windows, and the motions between the windows, added since the map was placed, at the start of the
    #: window. A pose from outside in the past does not reset it.
    before_window: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)
    #: Pose in the window from which the drift counts; None: from the start of the window.
    drift_origin: LocatedCovariance | None = None
    in_window: FloatArray = field(default_factory=lambda: ZERO)  #: Covariance of the present pose in its window.
    #: Covariance of the motion up to the last accepted pose, if its images may partly be older.
    suspected: FloatArray = field(default_factory=lambda: ZERO)
    unseen: FloatArray = field(default_factory=lambda: ZERO)  #: Covariance of the motion since that pose.
    bias: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))
    bias_at_start: DisparityBias = DisparityBias(np.zeros(3), np.zeros(3))
    directed: DirectedError = DirectedError(0.0, 0.0)  #: Sum of ambiguous motions and of the bending by the lens.
    #: Covariance of that sum, and where it arose.
    directed_covariance: LocatedCovariance = LocatedCovariance(np.zeros(3), ZERO)

    @property
    def unimaged(self) -> FloatArray:
        """Covariance `(6, 6)` of the motions that no image showed."""
        return self.suspected + self.unseen

    def with_pose(self, *, in_window: FloatArray, suspected: FloatArray, bias: DisparityBias) -> PathErrors:
        """Return the errors of a new pose that images showed."""
        return replace(self, in_window=in_window, suspected=suspected, unseen=ZERO, bias=bias)

    def placed(self, start: LocatedCovariance) -> PathErrors:
        """Return the errors of a pose from outside at the last pose; only the path integrals continue."""
        return PathErrors(
            start=start,
            bias=self.bias,
            bias_at_start=self.bias,
            directed_covariance=LocatedCovariance(start.position, ZERO),
        )

    def rebased(
        self,
        *,
        start: LocatedCovariance,
        drift_origin: LocatedCovariance | None,
        position: FloatArray,
        bias: DisparityBias,
        directed: DirectedError,
    ) -> PathErrors:
        """Return the errors since an external pose with an earlier stamp.

        Args:
            start: Covariance of that pose, or of the start of the window if that pose is of an earlier one.
            drift_origin: That pose in its window; None if the drift counts from the start of the window.
            position: Position of the left camera at that pose.
            bias: Path integrals up to that pose.
            directed: Sum of the directed errors up to that pose.
        """
        since = self.directed.since(directed)
        return replace(
            self,
            start=start,
            drift_origin=drift_origin,
            bias_at_start=bias,
            directed=since,
            directed_covariance=LocatedCovariance(position, since.covariance),
        )

    def kept(self, unseen: FloatArray) -> PathErrors:
        """Return the errors of a pose that is kept while a motion is unseen."""
        return replace(self, unseen=unseen)

    def adjusted(self, in_window: FloatArray) -> PathErrors:
        """Return the errors after an adjustment of the newest keyframe, whose covariance in the window is given."""
        return replace(self, in_window=in_window)

    def restarted(
        self,
        position: FloatArray,
        *,
        drift: FloatArray,
        accumulated: FloatArray,
        first_image: FloatArray,
        in_window: FloatArray,
    ) -> PathErrors:
        """Return the errors at the start of a new window.

        Args:
            position: Position of the left camera.
            drift: `(6, 6)` of the start pose and the drift up to here (`start_and_drift`).
            accumulated: `(6, 6)` of all windows up to here (`accumulated_covariance`).
            first_image: `(6, 6)` that the first image adds.
            in_window: `(6, 6)` of the first keyframe in the new window.
        """
        start = drift + self.unimaged + first_image
        return replace(
            self,
            start=LocatedCovariance(position, start),
            before_window=LocatedCovariance(position, accumulated + self.unimaged + first_image),
            drift_origin=None,
            in_window=in_window,
            suspected=ZERO,
            unseen=ZERO,
        )

    def with_directed(self, error: DirectedError, position: FloatArray) -> PathErrors:
        """Return the errors with a further directed one, which arose at a position."""
        total = self.directed.plus(error)
        growth = total.covariance - self.directed.covariance
        located = LocatedCovariance(position, self.directed_covariance.at(position) + growth)
        return replace(self, directed=total, directed_covariance=located)


@dataclass(frozen=True, slots=True, eq=False)
class PublishedPose:
    """The pose published last that was not lost, from which the next step counts."""

    stamp_ns: int | None = None  #: Its stamp; None before the first.
    T_world_left: Transform | None = None  #: The pose as it was published; adjustments do not move it.
    #: `(6, 6)` in RB: uncertainty of the step to this pose that the next step shares, because that step may take it
    #: back: what findings added, and the motion of the pose by a correction of the yaw.
    shared: FloatArray = field(default_factory=lambda: ZERO)
    #: `(6, 6)` in RB: motion since the last accepted pose while it was published again.
    unseen: FloatArray = field(default_factory=lambda: ZERO)
    noise: FloatArray = field(default_factory=lambda: ZERO)  #: White noise `(6, 6)` of it, in RB.
    variance_factor: float | None = None  #: Ratio of residuals found to residuals stated; None before the first.


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix."""
    return np.asarray(0.5 * (matrix + matrix.T))


def positive_part(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix without its negative eigenvalues."""
    values, vectors = np.linalg.eigh(symmetric(matrix))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


# ---- the pose


def pose_covariance(
    errors: PathErrors, position: FloatArray, depth_m: float, calibration: OnlineCalibration, model: RoverModel
) -> FloatArray:
    """Return the covariance P of the left camera at a position, with landmarks at a median depth."""
    sources = model.sources
    blur_rad = sources.blur_px / model.fx
    blur = np.diag(np.repeat(np.square([blur_rad * depth_m, blur_rad]), 3))
    # errors that all disparities share: a constant one, the yaw as far as it is unknown, and the path travelled
    # before the yaw was corrected
    bias = errors.bias.total - errors.bias_at_start.total
    corrected = errors.bias.corrected - errors.bias_at_start.corrected
    uncorrected = calibration.yaw.target_px * bias - corrected
    unsettled_px = sources.unsettled_yaw_ratio * calibration.remaining_px
    variance_px2 = sources.disparity_px**2 + calibration.yaw_sigma_px**2 + unsettled_px**2
    disparity = np.zeros((6, 6))
    disparity[:3, :3] = variance_px2 * np.outer(bias, bias) + np.outer(uncorrected, uncorrected)
    # the attitude, which an uncorrected yaw bends, and which the drift of the right camera leaves
    bent_px = sources.bent_attitude_ratio * np.hypot(calibration.yaw_sigma_px, calibration.yaw.target_px)
    attitude_px = np.hypot(bent_px, sources.followed_attitude_ratio * calibration.followed_px)
    attitude = np.zeros((6, 6))
    attitude[3:, 3:] = np.eye(3) * (attitude_px / model.fx) ** 2
    drift = start_and_drift(errors, position, model)
    directed = errors.directed_covariance.at(position)
    return np.asarray(drift + directed + blur + disparity + attitude + errors.unimaged)


def start_and_drift(errors: PathErrors, position: FloatArray, model: RoverModel) -> FloatArray:
    """Return the parts start and D of the pose covariance, which come from the start pose and the drift since."""
    drift = errors.in_window
    if errors.drift_origin is not None:
        drift = positive_part(drift - errors.drift_origin.at(position))
    return np.asarray(drift * model.sources.adjustment_inflation + errors.start.at(position))


def accumulated_covariance(errors: PathErrors, position: FloatArray, model: RoverModel) -> FloatArray:
    """Return what the windows and the motions between them added since the map was placed, for a pose of this window.

    Poses from outside do not reset it, so that the difference of two such covariances is what arose between two poses.
    """
    drift = errors.in_window * model.sources.adjustment_inflation
    return np.asarray(errors.before_window.at(position) + drift)


def lens_turn_per_m(calibration: OnlineCalibration, model: RoverModel) -> float:
    """Return the rotation per metre, rad/m, by which residual disparities of the lens bend the path.

    Landmarks that are too near on one side and too far on the other turn each step by metres / (fx baseline) per px.
    """
    sources = model.sources
    return float(np.hypot(sources.lens_px, sources.lens_ratio * calibration.lens.rms_px) / model.focal_baseline)


# ---- what findings add


def unseen_motion(speed: Speed, seconds: float, model: RoverModel) -> FloatArray:
    """Return the covariance `(6, 6)` of a motion that no image showed, in RB where it began.

    The rover may have continued at its last speed.
    """
    metres = max(model.bounds.unseen_speed_m_s, speed.m_s) * seconds
    heading = max(model.bounds.unseen_turn_rad_s, speed.rad_s) * seconds
    tilt = min(model.sources.tilt_ratio * heading, MAX_ANGLE_RAD)
    climb = model.sources.climb_ratio * metres
    return np.diag(np.square([metres, metres, climb, tilt, tilt, min(heading, MAX_ANGLE_RAD)]))


class AddedError(NamedTuple):
    """What findings add to the covariance of a pose, and of the steps to it and from it."""

    #: `(6, 6)` motion since the last pose, in RB there; None without such a finding.
    suspected_rb: FloatArray | None
    ambiguity: DirectedError | None  #: Distance to another possible pose; None without such a finding.

    @property
    def of_step(self) -> FloatArray:
        """Covariance `(6, 6)` added to a step."""
        suspected = ZERO if self.suspected_rb is None else self.suspected_rb
        return suspected if self.ambiguity is None else suspected + self.ambiguity.covariance


def inflation_of(
    inflation: Inflation, *, unseen_rb: FloatArray, moved: MotionSize, rival_distance: MotionSize
) -> AddedError:
    """Return what findings add, by the kind of their inflation (`findings.RULES`).

    Args:
        inflation: What the findings of the pair ask for.
        unseen_rb: `(6, 6)` covariance of the motion since the last pose if no image had shown it, in RB there.
        moved: Length and angle of the motion since the last pose, as it was estimated.
        rival_distance: Distance between the poses of two possible motions; zero if only one was found.
    """
    ambiguity = None
    if Inflation.AMBIGUITY in inflation:  # any of the motions, and standstill, may be the true one
        forwards_m, *_, heading_rad = np.sqrt(unseen_rb.diagonal())
        ambiguity = DirectedError(
            max(rival_distance.metres, moved.metres, forwards_m),
            max(rival_distance.radians, moved.radians, heading_rad),
        )
    return AddedError(unseen_rb if Inflation.SUSPECTED in inflation else None, ambiguity)


# ---- a step


@dataclass(frozen=True, slots=True, eq=False)
class StepMotion:
    """Motion between the pose published last and the present pose."""

    of_rb: Transform  #: `T_rb_before_now`.
    vector: FloatArray  #: `(6,)` the same as metres and rotation vector, rad.
    displacement: FloatArray  #: `(3,)` of the left camera in the world, m.
    size: MotionSize  #: Size of the motion of the left camera.
    R_rb_world: FloatArray  #: `(3, 3)` takes components in the world to RB at the pose before.

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
    """Return the variance factor after a pair; its median chi-square per degree of freedom is NaN without residuals."""
    found = chi_median / EXPECTED_CHI_MEDIAN
    if not np.isfinite(found):
        return before
    return found if before is None else before + sources.variance_gain * (found - before)


def step_covariance(
    step: StepMotion,
    keyframes: KeyframeMotion | None,
    given_landmarks: FloatArray,
    depth_m: float,
    variance_factor: float | None,
    model: RoverModel,
) -> FloatArray:
    """Return the covariance Q `(6, 6)` of a motion of the left camera, of RB in RB at the pose before.

    Args:
        step: The motion.
        keyframes: Motion between the two newest keyframes.
        given_landmarks: `(6, 6)` covariance of the pose if the landmarks were exact; it stands in without
            a second keyframe.
        depth_m: Median depth of the landmarks.
        variance_factor: Ratio of residuals found to residuals stated.
        model: Mount, geometry and error sources.
    """
    sources = model.sources
    size = step.size.metres / depth_m + step.size.radians
    if keyframes is None:
        covariance = given_landmarks
        interval = model.keyframe_rad
    else:
        covariance = keyframes.covariance
        shortest = sources.min_interval_ratio * model.keyframe_rad
        interval = max(keyframes.size.metres / depth_m + keyframes.size.radians, shortest)
    shared = np.zeros(6)
    shared[:3] = (sources.keyframe_px * depth_m / model.fx) ** 2
    ratio = max(size / interval, sources.min_step_ratio)
    factor = 1.0
    if variance_factor is not None:
        factor = sources.step_inflation * max(variance_factor, sources.min_variance_factor)
    covariance = factor * np.asarray(ratio * (sources.adjustment_inflation * covariance + np.diag(shared)))
    lever = -step.of_rb.rotation @ model.T_rb_left.translation
    covariance = propagated_covariance(covariance, lever, step.R_rb_world)
    return symmetric(covariance) + MIN_VARIANCE * np.eye(6)


def pose_noise(
    given_landmarks: FloatArray,
    *,
    R_world_left: FloatArray,
    variance_factor: float | None,
    shear_chi2: float,
    model: RoverModel,
) -> FloatArray:
    """Return the white noise N `(6, 6)` of a pose, of RB in RB.

    `given_landmarks` is the covariance if the landmarks were exact. A shear of the rows, as a squared ratio to its
    standard deviation, counts as noise if it exceeds 1.
    """
    sources = model.sources
    factor = 1.0 if variance_factor is None else max(variance_factor, sources.min_variance_factor)
    noise = sources.white_ratio * factor * max(shear_chi2, 1.0) * given_landmarks
    T_rb_left = model.T_rb_left
    noise = propagated_covariance(noise, -T_rb_left.translation, T_rb_left.rotation @ R_world_left.T)
    noise[3:, 3:] += sources.exposure_rad**2 * np.eye(3)
    return symmetric(noise)


def systematic_step(step: StepMotion, depth_m: float, calibration: OnlineCalibration, model: RoverModel) -> FloatArray:
    """Return the signed one-sigma effects `(6,)` of errors common to all steps on one step, in RB.

    The depth is the median depth of the landmarks, m.
    """
    disparity_px = np.sqrt(model.sources.disparity_px**2 + calibration.yaw_sigma_px**2 + calibration.remaining_px**2)
    scaled = disparity_px * depth_m / model.focal_baseline * step.displacement
    turned = lens_turn_per_m(calibration, model) * np.copysign(step.size.metres, step.vector[0])
    return np.concatenate((step.R_rb_world @ scaled, np.full(3, turned)))

"""Start pose of the localiser, and its estimate for each pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import (
    LOST_VARIANCE,
    MAX_POSITION_M,
    MAX_VARIANCE,
    is_plausible_covariance,
    plausible_rotations,
)
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform, propagated_covariance, symmetric

MAX_GIVEN_M = 0.5 * MAX_POSITION_M
"""Maximum coordinate of an external pose, and of the motion by odometry, m. Half of the limit of all positions, so that
the path from an external pose stays within that limit."""


def check_given(T_a_b: Transform, name: str) -> None:
    """Check an external pose, or a motion from another source. Messages contain the given name.

    GeometryError for another object, if the rotation is invalid, or if a coordinate exceeds `MAX_GIVEN_M`.
    """
    if not isinstance(T_a_b, Transform):
        raise GeometryError(f"{name} has the type {type(T_a_b).__name__}: a Transform is required")
    if not plausible_rotations(T_a_b.rotation):
        raise GeometryError(f"{name} has an invalid rotation: {T_a_b.rotation.tolist()}")
    if not (np.abs(T_a_b.translation) <= MAX_GIVEN_M).all():
        raise GeometryError(
            f"{name} has the position {T_a_b.translation.tolist()} m: at most {MAX_GIVEN_M:g} m is allowed"
        )


@dataclass(frozen=True, slots=True, eq=False)
class StartPose:
    """An external pose: the start of a run, or a pose set by an operator."""

    T_ds_rb: Transform  #: Pose of RB in DS.
    #: `(6, 6)` covariance in ROS order; zeros for an exact pose.
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    #: Stamp at which the pose is valid; None: the stamp of the next pair, even if that pair is refused.
    stamp_ns: int | None = None

    def __post_init__(self) -> None:
        """Raise GeometryError if the pose is not a `Transform`; `of` checks the values."""
        if not isinstance(self.T_ds_rb, Transform):
            raise GeometryError(f"T_ds_rb has the type {type(self.T_ds_rb).__name__}: a Transform is required")

    @classmethod
    def of(cls, pose: StartPose | Transform, name: str = "the start pose") -> StartPose:
        """Return a start pose with copies of all arrays. A transform is exact and valid at the next pair.

        GeometryError, with the name, if the rotation is invalid, a coordinate exceeds `MAX_GIVEN_M`, the covariance is
        not finite, symmetric and positive semi-definite, or the stamp is not a whole number.
        """
        start = pose if isinstance(pose, StartPose) else cls(pose)
        covariance = _as_numbers(start.covariance)
        scale = max(float(np.abs(covariance).max(initial=0.0)) / MAX_VARIANCE, 1.0)  # a large uncertainty is valid
        if covariance.shape != (6, 6) or not is_plausible_covariance(covariance / scale):
            raise GeometryError(
                f"{name} has an invalid covariance: a 6 x 6, finite, symmetric and positive semi-definite "
                "matrix is required"
            )
        check_given(start.T_ds_rb, name)
        if not isinstance(start.stamp_ns, int | np.integer | None):
            raise GeometryError(
                f"{name} has an invalid stamp: {start.stamp_ns!r}: whole nanoseconds, or None for the next "
                "pair, are required"
            )
        given = start.T_ds_rb
        T_ds_rb = Transform(given.rotation.copy(), given.translation.copy(), given.given_quat_xyzw)
        stamp_ns = None if start.stamp_ns is None else int(start.stamp_ns)  # NumPy integers may overflow
        return StartPose(T_ds_rb, covariance, stamp_ns)


def _as_numbers(values: ArrayLike) -> FloatArray:
    """Return a copy of values as float64; an empty array if the values are not numbers."""
    try:
        return np.array(values).astype(np.float64, casting="same_kind")  # complex numbers are refused
    except (TypeError, ValueError):
        return np.zeros(0)


class TrackingState(StrEnum):
    """State of the localiser after a call."""

    INITIALISING = "initialising"  #: The first window begins with the pair. The pose is the start pose.
    TRACKING = "tracking"  #: A pose was estimated, and no check reported a problem.
    #: A pose was estimated or kept, but a check reported a problem. The reason is published, and the covariance
    #: includes the error that the problem may cause (`findings.RULES`).
    DEGRADED = "degraded"
    LOST = "lost"  #: The pose is unknown.


class StateReason(StrEnum):
    """Why a pose is degraded or lost."""

    UNSEEN_MOTION = "unseen_motion"  #: Part of the motion before this pair is unobserved.
    REPEATED_IMAGES = "repeated_images"  #: One or both images repeat those of the previous pair.
    UNTEXTURED_IMAGES = "untextured_images"  #: An image has no texture: it is black, white or dazzled.
    #: Parts of the images were exposed at different times (partial transfer, double exposure, rolling shutter).
    TORN_IMAGES = "torn_images"
    NO_STEREO = "no_stereo"  #: The two images are not a stereo pair of the rig: identical or swapped.
    FEW_LANDMARKS = "few_landmarks"  #: Too few landmarks were tracked, or they do not agree on a pose.
    MOVING_REGIONS = "moving_regions"  #: Large parts of the images do not move with the ground.
    CALIBRATION_DRIFT = "calibration_drift"  #: The right camera has moved relative to the left camera.
    IMPLAUSIBLE_MOTION = "implausible_motion"  #: The pose is undetermined, diverged, or exceeds the bounds.


@dataclass(frozen=True, slots=True)
class TrackingStatistics:
    """Statistics of one call; None for a value that the call does not provide."""

    features: int | None = None  #: Landmarks searched for.
    #: Landmarks that agree with the pose; 0 if the pair was refused; None for a repeated pair and for a pair whose
    #: landmarks are new.
    inliers: int | None = None
    keyframes: int | None = None  #: Keyframes since the start.
    #: Median over the landmarks of the squared Mahalanobis residual per degree of freedom.
    chi_median: float | None = None
    residual_px: float | None = None  #: Median residual of the inliers, px.
    #: Vertical disparity at the principal point (pitch of the right camera), px.
    vertical_offset_px: float | None = None
    disparity_offset_px: float | None = None  #: Common error of all disparities (yaw), px; 0 while not significant.
    #: Growth of the vertical disparity to the right, over a distance of the focal length (roll), px.
    roll_offset_px: float | None = None
    repeated: int | None = None  #: 1 if both images repeat those of the previous pair.
    masked_share: float | None = None  #: Fraction of the image excluded because it does not move with the ground.

    def as_dict(self) -> dict[str, float]:
        """Return the available statistics by name."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {name: float(value) for name, value in values if value is not None}


class LandmarkTracks(NamedTuple):
    """M tracked landmarks in the left image, for display."""

    uv: FloatArray  #: `(M, 2)` px; NaN where a landmark was not found.
    keyframe_uv: FloatArray  #: `(M, 2)` px in the newest keyframe; NaN where not observed.
    residual: FloatArray  #: `(M,)` residual divided by the inlier gate: 1 or more for an outlier, NaN if not found.


@dataclass(frozen=True, slots=True, eq=False)
class StepEstimate:
    """The motion since the previous pose, in RB at that pose."""

    seconds: float  #: Time since the previous pose, s; 0 at the first pose.
    motion: FloatArray  #: `(6,)` translation, m, and rotation vector, rad.
    #: `(6, 6)` covariance of the motion, ROS order. Errors from images are independent from step to step. The terms
    #: that findings add to two consecutive steps are not independent (part `step` of `uncertainty`).
    covariance: FloatArray
    #: `(6,)` signed one-sigma effects of errors common to all steps, on the axes of RB. They add up over the steps. The
    #: six components are independent of each other.
    systematic: FloatArray
    noise: FloatArray  #: `(6, 6)` white noise of this pose, in RB at this pose; it cancels in the next step.
    noise_before: FloatArray  #: White noise of the previous pose, in RB at that pose.
    #: `(6, 6)` covariance of a change of speed during an unobserved motion, whose mean velocity may differ from the
    #: velocity at its end. Zero otherwise.
    speed_change: FloatArray

    @property
    def uncertainty(self) -> FloatArray:
        """Covariance (upper triangle), systematic vector and noise (upper triangle) as one vector `(48,)`."""
        upper = np.triu_indices(6)
        return np.concatenate((self.covariance[upper], self.systematic, self.noise[upper]))

    @property
    def motion_covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the motion: step, noise of both poses, systematic errors, change of speed."""
        T_before_now = Transform(matrix_from_rotvec(self.motion[3:]), self.motion[:3])
        before = propagated_covariance(self.noise_before, T_before_now.translation)
        turn = np.kron(np.eye(2), T_before_now.rotation)
        systematic = np.diag(np.square(self.systematic))
        total = self.covariance + before + turn @ self.noise @ turn.T + systematic + self.speed_change
        return symmetric(total)


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """Pose of the rover at one pair."""

    stamp_ns: int  #: Stamp of the pair.
    T_ds_rb: Transform  #: Takes points in RB to DS; the last known pose if lost.
    #: `(6, 6)` float64, ROS order: x, y, z (m, in DS), then rotation about the fixed axes of DS (rad). 9999 on the
    #: diagonal if lost. After a long unobserved motion, the variance of a pose that is not lost may exceed 9999.
    covariance: FloatArray
    state: TrackingState  #: State after this call.
    statistics: TrackingStatistics = TrackingStatistics()  #: Statistics of this call.
    #: Duration of the stages that take most of the time, s: `wait` (for the keyframe of the previous call), `keyframe`
    #: (its work in the background), `pyramid`, `align`, `refine`, and `relocate` if tracking failed.
    stage_s: Mapping[str, float] = field(default_factory=dict)
    reason: StateReason | None = None  #: Why the state is degraded or lost, None otherwise.
    step: StepEstimate | None = None  #: Motion since the previous pose; None if lost.
    #: Tracked landmarks, trusted or not; None if there are none, and in stored estimates of a whole drive.
    tracks: LandmarkTracks | None = None

    @property
    def reason_text(self) -> str:
        """The reason in one word; empty without a reason."""
        return "" if self.reason is None else self.reason.value

    @property
    def figures(self) -> dict[str, float]:
        """Statistics and stage times (`stage_<name>_s`) together."""
        return self.statistics.as_dict() | {f"stage_{name}_s": seconds for name, seconds in self.stage_s.items()}


def lost_covariance() -> FloatArray:
    """Return the covariance `(6, 6)` of an unknown pose."""
    return np.eye(6) * LOST_VARIANCE

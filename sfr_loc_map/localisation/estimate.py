"""What a localiser is given to start from, and its result for each pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum

import numpy as np

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import MAX_VARIANCE, is_plausible_covariance, plausible_rotations
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.inputs import LOST_VARIANCE


@dataclass(frozen=True, slots=True, eq=False)
class StartPose:
    """A pose from outside: where a run starts, or what an operator says."""

    T_ds_rb: Transform  #: Pose of RB in DS.
    #: `(6, 6)` of it, ROS order; zeros for an exact pose.
    covariance: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    stamp_ns: int | None = None  #: Stamp at which it holds; None: at the next pair, whether that shows anything or not.

    @classmethod
    def of(cls, pose: StartPose | Transform) -> StartPose:
        """Return a start pose; one without covariance and stamp is exact and holds at the next pair.

        GeometryError if it is none: no rotation, or no covariance (finite, symmetric, no negative variance).
        """
        start = pose if isinstance(pose, StartPose) else cls(pose)
        covariance = np.asarray(start.covariance, np.float64)
        scale = max(float(np.abs(covariance).max(initial=0.0)) / MAX_VARIANCE, 1.0)  # of one that is hardly known
        if covariance.shape != (6, 6) or not is_plausible_covariance(covariance / scale):
            raise GeometryError("the covariance of a start pose is none: 6 x 6, finite, symmetric, variances >= 0")
        if not plausible_rotations(start.T_ds_rb.rotation):
            raise GeometryError(f"a start pose has no rotation: {start.T_ds_rb.rotation.tolist()}")
        if not isinstance(start.stamp_ns, int | np.integer | None):
            raise GeometryError(f"stamp {start.stamp_ns!r} of a start pose: whole nanoseconds, or None, are needed")
        return start


class TrackingState(StrEnum):
    """State of the localiser after a call."""

    INITIALISING = "initialising"
    TRACKING = "tracking"
    DEGRADED = "degraded"  #: A pose with an honest, larger covariance, for a reason.
    LOST = "lost"


class StateReason(StrEnum):
    """Why a pose is degraded or lost."""

    #: The images of a stretch before this pair showed nothing, or nothing that was known.
    UNSEEN_MOTION = "unseen_motion"
    REPEATED_IMAGES = "repeated_images"  #: One or both images are those of the pair before.
    UNTEXTURED_IMAGES = "untextured_images"  #: An image shows nothing: black, white, blinded.
    TORN_IMAGES = "torn_images"  #: Parts of the images are of different moments.
    #: The two images are not a stereo pair of the rig: equal, swapped, or of different moments.
    NO_STEREO = "no_stereo"
    FEW_LANDMARKS = "few_landmarks"  #: Too few landmarks were found again, or they do not agree on a pose.
    MOVING_REGIONS = "moving_regions"  #: Large parts of the images do not move with the ground.
    CALIBRATION_DRIFT = "calibration_drift"  #: The right camera moves against the left one.
    IMPLAUSIBLE_MOTION = "implausible_motion"  #: The pose that was found is not finite, or no rover moves like that.


@dataclass(frozen=True, slots=True)
class TrackingStatistics:
    """Figures of one call; None where the call has no such figure."""

    features: int | None = None  #: Active landmarks.
    inliers: int | None = None  #: Landmarks that agree with the pose.
    keyframes: int | None = None  #: Keyframes since the start.
    #: Median over the landmarks of the squared Mahalanobis residual per degree of freedom.
    chi_median: float | None = None
    residual_px: float | None = None  #: Typical residual of the inliers, pixels.
    #: Vertical disparity at the image centre (right camera pitched against its calibration).
    vertical_offset_px: float | None = None
    #: Error of all disparities, pixels (yawed); 0 while it is not significant.
    disparity_offset_px: float | None = None
    #: Vertical disparity at a distance of the focal length beside the image centre (rolled), pixels.
    roll_offset_px: float | None = None
    repeated: int | None = None  #: 1 where both images equal those of the pair before.
    masked_share: float | None = None  #: Share of the image that is left out because it does not move with the ground.

    def as_dict(self) -> dict[str, float]:
        """Return the figures that the call has, by name."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {name: float(value) for name, value in values if value is not None}


@dataclass(frozen=True, slots=True, eq=False)
class StepEstimate:
    """The motion since the pose before, in RB at that pose."""

    seconds: float  #: Time since the pose before; 0 at the first pose.
    motion: FloatArray  #: `(6,)` metres and rotation vector, radians.
    covariance: FloatArray  #: `(6, 6)` of it, ROS order, independent from step to step.
    #: `(6,)` independent standard deviations, on the axes of RB, of what all steps have alike: they add up.
    systematic: FloatArray
    noise: FloatArray  #: `(6, 6)` white noise of the pose itself, in RB there: the step that follows takes it back.
    noise_before: FloatArray  #: The same of the pose before, in RB there.
    #: `(6, 6)` of what the motion may have been in an interval of this length: after a stretch that no image showed
    #: the mean velocity is not that at its end. Zero elsewhere.
    unsteady: FloatArray

    @property
    def uncertainty(self) -> FloatArray:
        """Its parts as `(48,)`: upper triangle of the covariance, systematic vector, upper triangle of the noise."""
        upper = np.triu_indices(6)
        return np.concatenate((self.covariance[upper], self.systematic, self.noise[upper]))

    @property
    def motion_covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the motion by itself: step, noise of both poses, calibration, a speed that changed."""
        T_before_now = Transform(matrix_from_rotvec(self.motion[3:]), self.motion[:3])
        before = propagated_covariance(self.noise_before, T_before_now.translation)
        turn = np.kron(np.eye(2), T_before_now.rotation)
        systematic = np.diag(np.square(self.systematic))
        total = self.covariance + before + turn @ self.noise @ turn.T + systematic + self.unsteady
        return np.asarray(0.5 * (total + total.T))


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """Pose of the rover at one pair."""

    stamp_ns: int  #: Stamp of the pair.
    T_ds_rb: Transform  #: Takes points in RB to DS; the last known pose when lost.
    #: `(6, 6)` float64, ROS order: x, y, z (m, in DS), then rotation about the fixed axes of DS (rad). 9999 on the
    #: diagonal when lost.
    covariance: FloatArray
    state: TrackingState  #: State after this call.
    statistics: TrackingStatistics = TrackingStatistics()  #: Figures of this call.
    #: Seconds of each stage by name: `wait` for the keyframe of the call before, which took `keyframe` in the
    #: background; `pyramid`, `align`, `refine`, and `relocate` where tracking failed.
    stage_s: Mapping[str, float] = field(default_factory=dict)
    reason: StateReason | None = None  #: Why the state is degraded or lost, None otherwise.
    step: StepEstimate | None = None  #: The motion since the pose before; None when lost.

    @property
    def reason_text(self) -> str:
        """The reason in one word, empty without one."""
        return "" if self.reason is None else self.reason.value

    @property
    def figures(self) -> dict[str, float]:
        """Statistics and stage times (`stage_<name>_s`) together."""
        return self.statistics.as_dict() | {f"stage_{name}_s": seconds for name, seconds in self.stage_s.items()}


def lost_covariance() -> FloatArray:
    """Return the covariance `(6, 6)` of an unknown pose."""
    return np.eye(6) * LOST_VARIANCE

"""Result of the localiser for each pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from sfr_loc_map.constants import LOST_VARIANCE
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform


class TrackingState(StrEnum):
    """State of the localiser after a call."""

    INITIALISING = "initialising"
    TRACKING = "tracking"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class TrackingStatistics:
    """Figures of one call; None where the call has no such figure.

    Attributes:
        features: Active landmarks.
        inliers: Landmarks that agree with the pose.
        keyframes: Keyframes since the start.
        chi_median: Median over the landmarks of the squared Mahalanobis residual per degree of freedom.
        residual_px: Typical residual of the inliers, pixels.
        vertical_offset_px: Vertical disparity at the image centre (right camera pitched against its calibration).
        disparity_offset_px: Error of all disparities, pixels (yawed); 0 while it is not significant.
        roll_offset_px: Vertical disparity at a distance of the focal length beside the image centre (rolled), pixels.
        repeated: 1 where both images equal those of the pair before.
    """

    features: int | None = None
    inliers: int | None = None
    keyframes: int | None = None
    chi_median: float | None = None
    residual_px: float | None = None
    vertical_offset_px: float | None = None
    disparity_offset_px: float | None = None
    roll_offset_px: float | None = None
    repeated: int | None = None

    def as_dict(self) -> dict[str, float]:
        """Return the figures that the call has, by name."""
        values = ((item.name, getattr(self, item.name)) for item in fields(self))
        return {name: float(value) for name, value in values if value is not None}


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """Pose of the rover at one pair.

    Attributes:
        stamp_ns: Stamp of the pair.
        T_ds_rb: Takes points in RB to DS; the last known pose when lost.
        covariance: `(6, 6)` float64, ROS order: x, y, z (m, in DS), then rotation about the fixed axes of DS (rad).
            9999 on the diagonal when lost.
        state: State after this call.
        statistics: Figures of this call.
        stage_s: Seconds of each stage by name, read-only: `wait` for the keyframe of the call before, which took
            `keyframe` in the background; `pyramid`, `align`, `refine`, and `relocate` where tracking failed.
    """

    stamp_ns: int
    T_ds_rb: Transform
    covariance: FloatArray
    state: TrackingState
    statistics: TrackingStatistics = TrackingStatistics()
    stage_s: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Keep the stage times as they are now, whatever the timer adds later."""
        object.__setattr__(self, "stage_s", MappingProxyType(dict(self.stage_s)))

    @property
    def figures(self) -> dict[str, float]:
        """Statistics and stage times (`stage_<name>_s`) together."""
        return self.statistics.as_dict() | {f"stage_{name}_s": seconds for name, seconds in self.stage_s.items()}


def lost_covariance() -> FloatArray:
    """Return the covariance `(6, 6)` of an unknown pose."""
    return np.eye(6) * LOST_VARIANCE

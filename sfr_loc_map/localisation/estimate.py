"""What the localiser says of each pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from sfr_loc_map.constants import LOST_VARIANCE
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform


class TrackingState(StrEnum):
    """State of the localiser after a call."""

    INITIALISING = "initialising"
    TRACKING = "tracking"
    LOST = "lost"


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """The pose of the rover at one pair.

    Attributes:
        stamp_ns: The pair's stamp.
        T_ds_rb: Takes points in RB to DS; when lost, the last pose known.
        covariance: `(6, 6)` float64, ROS order: x, y, z (m, in DS), then rotation about the fixed axes of DS (rad).
            9999 on the diagonal when lost.
        state: State after this call.
        statistics: Figures of this call by name (features, inliers, residual_px, ...).
        stage_s: Seconds that its stages took, by name: `wait` for the keyframe of the call before, which took
            `keyframe` in the background; `pyramid`, `align`, `refine`, and `relocate` where tracking failed.
    """

    stamp_ns: int
    T_ds_rb: Transform
    covariance: FloatArray
    state: TrackingState
    statistics: Mapping[str, float] = field(default_factory=dict)
    stage_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def figures(self) -> dict[str, float]:
        """Statistics and times of stages (`stage_<name>_s`) together."""
        return dict(self.statistics) | {f"stage_{name}_s": seconds for name, seconds in self.stage_s.items()}


def lost_covariance() -> FloatArray:
    """Return the covariance `(6, 6)` of a pose that is not known."""
    return np.eye(6) * LOST_VARIANCE

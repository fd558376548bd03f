"""A pose that is given to the localiser, and the stamp at which it holds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform


def _exact() -> FloatArray:
    return np.zeros((6, 6))


@dataclass(frozen=True, slots=True, eq=False)
class StartPose:
    """A pose from outside: where a run starts, or what an operator says.

    Attributes:
        T_ds_rb: Pose of RB in DS.
        covariance: `(6, 6)` of it, ROS order; zeros for an exact pose.
        stamp_ns: Stamp at which it holds; None: at the next pair, whether that shows anything or not.
    """

    T_ds_rb: Transform
    covariance: FloatArray = field(default_factory=_exact)
    stamp_ns: int | None = None

    @classmethod
    def of(cls, pose: StartPose | Transform) -> StartPose:
        """Return a start pose; one without covariance and stamp is exact and holds at the next pair."""
        return pose if isinstance(pose, StartPose) else cls(pose)

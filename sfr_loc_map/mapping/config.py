"""Parameters of the mapper."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.config import param

MAX_PAIRS = 3
"""Most stereo pairs of one map [1.3]."""


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """Parameters of the mapper; ROS parameters and configuration files have the same names."""

    min_range_m: float = param(0.9, unit="m", doc="Nearest depth that is searched.", low=0.05, high=1000.0)
    max_range_m: float = param(40.0, unit="m", doc="Farthest depth that is kept.", low=0.1, high=10_000.0)
    refine_poses: bool = param(
        False, doc="Move the poses of the second and third pair (up to 2 degrees, 0.1 m) to fit where pairs overlap."
    )

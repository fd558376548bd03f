"""Parameters of the localiser."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.config import param


@dataclass(frozen=True, slots=True)
class LocalisationConfig:
    """Parameters of the localiser; ROS parameters and configuration files have the same names."""

    max_features: int = param(400, doc="Corners kept in a keyframe.", low=20, high=5000)

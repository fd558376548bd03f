"""Parameters of the localiser."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.config import param


@dataclass(frozen=True, slots=True)
class LocalisationConfig:
    """Parameters of the localiser; ROS parameters and configuration files have the same names."""

    max_features: int = param(
        1000, doc="Landmarks tracked at a time; the picture is divided into as many cells.", low=50
    )
    window_keyframes: int = param(7, doc="Keyframes adjusted together.", low=2, high=20)
    adjustment_rounds: int = param(2, doc="Gauss-Newton rounds of each window adjustment.", low=1, high=20)
    keyframe_flow: float = param(
        0.05,
        doc="Median motion in the picture since the last keyframe, as a share of its width, for a new one.",
        low=0.01,
    )
    keyframe_share: float = param(
        0.65,
        doc="Share of the last keyframe's landmarks that must be tracked, or a new one is made.",
        low=0.1,
        high=1.0,
    )
    min_depth_m: float = param(0.5, unit="m", doc="Nearest depth that stereo matching looks for.", low=0.01)
    min_tracked: int = param(25, doc="Fewest landmarks that agree on a pose that is trusted.", low=8)
    common_px: float = param(
        0.03, unit="px", doc="Standard deviation of what a whole picture is off by, in the stated covariance.", low=0.0
    )
    common_disparity_px: float = param(
        0.01,
        unit="px",
        doc="Standard deviation of what all disparities are off by, in the stated covariance: it scales the way.",
        low=0.0,
    )
    inflation: float = param(
        2.0, doc="Factor on the stated covariance: neighbouring landmarks share part of their errors.", low=1.0
    )
    left_mask: str = param(
        "", doc="Picture file, 0 where the left camera sees the rover itself and nothing may be found; empty: none."
    )
    right_mask: str = param("", doc="The same for the right camera.")
    pixel_floor: float = param(0.05, unit="px", doc="Smallest standard deviation of a tracked position.", low=0.001)

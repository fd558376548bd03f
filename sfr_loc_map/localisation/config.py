"""Parameters of the localiser."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfr_loc_map.configuration.parameters import param

TRACKED_LANDMARKS = 800
"""Maximum number of landmarks tracked in a pair that does not become a keyframe. The pose errors of such pairs do not
accumulate. With 600 landmarks, the attitude error was 2 % larger (measurements/localiser_trials.md)."""


@dataclass(frozen=True, slots=True)
class MotionBounds:
    """Bounds on the motion of the rover."""

    unseen_speed_m_s: float = param(
        1.0,
        unit="m/s",
        doc="Standard deviation of the speed while the motion is unobserved. The last speed is used if it is larger.",
        low=0.0,
        high=1000.0,
    )
    unseen_turn_rad_s: float = param(
        0.5,
        unit="rad/s",
        doc="Standard deviation of the turn rate while the motion is unobserved. The last rate is used if larger.",
        low=0.0,
        high=100.0,
    )
    max_speed_m_s: float = param(
        50.0, unit="m/s", doc="Maximum speed. A pose that requires a faster motion is rejected.", low=0.01, high=1e4
    )
    max_turn_rad_s: float = param(
        6.0, unit="rad/s", doc="Maximum turn rate. A pose that requires a faster turn is rejected.", low=0.01, high=1e3
    )


@dataclass(frozen=True, slots=True)
class LocalisationConfig:
    """Parameters of the localiser; ROS parameters and configuration files have the same names."""

    max_features: int = param(
        2250,
        doc="Approximate number of grid cells in which a keyframe detects landmarks; a map may have more landmarks. "
        "Doubled for images of 900 x 900 pixels or more. Above 1024 x 1024 pixels, the number grows further with the "
        "square root of the side (6364 for 2048 x 2048 pixels).",
        low=50,
        high=20_000,
    )
    window_keyframes: int = param(7, doc="Number of keyframes in the window.", low=2, high=20)
    min_tracked: int = param(25, doc="Minimum number of inliers of an accepted pose.", low=8, high=TRACKED_LANDMARKS)
    motion: MotionBounds = field(default_factory=MotionBounds)
    left_mask: str = param(
        "", doc="PNG mask of the left camera. Features are not detected where its value is 0. Empty: no mask."
    )
    right_mask: str = param("", doc="PNG mask of the right camera, like left_mask.")

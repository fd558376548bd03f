"""What a rover may have done while nothing was seen, and what none does."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import MotionBounds

CLIMB_SHARE: Final = 0.3
"""Vertical against horizontal speed of an unseen motion."""
TILT_SHARE: Final = 0.2
"""Rates of roll and pitch against that of the heading."""
MAX_ANGLE: Final = np.pi / np.sqrt(3.0)
"""Standard deviation, radians, of a heading of which nothing is known."""
SLACK_M: Final = 1.0
SLACK_RAD: Final = 1.0
"""Motion that is never implausible, whatever the stamps say."""
MAX_POSITION_M: Final = 1e9


class Speed(NamedTuple):
    """How fast the rover moves.

    Attributes:
        m_s: Metres a second.
        rad_s: Radians a second.
    """

    m_s: float = 0.0
    rad_s: float = 0.0

    @classmethod
    def of(cls, motion: Transform, seconds: float) -> Speed:
        """Return the speed of a motion; none where it took no time."""
        if seconds <= 0.0:
            return cls()
        angle = float(np.linalg.norm(rotvec_from_matrix(motion.rotation)))
        return cls(float(np.linalg.norm(motion.translation)) / seconds, angle / seconds)


def unseen_covariance(seconds: float, last: Speed, bounds: MotionBounds) -> FloatArray:
    """Return the covariance `(6, 6)` of a motion that nothing showed, in RB where it began, ROS order.

    Args:
        seconds: How long nothing was seen.
        last: Speed before: a rover may go on as it did.
        bounds: Speed and turn rate of a rover of which nothing is known.
    """
    metres = max(bounds.unseen_speed_m_s, last.m_s) * seconds
    heading = max(bounds.unseen_turn_rad_s, last.rad_s) * seconds
    tilt = min(TILT_SHARE * heading, MAX_ANGLE)
    return np.diag(np.square([metres, metres, CLIMB_SHARE * metres, tilt, tilt, min(heading, MAX_ANGLE)]))


def is_plausible(motion: Transform, seconds: float, bounds: MotionBounds) -> bool:
    """Tell whether a rover can have moved like that."""
    metres, angle = np.linalg.norm(motion.translation), np.linalg.norm(rotvec_from_matrix(motion.rotation))
    within = metres <= SLACK_M + bounds.max_speed_m_s * seconds and angle <= SLACK_RAD + bounds.max_turn_rad_s * seconds
    return bool(within)

"""From the covariance of the newest camera in its window to that of the rover in its frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import skew
from sfr_loc_map.geometry.transform import propagated_covariance

UNSEEN_SIGMA = (1.0, 1.0, 0.3, 0.1, 0.1, 0.5)
"""What the rover may have moved while nothing was seen, in any direction, metres and radians."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a window or a run began, and how well that is known.

    Attributes:
        position: `(3,)` metres, in some frame.
        covariance: `(6, 6)` of the pose there, position and rotation about the fixed axes of that frame.
    """

    position: FloatArray
    covariance: FloatArray

    def carried_to(self, position: FloatArray) -> FloatArray:
        """Return its share `(6, 6)` of the covariance at another place `(3,)`: a turn at the start swings the way."""
        return propagated_covariance(self.covariance, position - self.position)


def common_covariance(depth_m: float, common_px: float, focal_px: float) -> FloatArray:
    """Return the covariance `(6, 6)` of what a whole picture is off by (blur, jitter): no landmark shows it.

    Args:
        depth_m: Usual depth of what is seen.
        common_px: Standard deviation, pixels.
        focal_px: Focal length, pixels.
    """
    angle = common_px / focal_px
    return np.diag(np.repeat(np.square([angle * depth_m, angle]), 3))


def covariance_of_rb(covariance: FloatArray, turn: FloatArray, lever: FloatArray) -> FloatArray:
    """Return the covariance `(6, 6)` of RB in DS.

    Args:
        covariance: `(6, 6)` of the left camera in the world.
        turn: `(3, 3)` world to DS.
        lever: `(3,)` from the camera to RB, metres, DS.
    """
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = turn
    jacobian[:3, 3:] = -skew(lever) @ turn
    result = jacobian @ covariance @ jacobian.T
    return np.asarray(0.5 * (result + result.T))

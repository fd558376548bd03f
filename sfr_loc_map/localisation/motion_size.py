"""Sizes of motions (length and angle) and speeds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, diagonal_matrix, length
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform

MAX_ANGLE_RAD = np.pi / np.sqrt(3.0)  #: Standard deviation of an unknown angle (uniform over a turn), rad.


class MotionSize(NamedTuple):
    """Size of a motion, of the difference of two poses, or of an error."""

    metres: float  #: Length.
    radians: float  #: Angle.

    def is_within(self, most: MotionSize) -> bool:
        """Return whether neither length nor angle exceeds that of another size; False for NaN."""
        return self.metres <= most.metres and self.radians <= most.radians

    @property
    def covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of errors whose standard deviation is this size on each axis.

        The angle is at most that of an unknown attitude.
        """
        radians = min(self.radians, MAX_ANGLE_RAD)
        m2 = self.metres * self.metres
        rad2 = radians * radians
        return diagonal_matrix((m2, m2, m2, rad2, rad2, rad2))

    def plus(self, other: MotionSize) -> MotionSize:
        """Return the sum with another size."""
        return MotionSize(self.metres + other.metres, self.radians + other.radians)

    def minus(self, other: MotionSize) -> MotionSize:
        """Return the difference to a smaller size."""
        return MotionSize(self.metres - other.metres, self.radians - other.radians)


NO_MOTION = MotionSize(0.0, 0.0)


class Speed(NamedTuple):
    """Speed of the left camera."""

    m_s: float
    rad_s: float


def size_of(motion: Transform) -> MotionSize:
    """Return the size of a motion."""
    return MotionSize(length(motion.translation), length(rotvec_from_matrix(motion.rotation)))


def size_between(before: Pose, after: Pose) -> MotionSize:
    """Return the distance and the angle between two poses."""
    angle = length(rotvec_from_matrix(before.rotation.T @ after.rotation))
    return MotionSize(length(after.position - before.position), angle)

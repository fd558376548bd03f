"""Errors that have the same direction in all steps, and the covariance without errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, read_only
from sfr_loc_map.localisation.motion_size import MAX_ANGLE_RAD, MotionSize

ZERO = read_only(np.zeros((6, 6)))  #: Covariance `(6, 6)` without errors.


class DirectedError(NamedTuple):
    """Standard deviations of errors that have the same direction in all steps and therefore add up."""

    metres: float  #: In position, along each axis.
    radians: float  #: About each axis.

    @property
    def covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the errors; the angle is at most that of an unknown attitude."""
        return MotionSize(self.metres, min(self.radians, MAX_ANGLE_RAD)).covariance

    def plus(self, other: DirectedError) -> DirectedError:
        """Return the sum with a further error."""
        return DirectedError(self.metres + other.metres, self.radians + other.radians)

    def since(self, earlier: DirectedError) -> DirectedError:
        """Return what was added since an earlier sum."""
        return DirectedError(self.metres - earlier.metres, self.radians - earlier.radians)


NO_DIRECTED_ERROR = DirectedError(0.0, 0.0)

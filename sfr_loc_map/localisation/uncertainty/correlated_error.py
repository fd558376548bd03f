"""Errors that are fully correlated between the steps of a path, and the covariance without errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, read_only
from sfr_loc_map.localisation.motion_size import MAX_ANGLE_RAD, MotionSize

ZERO = read_only(np.zeros((6, 6)))  #: Covariance `(6, 6)` without errors.


class CorrelatedError(NamedTuple):
    """Standard deviations of errors that are fully correlated between steps: standard deviations add, not variances."""

    metres: float  #: In position, along each axis.
    radians: float  #: About each axis.

    @property
    def covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the errors; the angle is at most that of an unknown attitude."""
        return MotionSize(self.metres, min(self.radians, MAX_ANGLE_RAD)).covariance

    def plus(self, other: CorrelatedError) -> CorrelatedError:
        """Return the sum with a further error."""
        return CorrelatedError(self.metres + other.metres, self.radians + other.radians)

    def since(self, earlier: CorrelatedError) -> CorrelatedError:
        """Return what was added since an earlier sum."""
        return CorrelatedError(self.metres - earlier.metres, self.radians - earlier.radians)


NO_CORRELATED_ERROR = CorrelatedError(0.0, 0.0)

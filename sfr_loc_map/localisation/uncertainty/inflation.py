"""What an unobserved motion, and the findings of the guards, add to the covariances (table in `uncertainty`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.motion_size import MAX_ANGLE_RAD, MotionSize, Speed
from sfr_loc_map.localisation.uncertainty.correlated_error import NO_CORRELATED_ERROR, ZERO, CorrelatedError
from sfr_loc_map.localisation.uncertainty.error_sources import ErrorSources
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel


def unobserved_size(speed: Speed, seconds: float, bounds: MotionBounds) -> MotionSize:
    """Return the standard deviations of length and heading of a motion that no image showed.

        metres  = seconds min(max(unseen_speed_m_s, speed), max_speed_m_s)
        radians = seconds min(max(unseen_turn_rad_s, turn rate), max_turn_rad_s)

    Speed and turn rate are those of the last motion, because the rover may have continued. They are at least the
    configured values of an unobserved motion, and at most the configured maximum values, because two pairs with nearly
    the same stamp may show any speed.
    """
    m_s = min(max(bounds.unseen_speed_m_s, speed.m_s), bounds.max_speed_m_s)
    rad_s = min(max(bounds.unseen_turn_rad_s, speed.rad_s), bounds.max_turn_rad_s)
    return MotionSize(m_s * seconds, rad_s * seconds)


def unobserved_motion(size: MotionSize, sources: ErrorSources) -> FloatArray:
    """Return the covariance `unobserved` `(6, 6)` of a motion that no image showed, in RB at its start.

        unobserved = diag(metres, metres, climb_ratio metres,
                          tilt_ratio radians, tilt_ratio radians, radians)^2

    `metres` and `radians` are the standard deviations of length and heading (`unobserved_size`). The standard deviation
    of each angle is at most `MAX_ANGLE_RAD`.
    """
    metres, radians = size
    tilt = min(sources.tilt_ratio * radians, MAX_ANGLE_RAD)
    climb = sources.climb_ratio * metres
    return np.diag(np.square([metres, metres, climb, tilt, tilt, min(radians, MAX_ANGLE_RAD)]))


def unobserved_during(speed: Speed, seconds: float, model: RoverModel) -> FloatArray:
    """Return the covariance `(6, 6)` of the motion of RB during `seconds` without images, in RB at the start."""
    return unobserved_motion(unobserved_size(speed, seconds, model.bounds), model.sources)


class AddedError(NamedTuple):
    """What findings add to the covariance of a pose, and of the steps to and from this pose."""

    #: `(6, 6)` covariance of the motion since the last pose, treated as unobserved, in RB at that pose; zero if no
    #: finding requires this covariance.
    unobserved_rb: FloatArray
    ambiguity: CorrelatedError  #: Error if another motion is the true motion; zero if no finding requires it.

    @property
    def of_step(self) -> FloatArray:
        """Covariance `(6, 6)` added to a step."""
        return self.unobserved_rb + self.ambiguity.covariance


def inflation_of(
    inflation: Inflation,
    *,
    unobserved: MotionSize,
    moved: MotionSize,
    other_distance: MotionSize,
    sources: ErrorSources,
) -> AddedError:
    """Return what findings add to covariances, by the kinds of inflation that they require (`findings.RULES`).

        ambiguity = max(other_distance, moved, unobserved), for the length and for the angle

    The true motion may be the other motion, a standstill, or a motion that was not found.

    Args:
        inflation: Kinds of inflation that the findings of the pair require.
        unobserved: Size of an unobserved motion since the last pose. The angle enters the ambiguity with at most
            `MAX_ANGLE_RAD`.
        moved: Length and angle of the estimated motion since the last pose.
        other_distance: Distance between the poses of two possible motions; zero if only one motion was found.
        sources: Error sources of an unobserved motion.
    """
    unobserved_rb = ZERO
    if Inflation.UNOBSERVED in inflation:
        unobserved_rb = unobserved_motion(unobserved, sources)
    ambiguity = NO_CORRELATED_ERROR
    if Inflation.AMBIGUITY in inflation:
        ambiguity = CorrelatedError(
            max(other_distance.metres, moved.metres, unobserved.metres),
            max(other_distance.radians, moved.radians, min(unobserved.radians, MAX_ANGLE_RAD)),
        )
    return AddedError(unobserved_rb, ambiguity)

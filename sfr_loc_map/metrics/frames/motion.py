"""When the rover moves: motions of the ground truth that are not noise or drift of the tracking."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.frames.association import StampedPoses

MOVING_SHARE = 0.1  #: The rover moves if its motion exceeds this fraction of the typical or fastest motion.


def least_by_rate(motions: FloatArray, durations_s: FloatArray) -> float:
    """Return the threshold above which a motion of typical duration counts as movement.

    The threshold has the unit of `motions` `(M,)`. It is a fraction of the motion at the largest rate over the
    median duration. A gap of the estimate increases single motions and their durations, but not their rates.
    """
    if not len(motions):
        return 0.0
    return MOVING_SHARE * float(np.max(motions / durations_s) * np.median(durations_s))


def typical_speed(truth: StampedPoses) -> float:
    """Return the median true speed of the moving rover, m/s; 0 if the rover does not move."""
    is_moving = moving_steps(truth.position)[1:]
    steps_m = np.linalg.norm(np.diff(truth.position, axis=0), axis=1)
    periods_s = np.diff(truth.stamps_ns) / NS_PER_S
    speeds = steps_m[is_moving] / periods_s[is_moving]
    return float(np.median(speeds)) if len(speeds) else 0.0


def moving_steps(true_positions: FloatArray) -> Mask:
    """Return at which frames `(F,)` the step from the previous frame is a motion of the rover."""
    is_moving = np.zeros(len(true_positions), np.bool_)
    if len(true_positions) < 2:
        return is_moving
    steps_m = np.linalg.norm(np.diff(true_positions, axis=0), axis=1)
    known = steps_m[steps_m > 0.0]
    if len(known):
        is_moving[1:] = steps_m > MOVING_SHARE * float(np.median(known))
    return is_moving

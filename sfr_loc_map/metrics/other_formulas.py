"""The formulas of conditions and figures that the specification does not define.

Frames, positions and quaternions are as in `metrics.formulas`, which has the formulas of the specification.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import quat_angle, quat_conjugate, quat_multiply, quat_rotate
from sfr_loc_map.metrics.formulas import DISTANCE_TOLERANCE_M, Poses, displacement, path_length_m

ANGLE_TOLERANCE = 1e-9  #: Relative rounding error by which a rotation may be smaller than the angle of a condition.
SUM_ROUNDING = 1e-6  #: Bound of the rounding errors of sums of steps, as a fraction of the threshold of a condition.
MIN_DIRECTION_M = 1e-6  #: Shortest horizontal displacement that has a direction; below, the true heading is used.


# ---- conditions: straight-line distance and rotation angle


def ends_apart(
    starts: IntArray,
    earliest: IntArray,
    true_position: FloatArray,
    true_attitude: FloatArray,
    metres: float,
    turn_deg: float,
) -> IntArray:
    """Return the first frame N+x, from `earliest` on, at the straight-line distance and the rotation angle from N.

    The result is F if there is no such frame. An angle of 0 deg requires no attitudes, which may be unknown (NaN).

    The search skips frames that cannot satisfy the condition: between two frames, neither the distance from N nor the
    angle from N changes by more than the lengths of the steps between them.
    """
    count = len(true_position)
    ends = np.minimum(earliest, count)
    searching = np.flatnonzero(ends < count)
    by_distance = _distance_measure(true_position, metres)
    measures = [by_distance] if turn_deg <= 0.0 else [by_distance, _turn_measure(true_attitude, turn_deg)]
    while len(searching):
        first = starts[searching]
        last = ends[searching]
        next_frames = [measure.next_frames(first, last) for measure in measures]
        ends[searching] = np.max(next_frames, axis=0)
        searching = searching[(ends[searching] > last) & (ends[searching] < count)]
    return ends


class Measure(NamedTuple):
    """A quantity between two frames, which a condition requires to reach a threshold."""

    between: Callable[[IntArray, IntArray], FloatArray]  #: Returns the quantity from frames to frames.
    threshold: float
    travelled: NDArray[np.longdouble]  #: Sum `(F,)` of the quantity over the steps up to each frame.

    def next_frames(self, starts: IntArray, ends: IntArray) -> IntArray:
        """Return the ends that reach the threshold, and in place of the others the earliest frames that can reach it.

        By the triangle inequality, the quantity grows between two ends at most by the sum of the
        quantity over the steps between them.
        """
        reached = self.between(starts, ends)
        missing = (1.0 - SUM_ROUNDING) * self.threshold - reached
        earliest = np.searchsorted(self.travelled, self.travelled[ends] + missing, side="left")
        return np.where(reached >= self.threshold, ends, np.maximum(earliest, ends + 1))


def _distance_measure(true_position: FloatArray, metres: float) -> Measure:
    """Return the straight-line distance between frames, m."""

    def between(starts: IntArray, ends: IntArray) -> FloatArray:
        return np.asarray(np.linalg.norm(displacement(true_position, starts, ends), axis=1))

    return Measure(between, metres - DISTANCE_TOLERANCE_M, path_length_m(true_position))


def _turn_measure(true_attitude: FloatArray, turn_deg: float) -> Measure:
    """Return the angle of the shortest rotation between frames, rad."""

    def between(starts: IntArray, ends: IntArray) -> FloatArray:
        return quat_angle(quat_multiply(quat_conjugate(true_attitude[starts]), true_attitude[ends]))

    steps = between(np.arange(len(true_attitude) - 1), np.arange(1, len(true_attitude)))
    travelled = np.zeros(len(true_attitude), np.longdouble)
    np.cumsum(steps, out=travelled[1:], dtype=np.longdouble)
    return Measure(between, np.radians(turn_deg) * (1.0 - ANGLE_TOLERANCE), travelled)


# ---- robust figures of maps (Höhle and Höhle 2009; NATO STANAG 2215)


def nmad(vertical: FloatArray) -> float:
    """Return the normalised median absolute deviation of height errors, which is sigma if they are normal."""
    return float(1.4826 * np.median(np.abs(vertical - np.median(vertical))))


def le90(vertical: FloatArray) -> float:
    """Return the linear error LE90: the 90 % quantile of the absolute height errors."""
    return float(np.percentile(np.abs(vertical), 90.0))


def ce90(horizontal: FloatArray) -> float:
    """Return the circular error CE90: the 90 % quantile of the norms `(P,)` of the horizontal errors."""
    return float(np.percentile(horizontal, 90.0))


# ---- relative motions, of which the relative pose error (RPE) is the difference


def relative_motions(
    position: FloatArray, attitude: FloatArray, starts: IntArray, ends: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return translations `(M, 3)` and quaternions `(M, 4)` of the motions `inv(T_N) T_N+x`, in the frame at N."""
    to_start = quat_conjugate(attitude[starts])
    return quat_rotate(to_start, displacement(position, starts, ends)), quat_multiply(to_start, attitude[ends])


# ---- errors without attitudes, along and across the path, and in px of disparity


def chord_error(poses: Poses, starts: IntArray, ends: IntArray) -> FloatArray:
    """Return the straight-line distance from N to N+x, estimated minus actual, which requires no attitudes."""
    estimated = np.linalg.norm(displacement(poses.position, starts, ends), axis=1)
    return np.asarray(estimated - np.linalg.norm(displacement(poses.true_position, starts, ends), axis=1))


def along_and_cross(
    error: FloatArray, true_displacement: FloatArray, true_heading: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the components of position errors along the horizontal true displacement, and to its left."""
    length = np.linalg.norm(true_displacement[:, :2], axis=1)
    has_direction = length >= MIN_DIRECTION_M
    divisor = np.where(has_direction, length, 1.0)
    east = np.where(has_direction, true_displacement[:, 0] / divisor, np.cos(true_heading))
    north = np.where(has_direction, true_displacement[:, 1] / divisor, np.sin(true_heading))
    return error[:, 0] * east + error[:, 1] * north, error[:, 1] * east - error[:, 0] * north


def disparity_error(focal_px: float, baseline_m: float, depth_m: FloatArray, true_depth_m: FloatArray) -> FloatArray:
    """Return the disparity error that corresponds to a depth error: `f b / Z - f b / Z_true`, px.

    The result is NaN for a depth that is not positive, because a point at or behind the camera has no disparity.
    """
    positive_m = np.where(depth_m > 0.0, depth_m, np.nan)
    true_positive_m = np.where(true_depth_m > 0.0, true_depth_m, np.nan)
    return np.asarray(focal_px * baseline_m / positive_m - focal_px * baseline_m / true_positive_m)

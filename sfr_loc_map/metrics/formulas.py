"""The formulas of the specification in the order of its clauses, vectorised over the sub-trajectories.

A sub-trajectory starts at frame N and ends at frame N+x. `starts` and `ends` are arrays `(M,)` of these frames, so that
`true_position[ends]` contains the true position at N+x of every sub-trajectory. Positions `(F, 3)` are those of the RB
origin in DS, in metres. Quaternions `(F, 4)` are scalar last [3.1.1], have unit length, and rotate vectors from RB into
DS (the conjugate of `att_q_DsToRb` [3.1.2]).

The statistics at the end of the module are the columns of the table of figures. The function
`metrics.trajectory.trajectory_errors.select` selects the valid sub-trajectories and combines several conditions. The
formulas of figures that the specification does not define are in `metrics.other_formulas`.

test/helpers/metrics_reference.py implements the same formulas with loops and SciPy's rotations, and shares no code
with this module.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import quat_angle, quat_conjugate, quat_multiply, quat_rotate

DISTANCE_TOLERANCE_M = 1e-9  #: Rounding error by which a path may be shorter than the distance of a condition.
Lengths = NDArray[np.longdouble]  #: Path lengths `(F,)`, m.
Number = TypeVar("Number", float, FloatArray)


# ---- 4.1.1 Sub-trajectories


def start_frames(frames: int, spacing: int) -> IntArray:
    """Return the frames N: the first frame, then every `spacing` frames [4.1.1: 10 are recommended]."""
    return np.arange(0, frames, spacing)


def path_length_m(true_position: FloatArray) -> Lengths:
    """Return the length of the true path up to each frame, in extended precision to resolve 1e-9 m on long paths."""
    steps = np.linalg.norm(np.diff(true_position, axis=0), axis=1)
    length = np.zeros(len(true_position), np.longdouble)
    np.cumsum(steps, out=length[1:], dtype=np.longdouble)
    return length


def ends_by_distance(starts: IntArray, length_m: Lengths, distance_m: float) -> IntArray:
    """Return the first frame N+x at which the true path from N has the distance, or F if the path is too short."""
    needed = length_m[starts] + (distance_m - DISTANCE_TOLERANCE_M)
    return np.maximum(np.searchsorted(length_m, needed, side="left"), starts + 1)


def ends_by_time(starts: IntArray, stamps_ns: IntArray, time_ns: int) -> IntArray:
    """Return the first frame N+x that is at least `time_ns` later than N, or F if there is no such frame."""
    since_first = stamps_ns - stamps_ns[:1]
    return np.maximum(np.searchsorted(since_first, since_first[starts] + time_ns, side="left"), starts + 1)


def ends_by_frames(starts: IntArray, frames: int) -> IntArray:
    """Return the frame N+x that is `frames` frames after N; values of F or more are beyond the last frame."""
    return starts + frames


# ---- 4.1.2 Error over a sub-trajectory by three readings (`trajectory.rebase`, default `pose`)
#
# All three remove the position error at N. The table states whether the attitude error at N affects the errors at N+x:
#
#                   position error   attitude error   heading error
#   pose            no               no               no
#   displacement    yes              no               only its tilt
#   position        yes              yes              yes
#
# It affects the position error because it rotates the displacement.


class SubTrajectoryErrors(NamedTuple):
    """The errors of M sub-trajectories."""

    position_m: FloatArray  #: Error vectors `(M, 3)` in DS.
    attitude_deg: FloatArray  #: Rotation angles `(M,)`, not negative.
    heading_deg: FloatArray  #: Signed errors `(M,)` in (-180, 180].


class Poses(NamedTuple):
    """True and estimated poses of RB in DS at the same frames.

    Unknown components of the truth are NaN, or are those of the estimate (`metrics.frames.true_attitudes`).
    """

    true_position: FloatArray  #: `(F, 3)`, m.
    true_attitude: FloatArray  #: `(F, 4)`, unit quaternions, scalar last, that rotate vectors from RB into DS.
    position: FloatArray  #: `(F, 3)`, m.
    attitude: FloatArray  #: `(F, 4)`, unit quaternions, as `true_attitude`.


ErrorFunction = Callable[[Poses, IntArray, IntArray], SubTrajectoryErrors]
"""Function that returns the errors of the sub-trajectories from `starts` to `ends` by one reading."""


def pose_reading(poses: Poses, starts: IntArray, ends: IntArray) -> SubTrajectoryErrors:
    """Return the errors of the estimate that is re-based at N by its complete pose.

    `T_gt(N) inv(T_est(N)) T_est(N+x)` is compared with `T_gt(N+x)`.
    """
    true_position, true_attitude, position, attitude = poses
    correction = quat_multiply(true_attitude[starts], quat_conjugate(attitude[starts]))
    moved = quat_rotate(correction, displacement(position, starts, ends))
    turned = quat_multiply(correction, attitude[ends])
    return SubTrajectoryErrors(
        position_error(moved, displacement(true_position, starts, ends)),
        attitude_error_deg(turned, true_attitude[ends]),
        heading_error_deg(heading(turned), heading(true_attitude[ends])),
    )


def displacement_reading(poses: Poses, starts: IntArray, ends: IntArray) -> SubTrajectoryErrors:
    """Return the errors of the literal reading of the specification.

    Displacements in DS and the changes of attitude and heading since N are compared. The attitude errors equal those of
    `pose_reading`. With `R = true_N^-1 true_N+x` and `E = est_N^-1 est_N+x`, both functions return the angle of
    `R^-1 E`, because `(true_N+x)^-1 true_N est_N^-1 est_N+x = R^-1 E`.
    """
    true_position, true_attitude, position, attitude = poses
    true_change = quat_multiply(quat_conjugate(true_attitude[starts]), true_attitude[ends])
    change = quat_multiply(quat_conjugate(attitude[starts]), attitude[ends])
    change_of_heading = heading(attitude[ends]) - heading(attitude[starts])
    true_change_of_heading = heading(true_attitude[ends]) - heading(true_attitude[starts])
    return SubTrajectoryErrors(
        position_error(displacement(position, starts, ends), displacement(true_position, starts, ends)),
        attitude_error_deg(change, true_change),
        heading_error_deg(change_of_heading, true_change_of_heading),
    )


def position_reading(poses: Poses, starts: IntArray, ends: IntArray) -> SubTrajectoryErrors:
    """Return the errors of the estimate that is re-based at N by its position alone.

    Attitude and heading at N+x are compared without re-basing and contain the errors accumulated before N.
    """
    true_position, true_attitude, position, attitude = poses
    return SubTrajectoryErrors(
        position_error(displacement(position, starts, ends), displacement(true_position, starts, ends)),
        attitude_error_deg(attitude[ends], true_attitude[ends]),
        heading_error_deg(heading(attitude[ends]), heading(true_attitude[ends])),
    )


# ---- 4.1.3 Standard deviation


def standard_deviation(errors: FloatArray) -> FloatArray:
    """Return the standard deviation of each column, with Bessel's correction: `sqrt(sum (x - mean)^2 / (n - 1))`."""
    squares = np.square(errors - np.mean(errors, axis=0))
    return np.asarray(np.sqrt(np.sum(squares, axis=0) / (len(errors) - 1)))


# ---- 4.2.1 and 4.3.1 Time, 4.2.2 and 4.3.2 memory of a call; `metrics.calls.call_meter` measures both


def call_time_s(called_ns: int, returned_ns: int) -> float:
    """Return the wall-clock time from the call of the API to its return with an estimate [4.2.1] or a cloud [4.3.1]."""
    return (returned_ns - called_ns) * 1e-9


def memory_above_idle(peak_bytes: int, idle_bytes: int) -> int | None:
    """Return the memory of a call [4.2.2, 4.3.2]: its peak resident memory above that of the idle process, bytes.

    The result is None if the peak is below the idle memory. The process then lost memory after the idle memory was
    measured, because it released the memory or because the kernel reclaimed it. The idle memory at the call is unknown.
    """
    return peak_bytes - idle_bytes if peak_bytes >= idle_bytes else None


# ---- 4.2.3.1 3D position error


def displacement(position: FloatArray, starts: IntArray, ends: IntArray) -> FloatArray:
    """Return the displacement of the RB origin from N to N+x, in DS."""
    return np.asarray(position[ends] - position[starts])


def position_error(estimated: FloatArray, actual: FloatArray) -> FloatArray:
    """Return the error vectors: estimated minus actual displacement."""
    return np.asarray(estimated - actual)


def norm_of_mean(errors: FloatArray) -> float:
    """Return the specification's 'mean': the norm of the mean of all position error vectors."""
    return float(np.linalg.norm(np.mean(errors, axis=0)))


def norm_of_sigmas(errors: FloatArray) -> float:
    """Return the specification's 'sigma': the norm of the vector of the standard deviations along the axes of DS."""
    return float(np.linalg.norm(standard_deviation(errors)))


def mean_plus_3sigma(mean: Number, sigma: Number) -> Number:
    """Return |mean| + 3 sigma. The absolute value matters for the heading error, whose mean is signed [4.2.3.3]."""
    return abs(mean) + 3.0 * sigma


# ---- 4.2.3.2 Attitude error


def attitude_error_deg(estimated: FloatArray, actual: FloatArray) -> FloatArray:
    """Return the angle of the shortest rotation from the actual to the estimated attitude, unsigned, degrees.

    The document uses the scalar part w of the rotation (v, w): `2 acos |w|`. `2 atan2(|v|, |w|)` is the same angle and
    is precise near 0 as well.
    """
    return np.degrees(quat_angle(quat_multiply(quat_conjugate(actual), estimated)))


# ---- 4.2.3.3 Heading error


def heading(attitude: FloatArray) -> FloatArray:
    """Return the angle in the x-y plane of DS from the DS x-axis to the RB x-axis: `atan2(Y_RB, X_RB)`, radians."""
    x, y, z, w = np.moveaxis(attitude, -1, 0)
    return np.asarray(np.arctan2(2.0 * (x * y + z * w), 1.0 - 2.0 * (y * y + z * z)))


def heading_error_deg(estimated: FloatArray, actual: FloatArray) -> FloatArray:
    """Return estimated minus actual heading, signed and wrapped to (-180, 180], degrees; the inputs are in radians."""
    error = np.degrees(estimated - actual)
    # an error in the range is not wrapped again, because rounding could move it out of the range
    is_wrapped = (error > -180.0) & (error <= 180.0)
    return np.where(is_wrapped, error, error - 360.0 * np.ceil((error - 180.0) / 360.0))


# ---- 4.3.4 Error in the output point cloud


def point_error(estimated: FloatArray, actual: FloatArray) -> FloatArray:
    """Return `pointErr_n = norm(pos_n_ref - pos_n_est)` of each point `(P, 3)`."""
    return np.asarray(np.linalg.norm(actual - estimated, axis=1))


# ---- statistics of n errors, the columns of the table of figures


class Statistics(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """The statistics of n errors, which are columns of the table of figures; null if undefined.

    The size of an error is its absolute value, or the norm of an error vector. Every score contains each statistic of
    this struct, and each can be limited, except the numbers of values. `FigureKind.shown` selects the statistics in
    tables and topics of the monitor, `FigureKind.compared` those of runs side by side, and `FigureKind.tested` those
    whose differences are tested. `QUANTILES` has the percentage of each quantile.
    """

    n: int | None = None  #: Number of known values.
    unknown: int | None = None  #: Number of unknown values; if there are any, the statistics are undefined.
    mean: float | None = None  #: Mean; norm of the mean vector for position errors [4.2.3.1].
    sigma: float | None = None  #: Standard deviation with n - 1 [4.1.3]; norm over the axes for position errors.
    mean_plus_3sigma: float | None = None  #: `|mean| + 3 sigma`.
    rmse: float | None = None  #: Root mean square of the sizes.
    p50: float | None = None  #: Median of the sizes, interpolated linearly.
    p95: float | None = None  #: 95 % quantile of the sizes.
    p99: float | None = None  #: 99 % quantile of the sizes.
    max: float | None = None  #: Largest size.


STATISTICS = tuple(name for name in Statistics.__struct_fields__ if name not in ("n", "unknown"))
"""Names of the statistics, in the order of the columns."""
PERCENTAGES = {name: float(name[1:].replace("_", ".")) for name in STATISTICS if name[1].isdigit()}
QUANTILES = dict(sorted(PERCENTAGES.items(), key=lambda item: item[1]))
"""Statistics that are quantiles of the sizes, with their percentage, in ascending order: `p99_5` would be 99.5 %."""


def statistics(errors: NDArray[np.floating]) -> Statistics:
    """Return the statistics of errors `(n,)` or of error vectors `(n, 3)`.

    They are undefined if an error is unknown (not finite). Mean, sigma and mean + 3 sigma are those of the
    specification, which defines them for sub-trajectories [4.1.1] and not for map points [4.3.4]. The other statistics
    are those of the sizes.
    """
    given = np.asarray(errors, np.float64)
    is_vector = given.ndim == 2
    is_known = np.isfinite(given).all(axis=1) if is_vector else np.isfinite(given)
    n, unknown = int(np.count_nonzero(is_known)), int(np.count_nonzero(~is_known))
    if n == 0 or unknown:
        return Statistics(n=n, unknown=unknown or None)
    sizes = np.linalg.norm(given, axis=1) if is_vector else np.abs(given)
    mean = norm_of_mean(given) if is_vector else float(np.mean(given))
    sigma = total = None
    if n > 1:
        sigma = norm_of_sigmas(given) if is_vector else float(standard_deviation(given))
        total = mean_plus_3sigma(mean, sigma)
    quantiles = np.percentile(sizes, list(QUANTILES.values())).tolist()
    return Statistics(
        n=n,
        mean=mean,
        sigma=sigma,
        mean_plus_3sigma=total,
        rmse=float(np.sqrt(np.mean(np.square(sizes)))),
        max=float(np.max(sizes)),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    )

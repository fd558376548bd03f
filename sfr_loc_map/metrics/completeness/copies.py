"""Estimates that are not measurements: copies of the previous pose or of the ground truth, and interpolated poses.

These figures of completeness count them:

- `poses_repeated`: a pose is bit-identical to the previous pose although the rover moves, and no state reports the pose
  as lost or degraded (`repeats_pose`).
- `poses_of_truth`: the motion to a pose equals the true motion more accurately than any measurement
  (`ends_true_motion`), or the pose is the rounded true pose (`is_rounded_truth`).
- `poses_interpolated`: a pose has the velocity and the rate of rotation of the previous pose, although those of other
  poses scatter, and no state reports the pose as lost or degraded (`is_interpolated`).
- `attitudes_of_truth`: the rotation to a pose equals the true rotation (`ends_true_rotation`).
- `errors_of_truth`: the motion from the start to the end of a judged sub-trajectory equals the true motion.

A short motion of any estimate can equal the true motion after rounding. Only motions that are long compared with the
resolution of the positions are therefore tested. The figures about the truth are fractions of what can be tested, and
unknown if nothing can be tested. See docs/metrics.md, "Completeness".
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.rotation import quat_angle, quat_conjugate, quat_multiply, quat_rotate, rotvecs_from_quats
from sfr_loc_map.geometry.trajectory import Trajectory, as_truth
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.completeness.expected_items import share_of, share_rows
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.frames.association import Frames, unique_rows
from sfr_loc_map.metrics.frames.motion import least_by_rate, moving_steps, typical_speed

NOISES = 5.0  #: A true displacement is a motion if it exceeds this multiple of the scatter of the truth.
DRIFT_SHARE = 0.02
"""Fraction of the typical true speed up to which a displacement is a drift of the tracking, not a motion. A localiser
with a zero-velocity update repeats its pose while the rover is stationary and the truth drifts, for instance by 3 mm in
90 s."""
EXACT_SHARE = 1e-5  #: Relative error of a motion that no odometry reaches: 10 um per metre.
RESOLUTIONS_M = (1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)  #: Resolutions of positions that are recognised, m.
FINEST_M = RESOLUTIONS_M[-1]  #: Resolution that is assumed for files with more decimals than are recognised, m.
COARSEST_OF_COPIES_M = 1e-3
"""Resolution, m, for the comparison of estimated and true positions that are on one coarser grid. A copy then equals
the truth exactly, and the grid may come from the drive instead of the rounding in a file."""
ROUNDED_IN_A_ROW = 50  #: Number of consecutive rounded true poses that an estimate does not reach by chance.
ROUNDED_PATH = 2000.0
"""Minimum path of a run of such poses, in units of the resolution. An error of 0.05 % over 2 m equals a resolution of
1 mm."""

FINEST_ANGLE = 1e-5  #: Coarsest resolution of quaternions with which attitudes of an estimate equal those of a copy.
UNITS_OF_CHANGE = 4.0  #: Largest change of a step by rounding, in units of the resolution of the positions.
SCATTER = 25.0
"""Minimum typical change between the steps of an estimate for a test of interpolation, in units of the change that
rounding causes. By chance, less than one step in 10 000 then equals the previous step."""
FEWEST_CHANGES = 10  #: Minimum number of steps that differ from the previous step, for a test of interpolation.
SAME_RATE_RAD = 1e-5  #: Largest change of the rotation in a step by rounding, rad.


class Tested(NamedTuple):
    """Which poses or motions are long and precise enough to be recognised as copies, and which of them are copies."""

    is_testable: Mask
    is_copy: Mask  #: Only testable poses or motions are copies.

    def either(self, other: Tested) -> Tested:
        """Return which are testable, and which are copies, by at least one of two tests."""
        return Tested(self.is_testable | other.is_testable, self.is_copy | other.is_copy)

    def where(self, is_chosen: Mask) -> Tested:
        """Return the result for chosen poses or motions only."""
        return Tested(self.is_testable & is_chosen, self.is_copy & is_chosen)

    @property
    def counts(self) -> tuple[int, int]:
        """The number of copies, and the number of testable poses or motions."""
        return int(np.count_nonzero(self.is_copy)), int(np.count_nonzero(self.is_testable))


def copy_rows(frames: Frames, truth: Trajectory, is_reported: Mask, *, interpolated: bool) -> Iterator[Figure]:
    """Yield the rows of the poses that repeat the previous pose, and of the poses that are copies of the ground truth.

    `is_reported` `(F,)` states whether the pose of a frame is reported as lost or degraded. `interpolated` states
    whether a true pose of a frame is interpolated.
    """
    repeated = int(np.count_nonzero(repeats_pose(frames) & ~is_reported))
    yield from share_rows("poses_repeated", repeated, len(frames.stamps_ns))
    interpolated_poses = int(np.count_nonzero(is_interpolated(frames) & ~is_reported))
    yield from share_rows("poses_interpolated", interpolated_poses, len(frames.stamps_ns))
    references = [frames.true_position]
    if interpolated:
        references.append(spline_positions(truth, frames))
    yield from share_rows("poses_of_truth", *copies_of_truth(frames, references).counts)
    yield from share_rows("attitudes_of_truth", *ends_true_rotation(frames, has_tilt=as_truth(truth).has_tilt).counts)


def judged_of_truth(frames: Frames, judged: Iterable[tuple[IntArray, IntArray]]) -> Figure:
    """Return the row of the judged motions that equal the true motions, for the condition with the largest fraction.

    `judged` contains starts and ends of the sub-trajectories of each condition. This detects an estimate that equals
    the truth only at these starts and ends, so that no two successive poses are copies.
    """
    resolution_m = resolution_of_copies(frames.position, frames.true_position)
    worst = figure_row("errors_of_truth", n=0)
    for starts, ends in judged:
        lengths_m = np.linalg.norm(frames.true_position[ends] - frames.true_position[starts], axis=1)
        durations_s = (frames.stamps_ns[ends] - frames.stamps_ns[starts]) / NS_PER_S
        is_moving = lengths_m > least_by_rate(lengths_m, durations_s)
        motions = compared_motions(frames, frames.true_position, starts, ends, resolution_m)
        copies, testable = motions.where(is_moving).counts
        share = share_of(copies, testable)
        if share is not None and share >= (worst.value or 0.0):
            worst = figure_row("errors_of_truth", n=testable, value=share)
    return worst


# ---- poses that repeat the previous pose


def repeats_pose(frames: Frames) -> Mask:
    """Return which poses `(F,)` equal the previous pose although the rover has moved since that pose first occurred.

    The motion must exceed the smallest step and half of the median step of the estimate, because the resolution of a
    file and a slow start also repeat poses. The motion must also exceed `NOISES` times the scatter of the truth, and
    the drift of the truth at `DRIFT_SHARE` of the typical speed.
    """
    count = len(frames.stamps_ns)
    is_same = np.zeros(count, np.bool_)
    if count < 2:
        return is_same
    steps_m = np.linalg.norm(np.diff(frames.position, axis=0), axis=1)
    is_same[1:] = (steps_m == 0.0) & (frames.attitude[1:] == frames.attitude[:-1]).all(axis=1)
    new = np.maximum.accumulate(np.where(is_same, 0, np.arange(count)))
    moved_m = np.linalg.norm(frames.true_position - frames.true_position[new], axis=1)
    own_m = steps_m[steps_m > 0.0]
    least_m = NOISES * scatter_m(frames.true_position)
    if len(own_m):
        least_m = max(least_m, float(own_m.min()), 0.5 * float(np.median(own_m)))
    since_s = (frames.stamps_ns - frames.stamps_ns[new]) / NS_PER_S
    drift_m = DRIFT_SHARE * typical_speed(frames.truth) * since_s
    return np.asarray(is_same & (moved_m > np.maximum(least_m, drift_m)))


def is_interpolated(frames: Frames) -> Mask:
    """Return which poses `(F,)` of a moving rover lie on the line between their neighbours, at constant rates.

    The velocity and the rate of rotation are those of the previous step to within rounding, although typical other
    steps differ by more than `SCATTER` times the rounding. Nothing is found in an estimate without such a scatter, as
    of a simulated straight drive, and in files whose stamps or positions are coarse.
    """
    found = np.zeros(len(frames.stamps_ns), np.bool_)
    if len(found) < 3:
        return found
    periods_s = np.diff(frames.stamps_ns)[:, None] / NS_PER_S
    velocities = np.diff(frames.position, axis=0) / periods_s
    rates = rotvecs_from_quats(in_start(frames.attitude[:-1], frames.attitude[1:])) / periods_s
    period_s = float(np.median(periods_s))
    changes_m = period_s * np.linalg.norm(np.diff(velocities, axis=0), axis=1)
    changes_rad = period_s * np.linalg.norm(np.diff(rates, axis=0), axis=1)
    is_moving = moving_steps(frames.position)
    moves = is_moving[1:-1] & is_moving[2:]
    rounding_m = UNITS_OF_CHANGE * max(resolution_of(frames.position), FINEST_M)
    others_m = changes_m[moves & (changes_m > rounding_m)]
    if len(others_m) >= FEWEST_CHANGES and float(np.median(others_m)) > SCATTER * rounding_m:
        found[1:-1] = moves & (changes_m <= rounding_m) & (changes_rad <= SAME_RATE_RAD)
    return found


def scatter_m(positions: FloatArray) -> float:
    """Return the median norm of the second differences of positions `(F, 3)`, caused by noise and acceleration."""
    if len(positions) < 3:
        return 0.0
    return float(np.median(np.linalg.norm(np.diff(positions, n=2, axis=0), axis=1)))


# ---- copies of the truth


def copies_of_truth(frames: Frames, references: Sequence[FloatArray]) -> Tested:
    """Return which poses `(F,)` of a moving rover are copies of the truth.

    `references` are true positions at the frames, by each kind of interpolation.
    """
    is_moving = moving_steps(frames.true_position)
    nothing = np.zeros(len(frames.stamps_ns), np.bool_)
    found = Tested(nothing, nothing)
    for true_pos in references:
        resolution_m = resolution_of_copies(frames.position, true_pos)
        found = found.either(ends_true_motion(frames, true_pos, resolution_m))
        if resolution_m:
            found = found.either(is_rounded_truth(frames.position, true_pos, resolution_m, is_moving))
    return found.where(is_moving)


def ends_true_motion(frames: Frames, true_pos: FloatArray, resolution_m: float) -> Tested:
    """Return for each frame `(F,)` whether the motion to it over the shortest testable path equals the true motion."""
    steps_m = np.linalg.norm(np.diff(true_pos, axis=0), axis=1)
    travelled_m = np.append(0.0, np.cumsum(steps_m))[: len(true_pos)]
    starts = np.searchsorted(travelled_m, travelled_m - least_motion_m(resolution_m), "right") - 1
    ends = np.flatnonzero(starts >= 0)
    motions = compared_motions(frames, true_pos, starts[ends], ends, resolution_m)
    is_testable, is_copy = np.zeros((2, len(true_pos)), np.bool_)
    is_testable[ends] = motions.is_testable
    is_copy[ends] = motions.is_copy
    return Tested(is_testable, is_copy)


def ends_true_rotation(frames: Frames, *, has_tilt: bool) -> Tested:
    """Return for each frame `(F,)` whether the rotation to it equals the true rotation, in DS or in RB at the start.

    The rotation is that over the shortest testable sum of rotations, as `ends_true_motion` defines it for motions.
    Nothing is testable without true roll and pitch, because those of the truth are then those of the estimate.
    """
    is_testable, is_copy = np.zeros((2, len(frames.stamps_ns)), np.bool_)
    if not has_tilt or not np.isfinite(frames.true_attitude).all():
        return Tested(is_testable, is_copy)
    resolution = resolution_of(frames.attitude)
    resolution = resolution if resolution <= FINEST_ANGLE else 0.0
    least_rad = least_motion_m(resolution)
    turned_rad = np.append(0.0, np.cumsum(angles_between(frames.true_attitude[:-1], frames.true_attitude[1:])))
    starts = np.searchsorted(turned_rad, turned_rad - least_rad, "right") - 1
    ends = np.flatnonzero(starts >= 0)
    starts = starts[ends]
    errors_rad = []
    for turn in (in_start, in_ds):
        estimated = turn(frames.attitude[starts], frames.attitude[ends])
        errors_rad.append(angles_between(estimated, turn(frames.true_attitude[starts], frames.true_attitude[ends])))
    is_testable[ends] = True
    is_copy[ends] = np.min(errors_rad, axis=0) <= EXACT_SHARE * least_rad + UNITS_OF_CHANGE * resolution
    return Tested(is_testable, is_copy)


def angles_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles `(N,)` of the rotations between attitudes `(N, 4)`, rad."""
    return quat_angle(in_start(first, second))


def in_start(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the rotations from attitudes to other attitudes, in RB at the start."""
    return quat_multiply(quat_conjugate(start), end)


def in_ds(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the rotations from attitudes to other attitudes, in DS."""
    return quat_multiply(end, quat_conjugate(start))


def least_motion_m(resolution_m: float) -> float:
    """Return the shortest motion that can be tested, m: its rounding is as small as `EXACT_SHARE` of the motion.

    It is 0.17 m for a resolution of 1 um or finer.
    """
    return float(np.sqrt(3.0)) * max(resolution_m, FINEST_M) / EXACT_SHARE


def compared_motions(
    frames: Frames, true_pos: FloatArray, starts: IntArray, ends: IntArray, resolution_m: float
) -> Tested:
    """Return which motions from `starts` to `ends` equal the true motions, in DS or in RB at the start.

    A displacement of less than half of the least testable motion, as after a turn back, is not testable.
    """
    motion, true_motion = frames.position[ends] - frames.position[starts], true_pos[ends] - true_pos[starts]
    in_body = quat_rotate(quat_conjugate(frames.attitude[starts]), motion)
    true_in_body = quat_rotate(quat_conjugate(frames.true_attitude[starts]), true_motion)
    in_ds_m = np.linalg.norm(motion - true_motion, axis=1)
    in_body_m = np.linalg.norm(in_body - true_in_body, axis=1)  # NaN without true attitudes
    error_m = np.fmin(in_ds_m, in_body_m)
    length_m = np.linalg.norm(true_motion, axis=1)
    is_long = np.asarray(length_m >= 0.5 * least_motion_m(resolution_m))
    return Tested(is_long, is_long & (error_m <= EXACT_SHARE * length_m + np.sqrt(3.0) * resolution_m))


def is_rounded_truth(positions: FloatArray, true_pos: FloatArray, resolution_m: float, is_moving: Mask) -> Tested:
    """Return which positions `(F, 3)` are rounded true positions, in runs that contain enough motion.

    A run must have `ROUNDED_IN_A_ROW` poses of a moving rover and a minimum path, because over a short path the error
    of a real estimate can be smaller than the rounding. Nothing is testable if the complete drive is too short for a
    run.
    """
    steps_m = np.linalg.norm(np.diff(true_pos, axis=0, prepend=true_pos[:1]), axis=1)

    def is_enough(run: slice) -> bool:
        path_m = float(steps_m[run][1:].sum())
        poses = int(np.count_nonzero(is_moving[run]))
        return poses >= ROUNDED_IN_A_ROW and path_m >= ROUNDED_PATH * resolution_m

    is_equal = (np.rint(true_pos / resolution_m) == np.rint(positions / resolution_m)).all(axis=1)
    edges = np.flatnonzero(np.diff(is_equal, prepend=False, append=False))
    is_copy = np.zeros(len(positions), np.bool_)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        is_copy[begin:end] = is_enough(slice(begin, end))
    return Tested(np.full(len(positions), is_enough(slice(None))), is_copy)


def resolution_of_copies(positions: FloatArray, true_pos: FloatArray) -> float:
    """Return the resolution at which a copy equals the truth, m; 0 if the positions were not rounded."""
    resolution_m = resolution_of(positions)
    is_of_finer_truth = resolution_of(true_pos) < resolution_m
    return resolution_m if is_of_finer_truth else min(resolution_m, COARSEST_OF_COPIES_M)


def resolution_of(positions: FloatArray) -> float:
    """Return the resolution of positions that were rounded to decimals, m; 0 if they were not rounded."""
    for resolution_m in RESOLUTIONS_M:
        units = positions / resolution_m
        if np.allclose(units, np.rint(units), rtol=0.0, atol=1e-4):
            return resolution_m
    return 0.0


def spline_positions(truth: Trajectory, frames: Frames) -> FloatArray:
    """Return true positions at frames by a cubic spline; with fewer than 4 poses by linear interpolation."""
    from scipy.interpolate import CubicSpline  # slow to import, and only interpolated truths need it

    rows = unique_rows(truth.stamps_ns)
    stamps_ns = truth.stamps_ns[rows]
    if len(stamps_ns) < 4:
        return frames.true_position
    time_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
    at_s = (frames.stamps_ns - stamps_ns[0]) / NS_PER_S
    return np.asarray(CubicSpline(time_s, truth.positions[rows])(at_s))

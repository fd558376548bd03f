"""Fraction of the sub-trajectories that a stationary rover adds, and the errors of the others.

With a condition of time, a stop adds sub-trajectories in which the rover is stationary. With a condition of distance, a
stop repeats sub-trajectories, because several of them begin at the same place.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.completeness.expected_items import share_of
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.catalogue import STANDING
from sfr_loc_map.metrics.figures.row_part import MOVING, SUB_TRAJECTORIES
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.formulas import Poses
from sfr_loc_map.metrics.frames.motion import least_by_rate
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories
from sfr_loc_map.metrics.trajectory.trajectory_errors import error_figures, error_row

TURN_DEG = 1.0  #: Smallest rotation of a point turn, above the typical noise of true attitudes, deg.
QUARTERS = (0.25, 0.5, 0.75, 1.0)
"""Fractions of a sub-trajectory at which the distance from the start is measured. The rover may end at the start."""


def rows_of_moving(
    condition: Condition, sub_trajectories: SubTrajectories, overlap: float, truth: Truth, stamps_ns: IntArray
) -> Iterator[Figure]:
    """Yield the fraction of sub-trajectories of a stationary rover, and the errors of the others.

    The errors are omitted if the rover is stationary in all sub-trajectories or in none. `stamps_ns` `(F,)` are the
    stamps of all frames.
    """
    name = condition.setting
    select = is_moving if condition.is_of_time else begins_elsewhere
    moves = select(sub_trajectories, stamps_ns, has_tilt=truth.has_tilt)
    count = len(sub_trajectories.starts)
    standing = count - int(np.count_nonzero(moves))
    yield figure_row(STANDING, name, SUB_TRAJECTORIES, n=count, value=share_of(standing, count))
    if not 0 < standing < count:
        return
    others = sub_trajectories.where(moves)
    for kind in error_figures(has_height=truth.has_height):
        yield error_row(kind, name, MOVING, others, overlap)


def is_moving(sub_trajectories: SubTrajectories, stamps_ns: IntArray, *, has_tilt: bool) -> Mask:
    """Return the sub-trajectories in which the rover moves or turns by more than a tenth of the fastest motion or turn.

    `least_by_rate` defines this motion. If the ground truth has no roll and pitch, only the heading counts, because the
    truth then has the roll and pitch of the estimate.
    """
    starts = sub_trajectories.starts
    ends = sub_trajectories.ends
    frames = [starts + np.rint(share * (ends - starts)).astype(np.int64) for share in QUARTERS]
    farthest_m = np.max([moved_m(sub_trajectories.poses, starts, at) for at in frames], axis=0)
    turns_deg = turned_deg(sub_trajectories.poses, starts, ends, has_tilt=has_tilt)
    durations_s = (stamps_ns[ends] - stamps_ns[starts]) / NS_PER_S
    moves = farthest_m > least_by_rate(farthest_m, durations_s)
    return np.asarray(moves | (turns_deg > least_turn(turns_deg, durations_s)))


def begins_elsewhere(sub_trajectories: SubTrajectories, stamps_ns: IntArray, *, has_tilt: bool) -> Mask:
    """Return the sub-trajectories that do not begin at the place of the previous sub-trajectory.

    The motion and the turn between neighbouring starts are divided by the least motion and the least turn of a moving
    rover (`least_by_rate`, `least_turn`) and summed from the first start on. A sub-trajectory begins elsewhere if the
    integer part of this sum increases at its start. A slow rover, each of whose motions is below the least motion, is
    therefore elsewhere after several starts. The first sub-trajectory begins elsewhere.
    """
    poses = sub_trajectories.poses
    before = sub_trajectories.starts[:-1]
    after = sub_trajectories.starts[1:]
    motions_m = moved_m(poses, before, after)
    turns_deg = turned_deg(poses, before, after, has_tilt=has_tilt)
    durations_s = (stamps_ns[after] - stamps_ns[before]) / NS_PER_S
    least_m = max(least_by_rate(motions_m, durations_s), np.finfo(np.float64).tiny)
    summed = np.floor(np.cumsum(motions_m / least_m + turns_deg / least_turn(turns_deg, durations_s)))
    return np.append(True, np.diff(summed, prepend=0.0) > 0.0)[: len(sub_trajectories.starts)]


def moved_m(poses: Poses, starts: IntArray, ends: IntArray) -> FloatArray:
    """Return the true distances between frames; unknown heights count as 0."""
    return np.asarray(np.linalg.norm(np.nan_to_num(formulas.displacement(poses.true_position, starts, ends)), axis=1))


def turned_deg(poses: Poses, starts: IntArray, ends: IntArray, *, has_tilt: bool) -> FloatArray:
    """Return the true rotations between frames, or without `has_tilt` the changes of heading; 0 if unknown."""
    attitude = poses.true_attitude
    if has_tilt:
        turns = formulas.attitude_error_deg(attitude[ends], attitude[starts])
    else:
        heading = formulas.heading(attitude)
        turns = np.abs(formulas.heading_error_deg(heading[ends], heading[starts]))
    return np.asarray(np.nan_to_num(turns))


def least_turn(turns_deg: FloatArray, durations_s: FloatArray) -> float:
    """Return the rotation, deg, above which the rover counts as turning over a typical duration."""
    return max(TURN_DEG, least_by_rate(turns_deg, durations_s))

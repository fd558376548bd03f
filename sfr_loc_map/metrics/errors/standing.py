"""Fraction of the sub-trajectories in which the rover is stationary, and the errors of those in which it moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.completeness.copies import MOVING_SHARE
from sfr_loc_map.metrics.completeness.expected_items import share_of
from sfr_loc_map.metrics.errors.trajectory_errors import error_figures, error_row
from sfr_loc_map.metrics.formulas import SubTrajectoryErrors
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories
from sfr_loc_map.metrics.table.catalogue import STANDING
from sfr_loc_map.metrics.table.row_part import MOVING, SUB_TRAJECTORIES
from sfr_loc_map.metrics.table.rows import Figure, figure_row

TURN_DEG = 1.0  #: Smallest rotation of a point turn, above the typical noise of true attitudes, deg.
QUARTERS = (0.25, 0.5, 0.75, 1.0)
"""Fractions of a sub-trajectory at which the distance from its start is measured, because it may end at its start."""


def rows_of_moving(
    condition: str, sub_trajectories: SubTrajectories, overlap: float, *, has_height: bool, has_tilt: bool
) -> Iterator[Figure]:
    """Yield the fraction of sub-trajectories of a stationary rover, and the errors of those in which it moves.

    `has_height` and `has_tilt` state whether the ground truth has heights, and roll and pitch. The errors are omitted
    if the rover is stationary in all sub-trajectories or in none.
    """
    moves = is_moving(sub_trajectories, has_tilt=has_tilt)
    count = len(sub_trajectories.starts)
    standing = count - int(np.count_nonzero(moves))
    yield figure_row(STANDING, condition, SUB_TRAJECTORIES, n=count, value=share_of(standing, count))
    if not 0 < standing < count:
        return
    errors = SubTrajectoryErrors(*(values[moves] for values in sub_trajectories.errors))
    others = sub_trajectories._replace(
        starts=sub_trajectories.starts[moves], ends=sub_trajectories.ends[moves], errors=errors
    )
    for kind in error_figures(has_height=has_height):
        yield error_row(kind, condition, MOVING, others, overlap)


def is_moving(sub_trajectories: SubTrajectories, *, has_tilt: bool) -> Mask:
    """Return the sub-trajectories in which the rover moves or turns by a tenth of the largest motion or turn.

    If the ground truth has no roll and pitch, only the heading counts, because those of its poses are estimated.
    """
    starts = sub_trajectories.starts
    ends = sub_trajectories.ends
    frames = [starts + np.rint(share * (ends - starts)).astype(np.int64) for share in QUARTERS]
    position = np.nan_to_num(sub_trajectories.poses.true_position)  # heights may be unknown
    moved_m = [np.linalg.norm(formulas.displacement(position, starts, at), axis=1) for at in frames]
    farthest_m = np.max(moved_m, axis=0)
    attitude = sub_trajectories.poses.true_attitude
    if has_tilt:
        turn_deg = formulas.attitude_error_deg(attitude[ends], attitude[starts])
    else:
        heading = formulas.heading(attitude)
        turn_deg = np.abs(formulas.heading_error_deg(heading[ends], heading[starts]))
    turn_deg = np.nan_to_num(turn_deg)  # attitudes may be unknown
    least_deg = max(TURN_DEG, MOVING_SHARE * np.max(turn_deg, initial=0.0))
    return np.asarray((farthest_m > MOVING_SHARE * np.max(farthest_m, initial=0.0)) | (turn_deg > least_deg))


def largest_standing_fraction(rows: Sequence[Figure]) -> Figure:
    """Return the row of the largest fraction over the conditions, 0 without a condition of time or frames."""
    fractions = [row.value for row in rows if row.figure == STANDING and row.value is not None]
    return figure_row(STANDING, value=max(fractions, default=0.0))

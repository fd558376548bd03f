"""The columns of the plots of a trajectory: its decimated frames and sub-trajectories."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.metrics import other_formulas
from sfr_loc_map.metrics.figures.details import NAMED_ERRORS, PathRows, SubTrajectoryRows, Values, column, named_columns
from sfr_loc_map.metrics.formulas import Lengths
from sfr_loc_map.metrics.frames.association import Estimates, Frames
from sfr_loc_map.metrics.frames.covariance import POSITION_VARIANCES
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories
from sfr_loc_map.metrics.trajectory.trajectory_errors import error_figures, errors_of

PATH_ROWS, DETAIL_ROWS = 2000, 1000  #: Maximum number of frames, and of sub-trajectories of each condition, in plots.


def every_nth(count: int, most: int) -> int:
    """Return the smallest power of two n such that every n-th of `count` rows gives at most `most` rows."""
    return 1 << (max(-(-count // most), 1) - 1).bit_length()


def sub_trajectory_rows(
    condition: str, sub_trajectories: SubTrajectories, stamps_ns: IntArray, length_m: Lengths
) -> SubTrajectoryRows:
    """Return the decimated sub-trajectories of a condition."""
    every = every_nth(len(sub_trajectories.starts), DETAIL_ROWS)
    shown = sub_trajectories.where(slice(None, None, every))
    starts, ends = shown.starts, shown.ends
    directions = shown.by_direction()
    others: dict[str, Values] = {}
    for kind in error_figures(has_height=True):
        if kind.name not in NAMED_ERRORS:
            others |= named_columns(kind.name, errors_of(kind, shown))
    return SubTrajectoryRows(
        condition=condition,
        every=every,
        start_frame=tuple(starts.tolist()),
        end_frame=tuple(ends.tolist()),
        start_stamp_ns=tuple(stamps_ns[starts].tolist()),
        end_stamp_ns=tuple(stamps_ns[ends].tolist()),
        x_m=column(directions["x"]),
        y_m=column(directions["y"]),
        z_m=column(directions["z"]),
        attitude_deg=column(shown.errors.attitude_deg),
        heading_deg=column(shown.errors.heading_deg),
        chord_m=column(other_formulas.chord_error(shown.poses, starts, ends)),
        along_m=column(directions["along"]),
        cross_m=column(directions["cross"]),
        travelled_m=column(length_m[ends] - length_m[starts]),
        others=others,
    )


def path_rows(estimates: Estimates, frames: Frames, length_m: Lengths) -> PathRows:
    """Return the decimated frames of a trajectory."""
    every = every_nth(len(length_m), PATH_ROWS)
    shown = slice(None, None, every)
    sigma: dict[str, Values] = {}
    if estimates.covariance is not None:
        variances = estimates.covariance[frames.estimate_rows[shown]][:, POSITION_VARIANCES]
        deviations = np.sqrt(np.where(variances >= 0.0, variances, np.nan))
        if np.isfinite(deviations).any():
            sigma = {f"sigma_{axis}_m": column(values) for axis, values in zip("xyz", deviations.T, strict=True)}
    truth_x, truth_y, truth_z = (column(values) for values in frames.true_position[shown].T)
    estimate_x, estimate_y, estimate_z = (column(values) for values in frames.position[shown].T)
    return PathRows(
        every=every,
        stamp_ns=tuple(frames.stamps_ns[shown].tolist()),
        travelled_m=column(length_m[shown]),
        truth_x_m=truth_x,
        truth_y_m=truth_y,
        truth_z_m=truth_z,
        estimate_x_m=estimate_x,
        estimate_y_m=estimate_y,
        estimate_z_m=estimate_z,
        lost=tuple(estimates.lost[frames.estimate_rows[shown]].tolist()),
        degraded=tuple(estimates.degraded[frames.estimate_rows[shown]].tolist()),
        **sigma,
    )

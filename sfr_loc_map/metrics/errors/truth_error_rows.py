"""The rows of the error of the ground truth (`frames.truth_error`).

A verdict whose margin is within this error is `not enough data` (`metrics.judging.judge`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.metrics.figures.row_part import ATTITUDE, TURN
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.frames.truth_error import (
    attitude_interpolation_errors,
    interpolation_errors,
    root_mean_square,
    truth_noise,
)


def truth_error_rows(truth: Truth, frames_ns: IntArray) -> Iterator[Figure]:
    """Yield the error of a ground truth at frames: total position error, its contributions, and attitude error.

    The rows have standard deviations in m and deg. All are 0 for a truth that is assumed to be exact at every frame.
    """
    parts = {
        "interpolation": root_mean_square(interpolation_errors(truth, frames_ns)),
        "noise": float(np.sqrt(3.0)) * truth.sigma_m,
        "lever arm": float(np.linalg.norm(truth.lever_arm_m)) * float(np.radians(truth.sigma_deg)),
    }
    yield figure_row("truth_error", n=len(frames_ns), value=float(np.linalg.norm(list(parts.values()))))
    for name, value in parts.items():
        yield figure_row("truth_error", part=name, value=value)
    noise_deg = float(np.sqrt(3.0)) * truth.sigma_deg
    interpolation_deg = root_mean_square(attitude_interpolation_errors(truth, frames_ns))
    yield figure_row("truth_error", part=ATTITUDE, value=float(np.hypot(noise_deg, interpolation_deg)))


def turn_rows(condition: str, truth: Truth, starts_ns: IntArray, moves: FloatArray) -> Iterator[Figure]:
    """Yield the position error at N+x that an error of the true attitude at N causes by rotating the re-based estimate.

    The value is the standard deviation of the error vector in m, over sub-trajectories with the true displacements
    `moves` `(M, 3)`. `starts_ns` `(M,)` are the stamps of N, or are empty without interpolation. Unknown heights are
    ignored. There is no row if the true attitude is assumed to be exact.
    """
    if not len(moves):
        return
    lengths_m = np.sqrt(np.nansum(np.square(moves), axis=1))
    of_noise_m = of_interpolation_m = 0.0
    if truth.sigma_deg:
        covariance = truth_noise((0.0, truth.sigma_deg), np.array([root_mean_square(lengths_m), 0.0, 0.0]))
        of_noise_m = float(np.sqrt(np.trace(covariance[:3, :3])))
    if len(starts_ns):
        of_interpolation_m = root_mean_square(np.radians(attitude_interpolation_errors(truth, starts_ns)) * lengths_m)
    if of_noise_m or of_interpolation_m:
        yield figure_row("truth_error", condition, TURN, value=float(np.hypot(of_noise_m, of_interpolation_m)))

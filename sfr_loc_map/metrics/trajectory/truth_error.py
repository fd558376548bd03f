"""The error of the ground truth at frames, from interpolation and declared noise, and its rows of the table of figures.

A verdict whose margin is within this error is `not enough data` (`metrics.judging.judge`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_multiply, rotvecs_from_quats, unit_quats
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.figures.row_part import ATTITUDE, TURN
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.frames.association import unique_rows


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


# ---- the error at frames


def root_mean_square(values: FloatArray) -> float:
    """Return the root mean square of values, 0 without values."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def truth_noise(sigmas: tuple[float, float], move: FloatArray) -> FloatArray:
    """Return the covariance of position and attitude at N+x that the noise of the truth at N and N+x causes.

    `sigmas` are in m and deg. The noise of the attitude at N rotates the displacement `move`.
    """
    of_position, of_attitude = sigmas[0] ** 2, np.radians(sigmas[1]) ** 2
    at_ends = np.diag([2.0 * of_position] * 3 + [of_attitude] * 3)
    at_start = np.diag([0.0] * 3 + [of_attitude] * 3)
    return np.asarray(at_ends + propagated_covariance(at_start, move))


def interpolation_errors(truth: Trajectory, frames_ns: IntArray) -> FloatArray:
    """Return the error `(F,)` of the linear interpolation of positions at frames, m; 0 at the poses of the truth."""
    rows = unique_rows(truth.stamps_ns)
    steps = np.diff(truth.positions[rows], axis=0)
    return errors_between(truth.stamps_ns[rows], steps, frames_ns)


def attitude_interpolation_errors(truth: Truth, frames_ns: IntArray) -> FloatArray:
    """Return the error `(F,)` of the interpolation of attitudes by the shortest rotation at frames, deg.

    The error is 0 at the poses of the truth, and for a truth without attitudes. Without true roll and pitch, the error
    is that of the heading.
    """
    if not truth.has_attitude or not len(frames_ns):
        return np.zeros(len(frames_ns))
    rows = unique_rows(truth.stamps_ns)
    attitudes = unit_quats(truth.quats_xyzw[rows])
    if truth.has_tilt:
        steps_deg = np.degrees(rotvecs_from_quats(quat_multiply(quat_conjugate(attitudes[:-1]), attitudes[1:])))
    else:
        headings = formulas.heading(attitudes)
        steps_deg = formulas.heading_error_deg(headings[1:], headings[:-1])[:, None]
    return errors_between(truth.stamps_ns[rows], steps_deg, frames_ns)


def errors_between(stamps_ns: IntArray, steps: FloatArray, frames_ns: IntArray) -> FloatArray:
    """Return the error `(F,)` of linear interpolation at frames, in the unit of `steps`, from the curvature.

    `steps` `(T - 1, d)` are the differences of the values at successive stamps `(T,)`. At the fraction s of an interval
    of duration h, the error is `s (1 - s) h^2 |a| / 2` with the acceleration a (de Boor 1978, chapter III). The larger
    acceleration of both neighbouring values is used. The error is 0 at the stamps, and with fewer than three values.
    """
    if len(stamps_ns) < 3 or not len(frames_ns):
        return np.zeros(len(frames_ns))
    time_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
    at_s = (frames_ns - stamps_ns[0]) / NS_PER_S
    velocity = steps / np.diff(time_s)[:, None]
    between_s = 0.5 * (time_s[2:] - time_s[:-2])
    inner = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / between_s
    acceleration = np.concatenate([inner[:1], inner, inner[-1:]])
    after = np.clip(np.searchsorted(time_s, at_s, "left"), 1, len(time_s) - 1)
    apart_s = time_s[after] - time_s[after - 1]
    share = np.clip((at_s - time_s[after - 1]) / apart_s, 0.0, 1.0)
    largest = np.maximum(acceleration[after - 1], acceleration[after])
    return np.asarray(0.5 * share * (1.0 - share) * np.square(apart_s) * largest)

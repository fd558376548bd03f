"""Other estimates of a drive, such as wheel odometry: scale of the forward run, and sigma of three estimates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.agreement import MIN_SUB_TRAJECTORIES
from sfr_loc_map.evidence.localiser_runs import ComparedRun, name_of_comparison
from sfr_loc_map.evidence.paired_runs import RunAtPairs, count_without_overlap, paired, sub_trajectories_of
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.frames.association import Estimates, StampedPoses, associate
from sfr_loc_map.metrics.statistics.intervals import student_quantile
from sfr_loc_map.metrics.trajectory.consistency import relative_errors

IDENTICAL = 1e-6
"""Largest difference of the motions of identical estimates, m and rad. Files round poses to less."""


def at_pairs_of(run: ComparedRun, other: ComparedRun) -> ComparedRun:
    """Return another estimate at the pairs of a run, interpolated between its poses if its stamps differ.

    InputError if the estimate has only positions, or fewer than two poses at the pairs of the run.
    """
    ours, theirs = run.estimates.trajectory, other.estimates.trajectory
    if not theirs.has_attitude:
        raise InputError(f"the estimate {other.name} has only positions: give an estimate with orientations")
    config = AssociationConfig()
    frames, _ = associate(ours, theirs, config)  # the other estimate takes the place of the ground truth
    if len(frames.stamps_ns) < 2:
        spans = [f"{poses.stamps_ns.min()} ns to {poses.stamps_ns.max()} ns" for poses in (theirs, ours)]
        raise InputError(
            f"the estimate {other.name} has fewer than two poses at the stamps of the drive: the estimate covers "
            f"{spans[0]}, the drive covers {spans[1]}; give an estimate with stamps of the same clock and "
            f"without gaps above {config.max_gap_s:g} s"
        )
    poses = Trajectory(ours.stamps_ns[frames.estimate_rows], frames.true_position, frames.true_attitude)
    return ComparedRun(other.name, Estimates.of(poses))


def check_different(first: ComparedRun, other: ComparedRun) -> None:
    """Raise InputError if two estimates have the same motions, so that their agreement is not evidence."""
    runs = paired(first, other)
    later = np.arange(1, len(runs.ours.rows))
    if len(later) and np.abs(runs.errors(np.zeros_like(later), later)).max() < IDENTICAL:
        raise InputError(
            f"the estimate {other.name} has the same poses as the estimate '{first.name}': give an estimate of another "
            "method"
        )


def scale_row(first: ComparedRun, other: ComparedRun, condition: Condition) -> Figure:
    """Return the relative excess length of the first run over the other run, with its 95 % interval.

    The interval assumes that sub-trajectories that do not overlap are independent. If the other run is wheel
    odometry without slip, the scale error is that of the ratio of baseline and focal length.
    """
    runs = paired(first, other)
    starts, ends = sub_trajectories_of(runs.ours.poses, condition)
    moves = [run.poses.position[ends] - run.poses.position[starts] for run in runs]
    lengths_m = np.stack([np.linalg.norm(move, axis=1) for move in moves], axis=1)
    known = lengths_m[(lengths_m > 0.0).all(axis=1)]
    where = (condition.setting, name_of_comparison(first.name, other.name))
    count = len(known)
    independent = float(min(count_without_overlap(starts, ends), count))
    if independent < MIN_SUB_TRAJECTORIES:
        return figure_row("scale", *where, n=count, independent=independent)
    scales = known[:, 0] / known[:, 1] - 1.0
    mean, sigma = float(np.mean(scales)), float(np.std(scales, ddof=1))
    half = student_quantile(0.975, independent - 1.0) * sigma / np.sqrt(independent)
    bounds = {"low95": mean - half, "high95": mean + half}
    return figure_row("scale", *where, n=count, independent=independent, value=mean, **bounds)


def hat_rows(runs: Sequence[ComparedRun], condition: Condition) -> list[Figure]:
    """Return the sigma of each of three estimates by the three-cornered hat; no rows for another number of runs.

    The sigmas are undefined if there are fewer than three non-overlapping sub-trajectories.
    """
    if len(runs) != 3:
        return []
    first, second, third = at_common_pairs(*runs)
    starts, ends = sub_trajectories_of(first, condition)
    pairs = ((first, second), (first, third), (second, third))
    differences = [relative_errors(one, other, starts, ends)[:, :3] for one, other in pairs]
    independent = count_without_overlap(starts, ends)
    sigmas = three_cornered_hat(*differences) if independent >= MIN_SUB_TRAJECTORIES else None
    values = (None, None, None) if sigmas is None else sigmas
    return [
        figure_row("hat_sigma", condition.setting, run.name, n=len(starts), independent=independent, value=value)
        for run, value in zip(runs, values, strict=True)
    ]


def at_common_pairs(first: ComparedRun, second: ComparedRun, third: ComparedRun) -> tuple[StampedPoses, ...]:
    """Return the poses of a forward run and of two other runs at the pairs that all three have.

    The variances of the differences determine those of the runs only if all differences are of the same sample.
    """
    ours, of_second = paired(first, second)
    also_ours, of_third = paired(first, third)
    _, with_second, with_third = np.intersect1d(ours.rows, also_ours.rows, return_indices=True)
    return (poses_of(ours, with_second), poses_of(of_second, with_second), poses_of(of_third, with_third))


def poses_of(run: RunAtPairs, frames: IntArray) -> StampedPoses:
    """Return the poses of a run at frames."""
    poses = run.poses
    return StampedPoses(poses.stamps_ns[frames], poses.position[frames], poses.attitude[frames])


def three_cornered_hat(a_b: FloatArray, a_c: FloatArray, b_c: FloatArray) -> tuple[float, float, float] | None:
    """Return the sigma, m, of the estimates A, B and C from their differences `(n, 3)`, m: A - B, A - C and B - C.

    The square of a sigma is the sum of the variances along the three axes. The method requires independent errors;
    errors that all three estimates share are not observable. None if an estimated variance is negative, which can
    happen by chance for few values.
    """
    ab, ac, bc = (float(np.sum(np.var(values, axis=0, ddof=1))) for values in (a_b, a_c, b_c))
    variances = 0.5 * np.array([ab + ac - bc, ab + bc - ac, ac + bc - ab])
    if (variances < 0.0).any():
        return None
    first, second, third = np.sqrt(variances).tolist()
    return first, second, third

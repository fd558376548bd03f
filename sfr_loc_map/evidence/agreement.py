"""Agreement of two runs with the prediction of their covariances: NEES of the difference over sub-trajectories.

Both runs share the calibration. A wrong baseline, focal length or mounting moves both equally and is unobservable. The
predicted covariance `Q_a + Q_b` therefore contains the steps and the noise of the poses, without systematic errors.
Runs that share images have common noise, so that their difference is smaller than predicted. Only a difference that is
too large is a finding. At least one of the runs has an error of at least half of the difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from sfr_loc_map.evidence.variants import Run
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.association import Frames, associate
from sfr_loc_map.metrics.config import AssociationConfig, Condition
from sfr_loc_map.metrics.consistency import (
    StepSums,
    normalised_square,
    relative_covariance,
    relative_errors,
    sums_of_steps,
)
from sfr_loc_map.metrics.intervals import chi2_interval95, student_quantile
from sfr_loc_map.metrics.table import Figure, figure_row
from sfr_loc_map.metrics.trajectory_errors import select

SIGNIFICANCE = 0.05  #: Probability of a false finding over all comparisons of a recording.
MIN_WINDOWS = 3  #: Minimum number of sub-trajectories.
DEGREES = 6  #: Degrees of freedom of a pose error.
PLACES = "revisited places"  #: Label of a comparison without a condition.
SPACING = 5  #: Frames between starts. Half of the spacing of a score, for short recordings.


class CheckResult(StrEnum):
    """Result of runs without a truth. It never shows that a limit is met."""

    CONSISTENT = "consistent"
    INCONSISTENT = "inconsistent"
    NOT_ENOUGH_DATA = "not enough data"


class Windows(NamedTuple):
    """The differences of two runs over sub-trajectories, and their normalised squares where covariances are known."""

    position_m: FloatArray  #: `(n, 3)`
    attitude_deg: FloatArray  #: `(n,)`
    squares: FloatArray  #: `(m,)` of sub-trajectories that share no frame.
    lengths_m: FloatArray  #: `(n, 2)` straight-line distances of both runs.
    apart: int  #: Sub-trajectories that share no frame.
    lost: int  #: Frames at which one of the runs was lost.


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """The comparison of two runs over one condition."""

    name: str
    condition: str | None  #: Condition of the sub-trajectories; None for paths between visits of a place.
    windows: Windows
    #: Probability of squares at least this large for consistent covariances; None for too few squares.
    probability: float | None


def compare(first: Run, other: Run, condition: Condition) -> Agreement:
    """Return the difference of two runs over the sub-trajectories of a condition; distances are of the first run."""
    moved = as_forward(other)
    frames, _ = associate(first.estimates.trajectory, moved, AssociationConfig(truth="match"))
    length_m = formulas.path_length_m(frames.position)
    starts, ends = select(condition, SPACING, frames._replace(true_position=frames.position), length_m)
    differences = relative_errors(frames, starts, ends)
    squares = np.array(squares_of(first, other, frames, starts, ends))
    rows_of_other = rows_at(other, frames.stamps_ns)
    lost = first.estimates.lost[frames.estimate_rows] | other.estimates.lost[rows_of_other]
    attitude_deg = np.degrees(np.linalg.norm(differences[:, 3:], axis=1))
    moves = (frames.position[ends] - frames.position[starts], frames.true_position[ends] - frames.true_position[starts])
    lengths_m = np.stack([np.linalg.norm(move, axis=1) for move in moves], axis=1)
    windows = Windows(
        differences[:, :3], attitude_deg, squares, lengths_m, count_apart(starts, ends), int(np.count_nonzero(lost))
    )
    probability = probability_of(squares) if len(squares) >= MIN_WINDOWS else None
    return Agreement(
        name=f"{first.name} - {other.name}", condition=condition.setting, windows=windows, probability=probability
    )


def probability_of(squares: FloatArray) -> float:
    """Return the probability that the sum of independent normalised squares is at least this large."""
    return float(gammaincc(0.5 * DEGREES * len(squares), 0.5 * squares.sum()))


def count_apart(starts: IntArray, ends: IntArray) -> int:
    """Return the number of sub-trajectories without a common frame, selected greedily from the first."""
    count = free_from = 0
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if start >= free_from:
            count, free_from = count + 1, end
    return count


def as_forward(run: Run) -> Trajectory:
    """Return the poses of a run at the stamps of the pairs, in forward order."""
    poses = run.estimates.trajectory
    if not run.is_backward:
        return poses
    return Trajectory(run.mirror_ns - poses.stamps_ns[::-1], poses.positions[::-1], poses.quats_xyzw[::-1])


def rows_at(run: Run, stamps_ns: IntArray) -> IntArray:
    """Return the rows of the estimates at the stamps of pairs."""
    return np.searchsorted(run.estimates.trajectory.stamps_ns, run.own_stamps(stamps_ns))


def squares_of(first: Run, other: Run, frames: Frames, starts: IntArray, ends: IntArray) -> list[float]:
    """Return the normalised squares of the differences over sub-trajectories that share no frame."""
    if first.estimates.steps is None or other.estimates.steps is None:
        return []
    compared = np.unique(np.concatenate((starts, ends)))
    sums = sums_of_steps(first.estimates, first.estimates.steps, frames.estimate_rows[compared])
    rows = rows_at(other, frames.stamps_ns)
    others = sums_of_steps(other.estimates, other.estimates.steps, rows[compared])
    turns = matrix_from_quat(frames.attitude) @ np.swapaxes(matrix_from_quat(frames.true_attitude), -1, -2)
    found, free_from = [], 0
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        between = slice(start, end + 1)
        if start < free_from or first.estimates.lost[frames.estimate_rows[between]].any():
            continue
        if other.estimates.lost[rows[between]].any():
            continue
        own = growth(sums[int(frames.estimate_rows[start])], sums[int(frames.estimate_rows[end])], frames.position[end])
        theirs = growth_of_other(other, others, rows, frames, start, end)
        if own is None or theirs is None:
            continue
        free_from = end
        turn = np.kron(np.eye(2), turns[start])
        error = relative_errors(frames, np.array([start]), np.array([end]))[0]
        found.append(normalised_square(error, own + turn @ theirs @ turn.T))
    return found


def growth(start: StepSums, end: StepSums, position: FloatArray) -> FloatArray | None:
    """Return the covariance of the end given the start, without the errors that all steps share."""
    none = np.zeros_like(start.systematic)
    return relative_covariance(start._replace(systematic=none), end._replace(systematic=none), position)


def growth_of_other(
    other: Run, sums: dict[int, StepSums], rows: IntArray, frames: Frames, start: int, end: int
) -> FloatArray | None:
    """Return the result of `growth` for the other run, in the axes of the other run.

    A backward run gives the covariance of the start given the end. The error of the end given the start is the
    negative of this error, propagated over the displacement.
    """
    if not other.is_backward:
        return growth(sums[int(rows[start])], sums[int(rows[end])], frames.true_position[end])
    reverse = growth(sums[int(rows[end])], sums[int(rows[start])], frames.true_position[start])
    if reverse is None:
        return None
    return propagated_covariance(reverse, frames.true_position[end] - frames.true_position[start])


# ---- results and rows of the tables


def result_of(agreements: Sequence[Agreement]) -> CheckResult:
    """Return the result over all comparisons (Bonferroni)."""
    known = [item.probability for item in agreements if item.probability is not None]
    if not known:
        return CheckResult.NOT_ENOUGH_DATA
    return CheckResult.INCONSISTENT if min(known) * len(known) < SIGNIFICANCE else CheckResult.CONSISTENT


def result_of_all(results: Iterable[CheckResult]) -> CheckResult:
    """Return the worst result of several checks."""
    found = set(results)
    worst_first = (CheckResult.INCONSISTENT, CheckResult.NOT_ENOUGH_DATA)
    return next((result for result in worst_first if result in found), CheckResult.CONSISTENT)


def agreement_rows(agreement: Agreement) -> list[Figure]:
    """Return the rows of the table of figures of a comparison."""
    windows, where = agreement.windows, (agreement.condition, agreement.name)
    position = formulas.statistics(windows.position_m)
    rows = [
        figure_row("difference", *where, statistics=position),
        figure_row("attitude_difference", *where, statistics=formulas.statistics(windows.attitude_deg)),
    ]
    count = len(windows.squares)
    low, high = chi2_interval95(DEGREES * count, count) if count else (None, None)
    mean = float(windows.squares.mean()) if count else None
    rows.append(figure_row("difference_nees", *where, n=count, mean=mean, low95=low, high95=high, value=DEGREES))
    least = None if position.rmse is None else 0.5 * position.rmse
    rows.append(figure_row("error_at_least", *where, n=position.n, value=least))
    rows.append(figure_row("agreement", *where, n=count, value=agreement.probability))
    return rows


def scale_row(agreement: Agreement) -> Figure:
    """Return the relative excess length of the first run over the other run, with its 95 % interval.

    The interval assumes that sub-trajectories without a common frame are independent. If the other run is wheel
    odometry without slip, the scale error is that of the ratio of baseline and focal length.
    """
    lengths_m = agreement.windows.lengths_m
    known = lengths_m[(lengths_m > 0.0).all(axis=1)]
    count = len(known)
    independent = float(min(agreement.windows.apart, count))
    if independent < MIN_WINDOWS:
        return figure_row("scale", agreement.condition, agreement.name, n=count)
    scales = known[:, 0] / known[:, 1] - 1.0
    mean, sigma = float(np.mean(scales)), float(np.std(scales, ddof=1))
    half = student_quantile(0.975, independent - 1.0) * sigma / np.sqrt(independent)
    bounds = {"low95": mean - half, "high95": mean + half}
    return figure_row("scale", agreement.condition, agreement.name, "", None, n=count, value=mean, **bounds)


def three_cornered_hat(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[float, float, float] | None:
    """Return the sigma of each of three estimates from the differences `(n, 3)` of their errors: a - b, a - c, b - c.

    The method requires independent errors; errors that all three share stay hidden. None if an estimated variance is
    negative, which can happen by chance for few values.
    """
    ab, ac, bc = (float(np.sum(np.var(values, axis=0, ddof=1))) for values in (a, b, c))
    variances = 0.5 * np.array([ab + ac - bc, ab + bc - ac, ac + bc - ab])
    if (variances < 0.0).any():
        return None
    first, second, third = np.sqrt(variances).tolist()
    return first, second, third

"""Agreement of two runs with the prediction of their covariances: NEES of the difference over sub-trajectories.

Both runs share the calibration. A wrong baseline, focal length or mounting moves both equally and is unobservable. The
predicted covariance `Q_a + Q_b` therefore contains the steps and the noise of the poses, without systematic errors.
Runs that share images have common noise, so that their difference is smaller than predicted. Only a difference that is
too large is a finding. At least one of the runs has an error of at least half of the difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from sfr_loc_map.evidence.check_result import CheckResult
from sfr_loc_map.evidence.item_rows import items_with
from sfr_loc_map.evidence.variants import Run
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.association import Frames, associate
from sfr_loc_map.metrics.config import AssociationConfig, Condition, label_of
from sfr_loc_map.metrics.consistency import (
    StepSums,
    normalised_square,
    relative_covariance,
    relative_errors,
    sums_of_steps,
)
from sfr_loc_map.metrics.intervals import chi2_interval95
from sfr_loc_map.metrics.table import Figure, figure_row
from sfr_loc_map.metrics.trajectory_errors import select
from sfr_loc_map.report.tables import METRE, Cell, Column, Table, fitting

SIGNIFICANCE = 0.05  #: Probability of a false finding over all comparisons of a recording.
MIN_SUB_TRAJECTORIES = 3  #: Minimum number of sub-trajectories that share no frame.
DEGREES = 6  #: Degrees of freedom of a pose error.
PLACES = "revisited places"  #: Label of a comparison without a condition.
SPACING = 5  #: Frames between starts. Half of the spacing of a score, for short recordings.
Span = tuple[int, int]  #: First and last frame of a sub-trajectory.


class Differences(NamedTuple):
    """Differences of two runs over sub-trajectories, and their normalised squares where covariances are known."""

    position_m: FloatArray  #: `(n, 3)`
    attitude_deg: FloatArray  #: `(n,)`
    squares: FloatArray  #: `(m,)` of sub-trajectories that share no frame.
    lengths_m: FloatArray  #: `(n, 2)` straight-line distances of both runs.
    independent: int  #: Number of sub-trajectories that share no frame.


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """The comparison of two runs over one condition."""

    name: str
    condition: str | None  #: Condition of the sub-trajectories; None for paths between visits of a place.
    differences: Differences
    #: Probability of squares at least this large for consistent covariances; None for too few squares.
    probability: float | None


def compare(first: Run, other: Run, condition: Condition) -> Agreement:
    """Return the comparison of two runs over the sub-trajectories of a condition; distances are of the first run.

    `Frames` pair estimates with true poses. Here the poses of the other run take the place of the true poses.
    """
    frames, _ = associate(first.estimates.trajectory, as_forward(other), AssociationConfig(truth="match"))
    of_first = frames._replace(true_position=frames.position)  # because `select` measures the true distances
    starts, ends = select(condition, SPACING, of_first, formulas.path_length_m(frames.position))
    errors = relative_errors(frames, starts, ends)
    squares = np.array(squares_of(first, other, frames, starts, ends))
    moves = (frames.position[ends] - frames.position[starts], frames.true_position[ends] - frames.true_position[starts])
    differences = Differences(
        position_m=errors[:, :3],
        attitude_deg=np.degrees(np.linalg.norm(errors[:, 3:], axis=1)),
        squares=squares,
        lengths_m=np.stack([np.linalg.norm(move, axis=1) for move in moves], axis=1),
        independent=len(list(without_common_frame(spans_of(starts, ends)))),
    )
    return Agreement(
        name=f"{first.name} - {other.name}",
        condition=condition.setting,
        differences=differences,
        probability=probability_of(squares) if len(squares) >= MIN_SUB_TRAJECTORIES else None,
    )


def probability_of(squares: FloatArray) -> float:
    """Return the probability that the sum of independent normalised squares is at least this large."""
    return float(gammaincc(0.5 * DEGREES * len(squares), 0.5 * squares.sum()))


def spans_of(starts: IntArray, ends: IntArray) -> list[Span]:
    """Return sub-trajectories as pairs of frames."""
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def without_common_frame(spans: Iterable[Span]) -> Iterator[Span]:
    """Yield the sub-trajectories that share no frame but an end, selected greedily from the first."""
    free_from = 0
    for start, end in spans:
        if start >= free_from:
            yield start, end
            free_from = end


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
    """Return the normalised squares of the differences over sub-trajectories that share no frame.

    Sub-trajectories with a lost pose or an unknown covariance are skipped.
    """
    if first.estimates.steps is None or other.estimates.steps is None:
        return []
    compared = np.unique(np.concatenate((starts, ends)))
    rows, rows_of_other = frames.estimate_rows, rows_at(other, frames.stamps_ns)
    sums = sums_of_steps(first.estimates, first.estimates.steps, rows[compared])
    sums_of_other = sums_of_steps(other.estimates, other.estimates.steps, rows_of_other[compared])
    lost = first.estimates.lost[rows] | other.estimates.lost[rows_of_other]
    turns = matrix_from_quat(frames.attitude) @ np.swapaxes(matrix_from_quat(frames.true_attitude), -1, -2)
    covariances: dict[Span, FloatArray] = {}
    for start, end in spans_of(starts, ends):
        if lost[start : end + 1].any():
            continue
        own = growth(sums[int(rows[start])], sums[int(rows[end])], frames.position[end])
        theirs = growth_of_other(other, sums_of_other, rows_of_other, frames, start, end)
        if own is not None and theirs is not None:
            turn = np.kron(np.eye(2), turns[start])
            covariances[start, end] = own + turn @ theirs @ turn.T
    return [
        normalised_square(relative_errors(frames, np.array([start]), np.array([end]))[0], covariances[start, end])
        for start, end in without_common_frame(covariances)
    ]


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


# ---- result, figures and table


def result_of(agreements: Sequence[Agreement]) -> CheckResult:
    """Return the result over all comparisons (Bonferroni)."""
    known = [item.probability for item in agreements if item.probability is not None]
    if not known:
        return CheckResult.NOT_ENOUGH_DATA
    return CheckResult.INCONSISTENT if min(known) * len(known) < SIGNIFICANCE else CheckResult.CONSISTENT


def disagreement_of(agreements: Sequence[Agreement]) -> str:
    """Return the description of the least probable difference."""
    known = [(item.probability, item) for item in agreements if item.probability is not None]
    probability, worst = min(known, key=lambda item: item[0])
    over = worst.condition or PLACES
    return f"{worst.name} over {over} differ by more than their covariances predict (p {probability:.2g})"


def agreement_rows(agreement: Agreement) -> list[Figure]:
    """Return the rows of the table of figures of a comparison."""
    differences, where = agreement.differences, (agreement.condition, agreement.name)
    position = formulas.statistics(differences.position_m)
    attitude = formulas.statistics(differences.attitude_deg)
    count = len(differences.squares)
    low, high = chi2_interval95(DEGREES * count, count) if count else (None, None)
    mean = float(differences.squares.mean()) if count else None
    least = None if position.rmse is None else 0.5 * position.rmse
    return [
        figure_row("difference", *where, statistics=position),
        figure_row("attitude_difference", *where, statistics=attitude),
        figure_row("difference_nees", *where, n=count, mean=mean, low95=low, high95=high, value=DEGREES),
        figure_row("error_at_least", *where, n=position.n, value=least),
        figure_row("agreement", *where, n=count, value=agreement.probability),
    ]


def agreement_table(figures: Sequence[Figure]) -> Table:
    """Return the comparisons as a table, one line each."""
    rows = []
    for item in items_with("difference", figures):
        unit = fitting(METRE, item.number("difference", "rmse"), item.number("error_at_least"))
        rows.append(
            (
                Cell.head(item.part or ""),
                Cell(label_of(item.condition) or PLACES),
                Cell(unit.symbol),
                item.cell("difference", "rmse", unit),
                item.cell("error_at_least", unit=unit),
                item.cell("difference", "n"),
                item.cell("difference_nees", "mean"),
                item.cell("difference_nees", "high95"),
                item.cell("difference_nees", "n"),
                item.cell("agreement"),
            )
        )
    columns = (
        Column("runs", words=True),
        Column("over", words=True),
        Column("unit"),
        Column("difference, rmse"),
        Column("minimum error of a run"),
        Column("n"),
        Column("NEES"),
        Column("expected below"),
        Column("independent"),
        Column("p"),
    )
    note = (
        "At least one of the runs has at least the minimum error. NEES: squared difference normalised by the "
        "covariances of both runs, over the independent sub-trajectories; 6 on average if the covariances are correct. "
        "p: probability of a difference this large if the covariances are correct. Errors that both runs share are not "
        "included: a wrong calibration is unobservable, and the noise of common images reduces the difference."
    )
    return Table("check", "Runs that should agree", columns, tuple(rows), note)

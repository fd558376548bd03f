"""Agreement of two runs with the prediction of their covariances: NEES of the difference over sub-trajectories.

Both runs share the calibration. A wrong baseline, focal length or mounting moves both equally and is unobservable. The
predicted covariance `Q_a + Q_b` therefore contains the steps and the noise of the poses, without systematic errors.
Runs that share images have common noise, so their difference is smaller than predicted. Only a difference that is
too large is a finding. At least one of the runs has an error of at least half of the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from sfr_loc_map.evidence.check_result import CheckResult
from sfr_loc_map.evidence.paired_runs import SPACING, RunAtPairs, paired, spans_of
from sfr_loc_map.evidence.variants import ComparedRun
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.config import Condition
from sfr_loc_map.metrics.errors.consistency import Span, normalised_square, relative_errors, without_overlap
from sfr_loc_map.metrics.errors.trajectory_errors import select
from sfr_loc_map.metrics.table.catalogue import REVISITED_PLACES
from sfr_loc_map.metrics.table.rows import Figure, figure_row, nees_row

SIGNIFICANCE = 0.05  #: Probability of a false finding over all comparisons of a recording.
MIN_SUB_TRAJECTORIES = 3  #: Minimum number of sub-trajectories that do not overlap.
DEGREES = 6  #: Degrees of freedom of a pose error.


class Differences(NamedTuple):
    """Differences of two runs over sub-trajectories, and their normalised squares where covariances are known."""

    position_m: FloatArray  #: `(n, 3)`
    attitude_deg: FloatArray  #: `(n,)`
    squares: FloatArray  #: `(m,)` of sub-trajectories that do not overlap.
    lengths_m: FloatArray  #: `(n, 2)` straight-line distances of both runs.
    independent: int  #: Number of sub-trajectories that do not overlap.


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """The comparison of two runs over one condition."""

    name: str
    condition: str | None  #: Condition of the sub-trajectories; None for paths between visits of a place.
    differences: Differences
    #: Probability of squares at least this large for consistent covariances; None for too few squares.
    probability: float | None


def compare(first: ComparedRun, other: ComparedRun, condition: Condition) -> Agreement:
    """Return the comparison of a forward run with another run over the sub-trajectories of a condition.

    The motion of the first run ends the sub-trajectories.
    """
    ours, theirs = paired(first, other)
    starts, ends = select(condition, SPACING, ours.poses, formulas.path_length_m(ours.poses.position))
    errors = relative_errors(ours.poses, theirs.poses, starts, ends)
    squares = np.array(squares_of(ours, theirs, starts, ends))
    moves = [run.poses.position[ends] - run.poses.position[starts] for run in (ours, theirs)]
    differences = Differences(
        position_m=errors[:, :3],
        attitude_deg=np.degrees(np.linalg.norm(errors[:, 3:], axis=1)),
        squares=squares,
        lengths_m=np.stack([np.linalg.norm(move, axis=1) for move in moves], axis=1),
        independent=len(list(without_overlap(spans_of(starts, ends)))),
    )
    return Agreement(
        name=f"{first.name} - {other.name}",
        condition=condition.setting,
        differences=differences,
        probability=probability_of(squares) if len(squares) >= MIN_SUB_TRAJECTORIES else None,
    )


def squares_of(ours: RunAtPairs, theirs: RunAtPairs, starts: IntArray, ends: IntArray) -> list[float]:
    """Return the normalised squares of the differences over sub-trajectories that do not overlap.

    Sub-trajectories with a lost pose, or with a covariance that is unknown or not usable, are skipped.
    """
    compared = np.unique(np.concatenate((starts, ends)))
    our_sums, their_sums = ours.sums_at(compared), theirs.sums_at(compared)
    if not our_sums or not their_sums:
        return []
    is_lost = ours.lost | theirs.lost
    turns = matrix_from_quat(ours.poses.attitude) @ np.swapaxes(matrix_from_quat(theirs.poses.attitude), -1, -2)
    covariances: dict[Span, FloatArray] = {}
    for start, end in spans_of(starts, ends):
        if is_lost[start : end + 1].any():
            continue
        our_covariance = ours.covariance_between(our_sums, start, end)
        their_covariance = theirs.covariance_between(their_sums, start, end)
        if our_covariance is not None and their_covariance is not None:
            turn = np.kron(np.eye(2), turns[start])  # from the axes of the other run to those of our run
            covariances[start, end] = our_covariance + turn @ their_covariance @ turn.T
    squares = []
    for start, end in without_overlap(covariances):
        (difference,) = relative_errors(ours.poses, theirs.poses, np.array([start]), np.array([end]))
        squares.append(normalised_square(difference, covariances[start, end]))
    return [square for square in squares if square is not None]


def probability_of(squares: FloatArray) -> float:
    """Return the probability that the sum of independent normalised squares is at least this large."""
    return float(gammaincc(0.5 * DEGREES * len(squares), 0.5 * squares.sum()))


# ---- result and figures


def results_of(agreements: Sequence[Agreement]) -> tuple[CheckResult, ...]:
    """Return the result of each comparison. The significance is divided by the number of comparisons (Bonferroni)."""
    known = sum(item.probability is not None for item in agreements)
    results = []
    for item in agreements:
        if item.probability is None:
            results.append(CheckResult.NOT_ENOUGH_DATA)
        elif item.probability * known < SIGNIFICANCE:
            results.append(CheckResult.INCONSISTENT)
        else:
            results.append(CheckResult.CONSISTENT)
    return tuple(results)


def disagreement_of(agreements: Sequence[Agreement]) -> str:
    """Return the description of the least probable difference."""
    known = [(item.probability, item) for item in agreements if item.probability is not None]
    probability, worst = min(known, key=lambda item: item[0])
    over = worst.condition or REVISITED_PLACES
    runs = " and ".join(f"'{name}'" for name in worst.name.split(" - "))
    return (
        f"the runs {runs} differ over {over} by more than their covariances predict (probability {probability:.2g} if "
        "the covariances are correct): see docs/check.md"
    )


def agreement_rows(agreement: Agreement) -> list[Figure]:
    """Return the rows of the table of figures of a comparison."""
    differences, where = agreement.differences, (agreement.condition, agreement.name)
    position = formulas.statistics(differences.position_m)
    attitude = formulas.statistics(differences.attitude_deg)
    least = None if position.rmse is None else 0.5 * position.rmse
    return [
        figure_row("difference", *where, statistics=position),
        figure_row("attitude_difference", *where, statistics=attitude),
        nees_row("difference_nees", differences.squares, DEGREES, *where),
        figure_row("error_at_least", *where, n=position.n, value=least),
        figure_row("agreement", *where, n=len(differences.squares), value=agreement.probability),
    ]

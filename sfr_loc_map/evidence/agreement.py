"""Agreement of two runs with the prediction of their covariances: NEES of the difference over sub-trajectories.

Both runs share the calibration. A wrong baseline, focal length or mounting moves both runs equally and is unobservable.
The predicted covariance `Q_a + Q_b` therefore consists of the covariance of the steps and the noise of the poses, and
excludes systematic errors. Runs that share images have common noise, so their difference is smaller than predicted.
Only a difference that is too large is a finding. At least one of the runs then has an error of at least half of the
difference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc

from sfr_loc_map.evidence.localiser_runs import AT_REVISITED_PLACES, ComparedRun, name_of_comparison
from sfr_loc_map.evidence.paired_runs import count_without_overlap, paired, sub_trajectories_of
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.catalogue import REVISITED_PLACES
from sfr_loc_map.metrics.figures.rows import Figure, figure_row, nees_row

MIN_SUB_TRAJECTORIES = 3  #: Minimum number of sub-trajectories that do not overlap.
DEGREES = 6  #: Degrees of freedom of a pose error.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Agreement:
    """The differences of two runs over the sub-trajectories of one condition, or at revisited places."""

    runs: tuple[str, str]  #: Names of the runs.
    condition: str | None  #: Condition of the sub-trajectories; None at revisited places.
    position_m: FloatArray  #: `(n, 3)` differences of the positions.
    attitude_deg: FloatArray  #: `(n,)` differences of the attitudes.
    squares: FloatArray  #: `(m,)` normalised squares where covariances are known, of independent sub-trajectories.
    independent: int  #: Number of sub-trajectories that do not overlap, or of revisited places.

    @property
    def name(self) -> str:
        """Name of the comparison in the table of figures."""
        return name_of_comparison(*self.runs)

    @property
    def is_of_revisited_places(self) -> bool:
        """Whether the differences are misclosures at revisited places; otherwise they are over sub-trajectories."""
        return self.name == AT_REVISITED_PLACES

    @property
    def over(self) -> str:
        """What the differences are computed over, in words."""
        return REVISITED_PLACES if self.is_of_revisited_places else self.condition or ""

    @property
    def probability(self) -> float | None:
        """Probability of squares at least this large for consistent covariances; None for too few squares.

        One revisited place suffices, because the distribution of its NEES is known.
        """
        count = len(self.squares)
        if count < (1 if self.is_of_revisited_places else MIN_SUB_TRAJECTORIES):
            return None
        return float(gammaincc(0.5 * DEGREES * count, 0.5 * float(self.squares.sum())))


def compare(first: ComparedRun, other: ComparedRun, condition: Condition) -> Agreement:
    """Return the comparison of two runs over the sub-trajectories of a condition; the first run is not backward.

    The path of the first run determines where the sub-trajectories start and end.
    """
    runs = paired(first, other)
    starts, ends = sub_trajectories_of(runs.ours.poses, condition)
    errors = runs.errors(starts, ends)
    return Agreement(
        runs=(first.name, other.name),
        condition=condition.setting,
        position_m=errors[:, :3],
        attitude_deg=np.degrees(np.linalg.norm(errors[:, 3:], axis=1)),
        squares=np.array(runs.squares(starts, ends)),
        independent=count_without_overlap(starts, ends),
    )


# ---- explanations and figures


def shortage_of(agreements: Sequence[Agreement]) -> str:
    """Return why no comparison has enough data."""
    is_revisited = any(item.is_of_revisited_places for item in agreements)
    most = max((item.independent for item in agreements), default=0)
    if not is_revisited and most < MIN_SUB_TRAJECTORIES:
        return "fewer than three sub-trajectories and no revisited place: give a shorter --condition"
    return (
        "too many sub-trajectories have a lost or degraded pose or no usable covariance: sfr localise --stats reports "
        "the state of each pose"
    )


def disagreement_of(agreements: Sequence[Agreement]) -> str:
    """Return the description of the least probable difference."""
    probabilities = [(item.probability, item) for item in agreements if item.probability is not None]
    known = [(probability, item) for probability, item in probabilities if math.isfinite(probability)]
    probability, worst = min(known, key=lambda item: item[0])
    first, other = worst.runs
    return (
        f"the runs '{first}' and '{other}' differ over {worst.over} by more than their covariances predict "
        f"(probability {probability:.2g} if the covariances are correct): see docs/check.md"
    )


def agreement_rows(agreement: Agreement) -> list[Figure]:
    """Return the figures of a comparison as rows of the table of figures."""
    where = (agreement.condition, agreement.name)
    position = formulas.statistics(agreement.position_m)
    attitude = formulas.statistics(agreement.attitude_deg)
    least = None if position.rmse is None else 0.5 * position.rmse
    return [
        figure_row("difference", *where, statistics=position),
        figure_row("attitude_difference", *where, statistics=attitude),
        nees_row("difference_nees", agreement.squares, DEGREES, *where),
        figure_row("error_at_least", *where, n=position.n, value=least),
        figure_row("agreement", *where, n=len(agreement.squares), value=agreement.probability),
    ]

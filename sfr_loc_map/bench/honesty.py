"""Does the localiser know how wrong it is: the error of each pose beside the standard deviation that it states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.localisation.estimate import PoseEstimate

LIMIT: Final = 5.0
"""Largest error over the stated 3 sigma that still counts as stated."""
CLAIMS: Final = ("initialising", "tracking")
"""States whose pose and covariance are to be believed."""


class Honesty(StrEnum):
    """What the localiser said of its errors on a drive."""

    SILENT = "silent"
    """A pair beyond the limit while it was called tracking."""
    SAID = "said"
    """Degraded or lost pairs, and none beyond the limit that was called tracking."""
    STATED = "stated"
    """All pairs tracking, all errors within the limit."""


@dataclass(frozen=True, slots=True)
class StatedErrors:
    """Errors over the stated 3 sigma on one drive; over pairs that are called tracking (or initialising).

    Attributes:
        tracking: Number of such pairs.
        degraded: Number of pairs whose state is degraded.
        lost: Number of pairs whose state is lost.
        position_ratio: Largest position error over its stated 3 sigma (the root of the trace of the covariance); None
            without such pairs.
        attitude_ratio: The same of the attitude.
        beyond_share: Share of such pairs with either beyond `LIMIT`; None without such pairs.
        largest_error_m: Largest position error of such pairs, metres.
    """

    tracking: int
    degraded: int
    lost: int
    position_ratio: float | None
    attitude_ratio: float | None
    beyond_share: float | None
    largest_error_m: float | None

    @property
    def worst(self) -> float:
        """The larger of both ratios; 0 without pairs."""
        return max(self.position_ratio or 0.0, self.attitude_ratio or 0.0)

    @property
    def honesty(self) -> Honesty:
        """What the localiser said of its errors."""
        if self.beyond_share:
            return Honesty.SILENT
        return Honesty.SAID if self.degraded + self.lost else Honesty.STATED


def stated_errors(estimates: Sequence[PoseEstimate], truth: Trajectory) -> StatedErrors:
    """Return how the errors of a drive compare with what is stated; pairs without truth of their stamp are left out.

    Args:
        estimates: One a pair, from a run that began at the truth's first pose.
        truth: True poses.
    """
    states = [str(estimate.state.value) for estimate in estimates]
    claimed = [estimate for estimate, state in zip(estimates, states, strict=True) if state in CLAIMS]
    errors, sigmas = error_and_sigma(claimed, truth)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(errors > 0.0, errors / (3.0 * sigmas), 0.0)
    any_pair = len(ratios) > 0
    return StatedErrors(
        tracking=len(claimed),
        degraded=states.count("degraded"),
        lost=states.count("lost"),
        position_ratio=float(ratios[:, 0].max()) if any_pair else None,
        attitude_ratio=float(ratios[:, 1].max()) if any_pair else None,
        beyond_share=float((ratios > LIMIT).any(axis=1).mean()) if any_pair else None,
        largest_error_m=float(errors[:, 0].max()) if any_pair else None,
    )


def error_and_sigma(estimates: Sequence[PoseEstimate], truth: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return errors and stated standard deviations `(N, 2)` of position (m) and attitude (rad) where there is truth."""
    at = {int(stamp): index for index, stamp in enumerate(truth.stamps_ns)}
    errors, sigmas = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for estimate in estimates:
        if estimate.stamp_ns not in at:
            continue
        true, found, covariance = truth.pose(at[estimate.stamp_ns]), estimate.T_ds_rb, estimate.covariance
        rotation = rotvec_from_matrix(found.rotation @ true.rotation.T)
        errors.append(np.array([[np.linalg.norm(found.translation - true.translation), np.linalg.norm(rotation)]]))
        sigmas.append(np.sqrt([[np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])]]))
    return np.concatenate(errors), np.concatenate(sigmas)

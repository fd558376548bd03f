"""Is the covariance honest? Normalised estimation error squared (NEES) of sub-trajectories.

The covariance that odometry publishes is of the pose since its start, so two poses of one run share most of it. What
happened between them is compared with Q, the covariance of the end given the start, from the covariances of the steps
between them (`relative_covariance`). Where these are not known, Q is what the published covariance grew by: with
`F = [[I, -[dp]x], [0, I]]`, dp the estimated displacement, an error of the start's pose moves the end by F, and the
growth is `Q = P_end - F P_start F^T`; it is not usable where the covariance shrank, as when a calibration was learnt.
If Q is honest, `e^T Q^-1 e` has a chi-square distribution with 6 degrees of freedom, e the error of position and
attitude (fixed axes of DS) over the sub-trajectory. Only sub-trajectories that share no frame are taken, so that n of
them are independent, and their mean lies between the 2.5 % and 97.5 % points of chi-square with 6 n degrees, over n,
in 95 % of all cases (Bar-Shalom, Li, Kirubarajan 2001, section 5.4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.constants import LOST_VARIANCE
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_multiply, quat_normalised, quat_rotate
from sfr_loc_map.geometry.transform import propagated_covariance
from sfr_loc_map.metrics.score import NeesPart, NeesScore
from sfr_loc_map.metrics.statistics.quantiles import chi2_quantile
from sfr_loc_map.metrics.trajectory.association import UPPER
from sfr_loc_map.metrics.trajectory.relative_covariance import relative_covariance

POSE, POSITION, ATTITUDE = slice(0, 6), slice(0, 3), slice(3, 6)
PARTS = (POSE, POSITION, ATTITUDE)


class PoseSample(NamedTuple):
    """A true and an estimated pose with the covariance of the estimate, or rows of them.

    Attributes:
        gt_pos: `(..., 3)` true position, metres, DS.
        gt_quat: `(..., 4)` true attitude, unit quaternion.
        est_pos: `(..., 3)` estimated position.
        est_quat: `(..., 4)` estimated attitude.
        covariance: `(..., 21)` upper triangle of the covariance, ROS order.
        sums: `(..., 43)` sums of the steps up to it; NaN where not known.
    """

    gt_pos: FloatArray
    gt_quat: FloatArray
    est_pos: FloatArray
    est_quat: FloatArray
    covariance: FloatArray
    sums: FloatArray

    def row(self, index: int) -> PoseSample:
        """Return one row."""
        return PoseSample(*(array[index] for array in self))


class Consistency:
    """Sums of the NEES over sub-trajectories, in constant memory.

    Attributes:
        free_from: Number of the first frame that no sub-trajectory has taken yet.
    """

    def __init__(self) -> None:
        self._totals = np.zeros(len(PARTS))
        self._count = self._from_steps = 0
        self._not_usable = 0
        self.free_from = 0

    def push(self, frames: tuple[int, int], start: PoseSample, end: PoseSample) -> None:
        """Add a sub-trajectory that starts at `free_from` or later.

        Args:
            frames: Numbers of its first and last frame.
            start: Poses at the start.
            end: Poses at the end.
        """
        covariances = [_matrix(start.covariance), _matrix(end.covariance)]
        known = [bool(np.isfinite(c).all() and np.diag(c).max() < LOST_VARIANCE) for c in covariances]
        if not all(known):
            return
        self.free_from = frames[1]
        growth = relative_covariance(start.sums, end.sums, end.est_pos)
        from_steps = growth is not None
        if growth is None:
            growth = covariance_growth(covariances[0], covariances[1], end.est_pos - start.est_pos)
        error = relative_error(start, end)
        try:
            squares = [_nees(error[part], growth[part, part]) for part in PARTS]
        except np.linalg.LinAlgError:
            self._not_usable += 1
            return
        self._count += 1
        self._from_steps += from_steps
        self._totals += squares

    def result(self) -> NeesScore | None:
        """Return the mean NEES and its interval; None where no covariance was known."""
        if not self._count and not self._not_usable:
            return None
        pose, position, attitude = (self._part(k, part.stop - part.start) for k, part in enumerate(PARTS))
        return NeesScore(
            count=self._count,
            not_usable=self._not_usable,
            from_steps=self._from_steps,
            pose=pose,
            position=position,
            attitude=attitude,
        )

    def _part(self, index: int, degrees: int) -> NeesPart:
        if not self._count:
            return NeesPart(mean=None, expected=float(degrees), interval95=None, consistent=None)
        mean = float(self._totals[index]) / self._count
        low, high = (chi2_quantile(p, degrees * self._count) / self._count for p in (0.025, 0.975))
        return NeesPart(mean=mean, expected=float(degrees), interval95=(low, high), consistent=low <= mean <= high)


def covariance_growth(start: FloatArray, end: FloatArray, displacement: FloatArray) -> FloatArray:
    """Return `Q = P_end - F P_start F^T` `(6, 6)`, see above."""
    growth = end - propagated_covariance(start, displacement)
    return np.asarray(0.5 * (growth + growth.T))


def relative_error(start: PoseSample, end: PoseSample) -> FloatArray:
    """Return the error `(6,)` of position (m) and attitude (rad) over a sub-trajectory, in the estimate's DS."""
    to_estimate = quat_multiply(start.est_quat, quat_conjugate(start.gt_quat))
    position = (end.est_pos - start.est_pos) - quat_rotate(to_estimate, end.gt_pos - start.gt_pos)
    turn = quat_normalised(quat_multiply(end.est_quat, quat_conjugate(quat_multiply(to_estimate, end.gt_quat))))
    turn = -turn if turn[3] < 0 else turn
    sine = np.sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2])
    scale = 2.0 if sine < 1e-9 else 2.0 * np.arctan2(sine, turn[3]) / sine
    return np.concatenate((position, scale * turn[:3]))


def _matrix(triangle: FloatArray) -> FloatArray:
    matrix = np.empty((6, 6))
    matrix[UPPER] = triangle
    matrix.T[UPPER] = triangle
    return matrix


def _nees(error: FloatArray, covariance: FloatArray) -> float:
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), error)
    return float(whitened @ whitened)

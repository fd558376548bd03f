"""Covariances of poses as upper triangles of 6 x 6 matrices in ROS order, and their propagation."""

from __future__ import annotations

from typing import Final

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE

UPPER = np.triu_indices(6)  #: Indices of the upper triangle of a 6 x 6 covariance, row by row.
COVARIANCE_SIZE = len(UPPER[0])
STEP_SIZE: Final = 48
"""Numbers of a step, the motion since the previous pose (`metrics.trajectory.consistency`): upper triangle of its
covariance, 6 errors that all steps share, and upper triangle of the noise of its pose."""
DIAGONAL = UPPER[0] == UPPER[1]  #: Mask of the variances in the upper triangle of a covariance.
POSITION_VARIANCES = np.flatnonzero(DIAGONAL & (UPPER[0] < 3))
"""Indices of the variances of x, y and z in the upper triangle."""


def symmetric(upper: FloatArray) -> FloatArray:
    """Return the symmetric matrices `(..., 6, 6)` of upper triangles `(..., 21)`."""
    full = np.empty((*upper.shape[:-1], 6, 6))
    full[..., UPPER[0], UPPER[1]] = full[..., UPPER[1], UPPER[0]] = upper
    return full


def step_variances(step: FloatArray) -> FloatArray:
    """Return the variances `(..., 12)` of steps `(..., 48)`: 6 of the motion and 6 of the pose noise."""
    motion, noise = step[..., :COVARIANCE_SIZE], step[..., -COVARIANCE_SIZE:]
    return np.concatenate((motion[..., DIAGONAL], noise[..., DIAGONAL]), axis=-1)


def check_variances(name: str, variances: FloatArray) -> None:
    """Raise ValueError if one of the variances of a field is negative; NaN is an unknown variance."""
    negative = variances[variances < 0.0]
    if len(negative):
        raise ValueError(f"a variance of '{name}' is {negative.min():g}: at least 0 is required")


def lost_by_covariance(covariance: FloatArray) -> Mask:
    """Return which covariances `(N, 21)` mark the pose as lost: all variances are at least 9999."""
    return np.asarray((covariance[:, DIAGONAL] >= LOST_VARIANCE).all(axis=1))


def propagated(jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return `F P F^T` for each pair of F and P."""
    return np.asarray(jacobian @ covariance @ np.swapaxes(jacobian, -1, -2))

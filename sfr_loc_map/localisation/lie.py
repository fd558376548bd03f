"""Small rotations inside machine code."""

from __future__ import annotations

import numpy as np
from numba import njit

from sfr_loc_map.geometry.rotation import FloatArray


@njit(cache=True)
def exp_so3(rotvec: FloatArray) -> FloatArray:
    """Return the rotation matrix `(3, 3)` of a rotation vector `(3,)`, radians (Rodrigues)."""
    angle = np.sqrt(rotvec[0] ** 2 + rotvec[1] ** 2 + rotvec[2] ** 2)
    skew = np.array([[0.0, -rotvec[2], rotvec[1]], [rotvec[2], 0.0, -rotvec[0]], [-rotvec[1], rotvec[0], 0.0]])
    if angle < 1e-8:
        return np.eye(3) + skew
    a = np.sin(angle) / angle
    b = (1.0 - np.cos(angle)) / (angle * angle)
    return np.eye(3) + a * skew + b * (skew @ skew)


@njit(cache=True)
def orthonormal(matrix: FloatArray) -> FloatArray:
    """Return the rotation nearest to an almost orthonormal `(3, 3)`: one Newton step of the polar decomposition."""
    return 1.5 * matrix - 0.5 * (matrix @ matrix.T @ matrix)

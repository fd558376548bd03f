"""Shift of the right image against the landmarks of the window: what a right camera that turns shows in each pair."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.small_linalg import fill_inverse_4, inverse
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates, StereoObservations, fill_covariance
from sfr_loc_map.localisation.projection import Projection, intrinsics, linearise_landmark, new_projection

UNKNOWNS = 7
"""Position and rotation of the left camera, shift of the right image."""
ROBUST_CHI2 = 4.0
"""Squared residual per degree of freedom at which the weight of a landmark has fallen to a quarter (Geman-McClure)."""


ENOUGH = 300
"""About as many landmarks are used: the error that a whole image has is larger than that of their mean."""


class RightShift(NamedTuple):
    """Shift of right positions along the rows at the image centre, as by a yaw of the right camera.

    Attributes:
        px: Pixels to the right, beyond the corrections that the landmarks were made with.
        variance: Of it, px^2, by the landmarks alone; infinite without enough of them.
    """

    px: float
    variance: float


class _Equations(NamedTuple):
    """Normal equations of pose and shift: information `(7, 7)`, right-hand side `(7,)`."""

    information: FloatArray
    rhs: FloatArray


class _Work(NamedTuple):
    """Workspaces of a landmark: covariance `(4, 4)` of its residual, inverse, residual `(4,)`, Jacobian `(4, 7)`."""

    covariance: FloatArray
    whitening: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    weighted: FloatArray


@jit_fast_ir_inline
def _fill(observed: FloatArray, projection: Projection, camera: StereoCamera, work: _Work) -> None:
    """Fill residual and Jacobian of a landmark that both images show."""
    x, y = (observed[2] - camera.cx) / camera.fx, (observed[3] - camera.cy) / camera.fy
    residual, jacobian = work.residual, work.jacobian
    for i in range(4):
        residual[i] = observed[i] - projection.uv[i]
        for a in range(6):
            jacobian[i, a] = projection.by_target[i, a]
        jacobian[i, 6] = 0.0
    jacobian[2, 6], jacobian[3, 6] = 1.0 + x * x, x * y


@jit_fast_ir_inline
def _add(work: _Work, equations: _Equations) -> None:
    """Add a landmark to the normal equations, with a robust weight."""
    residual, jacobian, weighted, h, g = (
        work.residual,
        work.jacobian,
        work.weighted,
        equations.information,
        equations.rhs,
    )
    whitening = work.whitening
    fill_inverse_4(work.covariance, whitening)
    chi2 = 0.0
    for i in range(4):
        for j in range(4):
            chi2 += 0.25 * residual[i] * whitening[i, j] * residual[j]
    weight = 1.0 / (1.0 + chi2 / ROBUST_CHI2) ** 2
    for j in range(4):
        for a in range(UNKNOWNS):
            weighted[j, a] = 0.0
        for i in range(4):
            for a in range(UNKNOWNS):
                weighted[j, a] += weight * whitening[i, j] * jacobian[i, a]
        for a in range(UNKNOWNS):
            g[a] += weighted[j, a] * residual[j]
            for b in range(UNKNOWNS):
                h[a, b] += weighted[j, a] * jacobian[j, b]


@jit_fast
def right_shift(
    pose: Pose, landmarks: LandmarkEstimates, observations: StereoObservations, camera: StereoCamera
) -> RightShift:
    """Estimate the shift from a solved pair: one Gauss-Newton step of pose and shift together.

    The landmarks' depths come from pairs before. If the right camera has turned since, all right positions are shifted
    alike and the left ones are not: no motion explains that.

    Args:
        pose: Left camera as solved for without a shift.
        landmarks: N landmarks.
        observations: Of the same landmarks; those observed in both images count.
        camera: Camera of all pairs.
    """
    arrays, projection = intrinsics(camera), new_projection()
    equations = _Equations(np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS))
    work = _Work(np.zeros((4, 4)), np.zeros((4, 4)), np.zeros(4), np.zeros((4, UNKNOWNS)), np.zeros((4, UNKNOWNS)))
    count = 0
    every = max(1, len(landmarks.inverse_depth) // ENOUGH)
    for n in range(0, len(landmarks.inverse_depth), every):
        observed, variance = observations.uv[n], observations.variance[n]
        if np.isnan(observed[0]) or np.isnan(observed[2]):
            continue
        rho = landmarks.inverse_depth[n]
        if linearise_landmark(pose, landmarks.hosts, n, landmarks.rays[n], rho, arrays, projection) <= 0.0:
            continue
        fill_covariance(landmarks.covariance[n], projection.by_landmark, variance, True, True, work.covariance)
        _fill(observed, projection, camera, work)
        _add(work, equations)
        count += 1
    if count < UNKNOWNS:
        return RightShift(0.0, np.inf)
    covariance = inverse(equations.information)
    px = 0.0
    for a in range(UNKNOWNS):
        px += covariance[6, a] * equations.rhs[a]
    return RightShift(px, covariance[6, 6])

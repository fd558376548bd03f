"""Pose of one stereo pair from landmarks whose uncertainty is known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.small_linalg import fill_inverse_4, reorder_to_median, retract, solve
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.projection import Intrinsics, Projection, intrinsics, linearise_landmark

MIN_LANDMARKS = 6
"""Minimum number of observed landmarks."""
UNOBSERVED_VARIANCE = 1e8
"""Variance of a position that was not observed, px^2."""


class LandmarkEstimates(NamedTuple):
    """N landmarks, each a host pixel with an inverse depth.

    Attributes:
        hosts: `(N,)` host cameras.
        rays: `(N, 3)` host rays `K^-1 (u, v, 1)`.
        inverse_depth: `(N,)` 1/m.
        covariance: `(N, 3, 3)` of host pixel and inverse depth, px and 1/m.
    """

    hosts: Poses
    rays: FloatArray
    inverse_depth: FloatArray
    covariance: FloatArray


class StereoObservations(NamedTuple):
    """Observations of N landmarks in one pair.

    Attributes:
        uv: `(N, 4)` u, v left, u, v right, pixels; NaN where not observed.
        variance: `(N, 2, 3)` uu, uv, vv in the left and the right image, px^2.
    """

    uv: FloatArray
    variance: FloatArray


class PoseSolution(NamedTuple):
    """Pose of a pair.

    Attributes:
        pose: Left camera.
        information: `(6, 6)` of position and rotation about the fixed axes of the world.
        chi2_per_dof: `(N,)` squared Mahalanobis residual per degree of freedom; NaN where not used.
    """

    pose: Pose
    information: FloatArray
    chi2_per_dof: FloatArray


class _Linearisation(NamedTuple):
    """Whitening `(N, 4, 4)`, Jacobians by the pose `(N, 4, 6)`, residuals `(N, 4)` and chi2 per degree of freedom."""

    whitening: FloatArray
    jacobians: FloatArray
    residuals: FloatArray
    chi2_per_dof: FloatArray


class _Work(NamedTuple):
    """Workspaces of one landmark: covariance `(4, 4)` of its residual, and its projection but for the Jacobian."""

    covariance: FloatArray
    by_landmark: FloatArray
    uv: FloatArray


@jit_fast_ir_inline
def fill_covariance(
    landmark: FloatArray, jacobian: FloatArray, variance: FloatArray, left: bool, right: bool, s: FloatArray
) -> None:
    """Fill s `(4, 4)` with `R + J P J^T`: noise of the observation and uncertainty of the landmark."""
    for i in range(4):
        p, q, r = jacobian[i, 0], jacobian[i, 1], jacobian[i, 2]
        x = p * landmark[0, 0] + q * landmark[1, 0] + r * landmark[2, 0]
        y = p * landmark[0, 1] + q * landmark[1, 1] + r * landmark[2, 1]
        z = p * landmark[0, 2] + q * landmark[1, 2] + r * landmark[2, 2]
        for j in range(4):
            s[i, j] = x * jacobian[j, 0] + y * jacobian[j, 1] + z * jacobian[j, 2]
    for side in range(2):
        i = 2 * side
        if left if side == 0 else right:
            s[i, i] += variance[side, 0]
            s[i, i + 1] += variance[side, 1]
            s[i + 1, i] += variance[side, 1]
            s[i + 1, i + 1] += variance[side, 2]
        else:
            s[i, i] += UNOBSERVED_VARIANCE
            s[i + 1, i + 1] += UNOBSERVED_VARIANCE


@jit_fast_ir_inline
def _fill_residuals(observed: FloatArray, uv: FloatArray, left: bool, right: bool, out: FloatArray) -> None:
    for i in range(4):
        out[i] = observed[i] - uv[i] if (left if i < 2 else right) else 0.0


@jit_fast_ir_inline
def _linearise(
    pose: Pose,
    landmarks: LandmarkEstimates,
    observations: StereoObservations,
    camera: Intrinsics,
    is_first: bool,
    out: _Linearisation,
    work: _Work,
) -> None:
    """Fill the linearisation at a pose; the whitening is that of the first iteration."""
    hosts, rays, rho = landmarks.hosts, landmarks.rays, landmarks.inverse_depth
    landmark_covariance, observed, variance = landmarks.covariance, observations.uv, observations.variance
    whitening, jacobians, residuals, chi2 = out.whitening, out.jacobians, out.residuals, out.chi2_per_dof
    s, by_landmark, uv = work.covariance, work.by_landmark, work.uv
    for n in range(len(rho)):
        chi2[n] = np.nan
        left, right = not np.isnan(observed[n, 0]), not np.isnan(observed[n, 2])
        if not (left or right):
            continue
        projection = Projection(uv, jacobians[n], by_landmark)
        z = linearise_landmark(pose, hosts, n, rays[n], rho[n], camera, projection)
        if z <= 0.0:
            continue
        _fill_residuals(observed[n], uv, left, right, residuals[n])
        if is_first:
            fill_covariance(landmark_covariance[n], by_landmark, variance[n], left, right, s)
            fill_inverse_4(s, whitening[n])
        total = 0.0
        for i in range(4):
            for j in range(4):
                total += residuals[n, i] * whitening[n, i, j] * residuals[n, j]
        chi2[n] = total / ((2.0 if left else 0.0) + (2.0 if right else 0.0))


@jit_fast_ir_inline
def _add_normal_equations(
    linearised: _Linearisation, scale: float, weighted: FloatArray, h: FloatArray, g: FloatArray
) -> None:
    """Add to the information `(6, 6)` and the right-hand side `(6,)`, with Geman-McClure weights of a scale."""
    chi2, jacobians = linearised.chi2_per_dof, linearised.jacobians
    whitening, residuals = linearised.whitening, linearised.residuals
    for n in range(len(chi2)):
        if np.isnan(chi2[n]):
            continue
        weight = 1.0 / (1.0 + chi2[n] / scale) ** 2
        j_n = jacobians[n]
        for i in range(4):
            p, q, r, s = whitening[n, i, 0], whitening[n, i, 1], whitening[n, i, 2], whitening[n, i, 3]
            for a in range(6):
                weighted[i, a] = weight * (p * j_n[0, a] + q * j_n[1, a] + r * j_n[2, a] + s * j_n[3, a])
        for i in range(4):
            residual = residuals[n, i]
            for a in range(6):
                g[a] += weighted[i, a] * residual
        for a in range(6):  # all of it: with the upper half alone it is no vector code
            p, q, r, s = j_n[0, a], j_n[1, a], j_n[2, a], j_n[3, a]
            for b in range(6):
                h[a, b] += p * weighted[0, b] + q * weighted[1, b] + r * weighted[2, b] + s * weighted[3, b]


@jit_fast
def solve_pose(
    start: Pose,
    landmarks: LandmarkEstimates,
    observations: StereoObservations,
    camera: StereoCamera,
    iterations: int,
) -> PoseSolution:
    """Estimate the pose of a pair by robust weighted least squares on both images.

    Each landmark's residual (u, v left, u, v right) is weighted by the inverse of `R + J P J^T`: the tracking noise and
    the landmark's own uncertainty, which is the same as estimating the landmark too (marginalisation). Robust by
    Geman-McClure weights whose scale comes down to the residuals' own (graduated).

    Args:
        start: Left camera.
        landmarks: N landmarks.
        observations: Of the same landmarks.
        camera: Camera of all pairs.
        iterations: Most Gauss-Newton iterations.
    """
    in_arrays = intrinsics(camera)
    count = len(landmarks.inverse_depth)
    rotation, position = start.rotation.copy(), start.position.copy()
    linearised = _Linearisation(
        np.zeros((count, 4, 4)), np.zeros((count, 4, 6)), np.zeros((count, 4)), np.full(count, np.nan)
    )
    h, g = np.zeros((6, 6)), np.zeros(6)
    work, weighted = _Work(np.zeros((4, 4)), np.zeros((4, 3)), np.zeros(4)), np.zeros((4, 6))
    for iteration in range(iterations):
        pose, is_first = Pose(rotation, position), iteration == 0
        _linearise(pose, landmarks, observations, in_arrays, is_first, linearised, work)
        used = linearised.chi2_per_dof[~np.isnan(linearised.chi2_per_dof)]
        if len(used) < MIN_LANDMARKS:
            break
        scale = max(1.0, reorder_to_median(used) * 1.5) * (4.0 if iteration == 0 else 1.0)
        h, g = np.zeros((6, 6)), np.zeros(6)
        _add_normal_equations(linearised, scale, weighted, h, g)
        update = solve(h, g)
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(update[i]))
        for i in range(3):
            position[i] += update[i]
        rotation = retract(rotation, update[3], update[4], update[5])
        if largest < 1e-5:
            break
    return PoseSolution(Pose(rotation, position), h, linearised.chi2_per_dof)

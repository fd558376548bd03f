"""Pose of one stereo pair from landmarks with covariances.

A landmark is a host pixel with an inverse depth (`projection.py`). The residual of landmark n has four rows, u, v in
the left image and u, v in the right image. Its covariance is `S_n = R_n + J_n P_n J_n^T`, where R_n is the tracking
noise, P_n the covariance of the landmark, and J_n the Jacobian with respect to the landmark. Weighting by the inverse
of S_n is equivalent to a joint estimate of pose and landmark in which the landmark is marginalised. The information of
the pose is therefore conditional on the keyframes only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.projection import (
    Intrinsics,
    StereoProjection,
    intrinsics,
    linearise_landmark,
    new_projection,
)
from sfr_loc_map.localisation.small_linalg import fill_inverse_4, reorder_to_median, retract, solve

MIN_LANDMARKS = 6
"""Minimum number of observed landmarks. Three landmarks determine a pose. With six landmarks, the majority outvotes an
outlier."""
UNOBSERVED_VARIANCE = 1e8
"""Variance of a position that was not observed, px^2. The standard deviation, 10 000 px, exceeds any image."""
SCALE_PER_MEDIAN = 1.5
"""Ratio of the scale of the Geman-McClure weight to the median squared residual per degree of freedom. The scale is at
least 1, which is the expected squared residual per degree of freedom. Weaker weights were tried:
measurements/localiser_trials.md, "What limits it, and what was tried"."""
FIRST_SCALE_FACTOR = 4.0
"""Factor of the scale in the first iteration. At the pose of the alignment, residuals may be twice as large as at the
solution."""
CONVERGED_STEP = 1e-5
"""Step of the pose, m and rad, below which the iterations end. An earlier value was 1e-6:
measurements/localiser_trials.md, "Beside other methods, and the changes that followed"."""


@jit_fast_ir_inline
def geman_mcclure_weight(chi2: float, scale: float) -> float:
    """Return the Geman-McClure weight `1 / (1 + chi2 / scale)^2` of a squared residual.

    The weight is that of iteratively reweighted least squares, scaled to 1 at a residual of 0 (Zhang 1997, Parameter
    estimation techniques: a tutorial with application to conic fitting, table 1). The weight is a quarter at
    `chi2 = scale`. For larger residuals, the weight decreases with the fourth power of the residual, so that the
    influence of an outlier vanishes.
    """
    return 1.0 / (1.0 + chi2 / scale) ** 2


class LandmarkEstimates(NamedTuple):
    """N landmarks, each a host pixel with an inverse depth."""

    hosts: Poses  #: `(N,)` host cameras.
    rays: FloatArray  #: `(N, 3)` host rays `K^-1 (u, v, 1)`.
    inverse_depth: FloatArray  #: `(N,)` 1/m.
    covariance: FloatArray  #: `(N, 3, 3)` of host pixel and inverse depth, px and 1/m.

    def take(self, rows: NDArray[np.intp]) -> LandmarkEstimates:
        """Return the landmarks of some rows."""
        rays = self.rays.take(rows, axis=0)
        covariance = self.covariance.take(rows, axis=0)
        return LandmarkEstimates(self.hosts.take(rows), rays, self.inverse_depth[rows], covariance)


class StereoObservations(NamedTuple):
    """Observations of N landmarks in one pair."""

    uv: FloatArray  #: `(N, 4)` u, v left, u, v right, pixels; NaN where not observed.
    variance: FloatArray  #: `(N, 2, 3)` uu, uv, vv in the left and the right image, px^2.

    def take(self, rows: NDArray[np.intp]) -> StereoObservations:
        """Return the observations of some rows."""
        return StereoObservations(self.uv.take(rows, axis=0), self.variance.take(rows, axis=0))


class PoseSolution(NamedTuple):
    """Pose of a pair."""

    pose: Pose  #: Left camera.
    information: FloatArray  #: `(6, 6)` of position and rotation about the fixed axes of the world.
    linearised: Linearisation  #: Linearisation at the pose before the last step.


class Linearisation(NamedTuple):
    """Residuals of N landmarks with their Jacobians."""

    inverse_covariance: FloatArray  #: `(N, 4, 4)` inverse covariance of the residuals.
    jacobians: FloatArray  #: `(N, 4, 6)` with respect to the pose.
    residuals: FloatArray  #: `(N, 4)` pixels, 0 where not observed.
    chi2_per_dof: FloatArray  #: `(N,)` squared Mahalanobis residual per degree of freedom; NaN where not used.
    has_covariance: Mask  #: `(N,)` whether the inverse covariance is computed.


@jit_fast_ir_inline
def new_linearisation(count: int) -> Linearisation:
    """Return an empty linearisation."""
    return Linearisation(
        inverse_covariance=np.zeros((count, 4, 4)),
        jacobians=np.zeros((count, 4, 6)),
        residuals=np.zeros((count, 4)),
        chi2_per_dof=np.full(count, np.nan),
        has_covariance=np.zeros(count, np.bool_),
    )


@jit_fast_ir_inline
def _fill_covariance(
    landmark: FloatArray, jacobian: FloatArray, variance: FloatArray, in_left: bool, in_right: bool, s: FloatArray
) -> None:
    """Fill s `(4, 4)` with `R + J P J^T`: the noise of the observation and the uncertainty of the landmark."""
    for i in range(4):
        p, q, r = jacobian[i, 0], jacobian[i, 1], jacobian[i, 2]
        x = p * landmark[0, 0] + q * landmark[1, 0] + r * landmark[2, 0]
        y = p * landmark[0, 1] + q * landmark[1, 1] + r * landmark[2, 1]
        z = p * landmark[0, 2] + q * landmark[1, 2] + r * landmark[2, 2]
        for j in range(4):
            s[i, j] = x * jacobian[j, 0] + y * jacobian[j, 1] + z * jacobian[j, 2]
    for side in range(2):
        u = 2 * side
        v = u + 1
        if in_left if side == 0 else in_right:
            s[u, u] += variance[side, 0]
            s[u, v] += variance[side, 1]
            s[v, u] += variance[side, 1]
            s[v, v] += variance[side, 2]
        else:
            s[u, u] += UNOBSERVED_VARIANCE
            s[v, v] += UNOBSERVED_VARIANCE


@jit_fast_ir_inline
def _linearise(
    pose: Pose,
    landmarks: LandmarkEstimates,
    observations: StereoObservations,
    camera: Intrinsics,
    out: Linearisation,
    projection: StereoProjection,
    covariance: FloatArray,
) -> None:
    """Fill the linearisation at a pose; the projection and `covariance` `(4, 4)` are workspaces.

    The inverse covariance of a landmark is computed once, at the first pose that has the landmark in front of the
    camera, because it changes little with the pose (`Linearisation.has_covariance`).
    """
    hosts = landmarks.hosts
    rays = landmarks.rays
    inverse_depth = landmarks.inverse_depth
    landmark_covariance = landmarks.covariance
    observed = observations.uv
    variance = observations.variance
    inverse_covariance = out.inverse_covariance
    jacobians = out.jacobians
    residuals = out.residuals
    chi2_per_dof = out.chi2_per_dof
    has_covariance = out.has_covariance
    by_landmark = projection.by_landmark
    uv = projection.uv
    for n in range(len(inverse_depth)):
        chi2_per_dof[n] = np.nan
        in_left = not np.isnan(observed[n, 0])
        in_right = not np.isnan(observed[n, 2])
        if not (in_left or in_right):
            continue
        into = StereoProjection(uv, jacobians[n], by_landmark)
        if linearise_landmark(pose, hosts, n, rays[n], inverse_depth[n], camera, into) <= 0.0:
            continue
        for i in range(4):
            residuals[n, i] = observed[n, i] - uv[i] if (in_left if i < 2 else in_right) else 0.0
        if not has_covariance[n]:
            _fill_covariance(landmark_covariance[n], by_landmark, variance[n], in_left, in_right, covariance)
            fill_inverse_4(covariance, inverse_covariance[n])
            has_covariance[n] = True
        chi2 = 0.0
        for i in range(4):
            for j in range(4):
                chi2 += residuals[n, i] * inverse_covariance[n, i, j] * residuals[n, j]
        chi2_per_dof[n] = chi2 / ((2.0 if in_left else 0.0) + (2.0 if in_right else 0.0))


@jit_fast_ir_inline
def _add_normal_equations(
    linearised: Linearisation, scale: float, weighted: FloatArray, information: FloatArray, rhs: FloatArray
) -> None:
    """Add all landmarks to the information `(6, 6)` and the right-hand side `(6,)`.

    Each landmark has the Geman-McClure weight w for the scale. `weighted` `(4, 6)` is a workspace for `w S^-1 J`.
    """
    chi2_per_dof = linearised.chi2_per_dof
    jacobians = linearised.jacobians
    inverse_covariance = linearised.inverse_covariance
    residuals = linearised.residuals
    for n in range(len(chi2_per_dof)):
        if np.isnan(chi2_per_dof[n]):
            continue
        weight = geman_mcclure_weight(chi2_per_dof[n], scale)
        jacobian = jacobians[n]
        for i in range(4):
            p, q = inverse_covariance[n, i, 0], inverse_covariance[n, i, 1]
            r, s = inverse_covariance[n, i, 2], inverse_covariance[n, i, 3]
            for a in range(6):
                product = p * jacobian[0, a] + q * jacobian[1, a] + r * jacobian[2, a] + s * jacobian[3, a]
                weighted[i, a] = weight * product
        for i in range(4):
            residual = residuals[n, i]
            for a in range(6):
                rhs[a] += weighted[i, a] * residual
        for a in range(6):  # both halves: a loop over the upper half alone is not vectorised
            p, q, r, s = jacobian[0, a], jacobian[1, a], jacobian[2, a], jacobian[3, a]
            for b in range(6):
                information[a, b] += p * weighted[0, b] + q * weighted[1, b] + r * weighted[2, b] + s * weighted[3, b]


@jit_fast
def solve_pose(
    start: Pose, landmarks: LandmarkEstimates, observations: StereoObservations, camera: StereoCamera, iterations: int
) -> PoseSolution:
    """Estimate the pose of a pair by robust weighted least squares on both images (Gauss-Newton).

    Landmarks have Geman-McClure weights. The scale of the weights decreases to that of the residuals (graduated
    non-convexity: Yang et al. 2020), so that an inaccurate prediction does not reject the inliers.

    The iterations end if fewer than `MIN_LANDMARKS` landmarks have a residual. In the first iteration, the initial pose
    is then returned with an information of zero. In a later iteration, the step before has left too few landmarks in
    front of the camera. The pose may then be arbitrarily far away, and the information is that of the iteration before.
    The linearisation at this pose has too few residuals for a pose that is trusted (`Tracks.is_trusted`).

    Args:
        start: Initial pose of the left camera.
        landmarks: The N landmarks.
        observations: Observations of the landmarks in the pair.
        camera: The camera.
        iterations: Maximum number of iterations.
    """
    camera_arrays = intrinsics(camera)
    linearised = new_linearisation(len(landmarks.inverse_depth))
    rotation = start.rotation.copy()
    position = start.position.copy()
    information = np.zeros((6, 6))
    rhs = np.zeros(6)
    projection = new_projection()
    covariance = np.zeros((4, 4))
    weighted = np.zeros((4, 6))
    used_chi2 = np.zeros(len(observations.uv))
    for iteration in range(iterations):
        pose = Pose(rotation, position)
        _linearise(pose, landmarks, observations, camera_arrays, linearised, projection, covariance)
        count = 0
        for chi2 in linearised.chi2_per_dof:
            if not np.isnan(chi2):
                used_chi2[count] = chi2
                count += 1
        if count < MIN_LANDMARKS:
            break
        scale = max(1.0, reorder_to_median(used_chi2[:count]) * SCALE_PER_MEDIAN)
        scale *= FIRST_SCALE_FACTOR if iteration == 0 else 1.0
        information = np.zeros((6, 6))
        rhs = np.zeros(6)
        _add_normal_equations(linearised, scale, weighted, information, rhs)
        update = solve(information, rhs)
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(update[i]))
        for i in range(3):
            position[i] += update[i]
        rotation = retract(rotation, update[3], update[4], update[5])
        if largest < CONVERGED_STEP:
            break
    return PoseSolution(Pose(rotation, position), information, linearised)


def linearise(
    pose: Pose, landmarks: LandmarkEstimates, observations: StereoObservations, camera: StereoCamera
) -> Linearisation:
    """Return the residuals of N landmarks in a pair at a pose, with their Jacobians and covariances.

    The first iteration of the solver has this linearisation. A kernel of its own takes 3 s to compile and saves 13 us.
    """
    return solve_pose(pose, landmarks, observations, camera, 1).linearised

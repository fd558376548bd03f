"""Pose of one stereo pair from landmarks with covariances; yaw of its right camera.

A landmark is a host pixel with an inverse depth (`projection.py`). The residual of landmark n has four rows, u, v in
the left image and u, v in the right image. Its covariance is `S_n = R_n + J_n P_n J_n^T`, with the tracking noise R_n,
the covariance P_n of the landmark and the Jacobian J_n by the landmark. To weight by the inverse of S_n is the same as
to estimate the landmark too and to marginalise it out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.projection import (
    Intrinsics,
    StereoProjection,
    intrinsics,
    linearise_landmark,
    new_projection,
)
from sfr_loc_map.localisation.frontend.robust_weights import geman_mcclure, geman_mcclure_weight
from sfr_loc_map.localisation.small_linalg import fill_inverse_4, reorder_to_median, retract, solve

# Values without a stated reason were chosen by hand. Recorded trials of others: measurements/localiser_trials.md.
MIN_LANDMARKS = 6  #: Minimum number of observed landmarks.
UNOBSERVED_VARIANCE = 1e8  #: Variance of a position that was not observed, px^2.
SCALE_PER_MEDIAN = 1.5
"""Scale of the Geman-McClure weight over the median of the squared residuals per degree of freedom. The scale is at
least 1, which is their expectation. Weaker weights: measurements/localiser_trials.md,
"What limits it, and what was tried"."""
FIRST_SCALE_FACTOR = 4.0  #: Factor on that scale in the first iteration, when the pose is that of the prediction.
CONVERGED_STEP = 1e-5  #: Step of the pose, metres and radians, below which no further iteration follows.


class RightOffset(NamedTuple):
    """Extrinsic rotation error of the right camera, as the displacement of right image positions."""

    u: float = 0.0  #: Offset along the row at the image centre (yaw), pixels, positive to the right.
    v: float = 0.0  #: Offset along the column at the image centre (pitch), pixels, positive downwards.
    roll: float = 0.0  #: Rotation about the optical axis, pixels at a distance of the focal length.

    def at(self, uv: FloatArray, camera: StereoCamera) -> FloatArray:
        """Return the offsets `(N, 2)` at pixels `(N, 2)` of the right image: the flow field of a small rotation."""
        x, y = camera.normalised(uv).T
        along_u = self.u * (1.0 + x * x) + self.v * x * y - self.roll * y
        along_v = self.v * (1.0 + y * y) + self.u * x * y + self.roll * x
        return np.column_stack((along_u, along_v))


class LandmarkEstimates(NamedTuple):
    """N landmarks, each a host pixel with an inverse depth."""

    hosts: Poses  #: `(N,)` host cameras.
    rays: FloatArray  #: `(N, 3)` host rays `K^-1 (u, v, 1)`.
    inverse_depth: FloatArray  #: `(N,)` 1/m.
    covariance: FloatArray  #: `(N, 3, 3)` of host pixel and inverse depth, px and 1/m.


class StereoObservations(NamedTuple):
    """Observations of N landmarks in one pair."""

    uv: FloatArray  #: `(N, 4)` u, v left, u, v right, pixels; NaN where not observed.
    variance: FloatArray  #: `(N, 2, 3)` uu, uv, vv in the left and the right image, px^2.


class PoseSolution(NamedTuple):
    """Pose of a pair."""

    pose: Pose  #: Left camera.
    information: FloatArray  #: `(6, 6)` of position and rotation about the fixed axes of the world.
    linearised: Linearisation  #: At the pose before the last step.


class Linearisation(NamedTuple):
    """Residuals of N landmarks with their Jacobians."""

    whitening: FloatArray  #: `(N, 4, 4)` inverse covariance of the residuals.
    jacobians: FloatArray  #: `(N, 4, 6)` by the pose.
    residuals: FloatArray  #: `(N, 4)` pixels, 0 where not observed.
    chi2_per_dof: FloatArray  #: `(N,)` squared Mahalanobis residual per degree of freedom; NaN where not used.


@jit_fast_ir_inline
def new_linearisation(count: int) -> Linearisation:
    """Return a linearisation to be filled."""
    return Linearisation(np.zeros((count, 4, 4)), np.zeros((count, 4, 6)), np.zeros((count, 4)), np.full(count, np.nan))


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
    is_first: bool,
    out: Linearisation,
    projection: StereoProjection,
    covariance: FloatArray,
) -> None:
    """Fill the linearisation at a pose; the projection and `covariance` `(4, 4)` are workspaces.

    The whitening is that of the first iteration: it changes little with the pose.
    """
    hosts = landmarks.hosts
    rays = landmarks.rays
    inverse_depth = landmarks.inverse_depth
    landmark_covariance = landmarks.covariance
    observed = observations.uv
    variance = observations.variance
    whitening = out.whitening
    jacobians = out.jacobians
    residuals = out.residuals
    chi2_per_dof = out.chi2_per_dof
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
        if is_first:
            _fill_covariance(landmark_covariance[n], by_landmark, variance[n], in_left, in_right, covariance)
            fill_inverse_4(covariance, whitening[n])
        chi2 = 0.0
        for i in range(4):
            for j in range(4):
                chi2 += residuals[n, i] * whitening[n, i, j] * residuals[n, j]
        chi2_per_dof[n] = chi2 / ((2.0 if in_left else 0.0) + (2.0 if in_right else 0.0))


@jit_fast_ir_inline
def _add_normal_equations(
    linearised: Linearisation, scale: float, weighted: FloatArray, information: FloatArray, rhs: FloatArray
) -> None:
    """Add all landmarks to the information `(6, 6)` and the right-hand side `(6,)`.

    A landmark has the Geman-McClure weight of the scale. `weighted` `(4, 6)` is a workspace for `w S^-1 J`.
    """
    chi2_per_dof = linearised.chi2_per_dof
    jacobians = linearised.jacobians
    whitening = linearised.whitening
    residuals = linearised.residuals
    for n in range(len(chi2_per_dof)):
        if np.isnan(chi2_per_dof[n]):
            continue
        weight = geman_mcclure_weight(chi2_per_dof[n], scale)
        jacobian = jacobians[n]
        for i in range(4):
            p, q, r, s = whitening[n, i, 0], whitening[n, i, 1], whitening[n, i, 2], whitening[n, i, 3]
            for a in range(6):
                product = p * jacobian[0, a] + q * jacobian[1, a] + r * jacobian[2, a] + s * jacobian[3, a]
                weighted[i, a] = weight * product
        for i in range(4):
            residual = residuals[n, i]
            for a in range(6):
                rhs[a] += weighted[i, a] * residual
        for a in range(6):  # Both halves: with the upper half alone the loop is not vectorised.
            p, q, r, s = jacobian[0, a], jacobian[1, a], jacobian[2, a], jacobian[3, a]
            for b in range(6):
                information[a, b] += p * weighted[0, b] + q * weighted[1, b] + r * weighted[2, b] + s * weighted[3, b]


@jit_fast
def solve_pose(
    start: Pose, landmarks: LandmarkEstimates, observations: StereoObservations, camera: StereoCamera, iterations: int
) -> PoseSolution:
    """Estimate the pose of a pair by robust weighted least squares on both images (Gauss-Newton).

    The weights are those of Geman and McClure. Their scale falls to that of the residuals (graduated non-convexity:
    Yang et al. 2020), so that a prediction beside the solution does not reject the inliers.

    Args:
        start: Initial pose of the left camera.
        landmarks: The N landmarks.
        observations: Their observations in the pair.
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
        is_first = iteration == 0
        _linearise(pose, landmarks, observations, camera_arrays, is_first, linearised, projection, covariance)
        count = 0
        for chi2 in linearised.chi2_per_dof:
            if not np.isnan(chi2):
                used_chi2[count] = chi2
                count += 1
        if count < MIN_LANDMARKS:
            break
        scale = max(1.0, reorder_to_median(used_chi2[:count]) * SCALE_PER_MEDIAN)
        scale *= FIRST_SCALE_FACTOR if is_first else 1.0
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


# Values without a stated reason were chosen by hand. Recorded trials of others: measurements/localiser_trials.md.
SHIFT_SCALE = 4.0  #: Squared residual per degree of freedom at which a landmark's weight is a quarter (Geman-McClure).
MIN_INLIER_WEIGHT = 0.5  #: Minimum weight of a landmark that agrees with the pose.
MIN_SHIFT_LANDMARKS = 9  #: Minimum number of landmarks of the shift and the shear.
ENOUGH_LANDMARKS = 300
"""Approximate number of landmarks that are used. The error that all landmarks of an image have in common is larger than
that of their mean."""
POSE, SHIFT, SHEAR = slice(6), 6, slice(7, 9)
"""Unknowns of the step: pose, shift of the right image, shears of the left and of the right image."""


class RightShift(NamedTuple):
    """Shift of right positions along the rows at the image centre, as by a yaw of the right camera."""

    px: float  #: Pixels to the right, beyond the corrections that the landmarks were triangulated with.
    variance: float  #: Its variance by the landmarks alone, px^2; infinite with too few landmarks.
    #: Squared Mahalanobis shear of the rows of both images, as by a rolling shutter, per degree of freedom.
    shear: float
    uv: FloatArray  #: `(N, 2)` left pixels of the landmarks that agree with the pose.
    disparity: FloatArray  #: `(N,)` their residual disparities, pixels.


class _StepEquations(NamedTuple):
    """Normal equations of a Gauss-Newton step of pose, shift and shears."""

    information: FloatArray  #: `(9, 9)`.
    rhs: FloatArray  #: `(9,)`.


def right_shift(
    pose: Pose, landmarks: LandmarkEstimates, observations: StereoObservations, camera: StereoCamera, lens_px: float
) -> RightShift:
    """Estimate the shift of the right image and a shear of both images in a solved pair.

    The depths of the landmarks come from earlier pairs. If the right camera has rotated since, all right positions are
    shifted by the same amount and the left ones are not, which no motion of the rig explains. One Gauss-Newton step of
    pose and shift together gives the shift, because the pose of the pair was solved for without one.

    Args:
        pose: Pose of the left camera in the pair.
        landmarks: The N landmarks.
        observations: Their observations in the pair; those observed in both images count.
        camera: The camera.
        lens_px: Standard deviation of disparities due to lens distortion, pixels. It may look like a shear.
    """
    landmarks, observations = _in_both_images(landmarks, observations)
    linearised = solve_pose(pose, landmarks, observations, camera, 1).linearised
    chi2 = np.where(np.isnan(linearised.chi2_per_dof), np.inf, linearised.chi2_per_dof)
    weight = geman_mcclure(chi2, SHIFT_SCALE)
    left_uv = observations.uv[:, :2]
    right_uv = observations.uv[:, 2:]
    if np.count_nonzero(weight) < MIN_SHIFT_LANDMARKS:
        return RightShift(0.0, np.inf, 0.0, left_uv[:0], left_uv[:0, 0])
    right_xy = camera.normalised(right_uv)
    equations = _step_equations(linearised, weight, camera.normalised(left_uv), right_xy)
    px, variance = _shift_of(equations)
    shear = _shear_of(equations, lens_px / float(np.abs(right_xy[:, 1]).max()))
    agrees = weight > MIN_INLIER_WEIGHT
    disparity = linearised.residuals[agrees, 2] - linearised.residuals[agrees, 0]
    return RightShift(px, variance, shear, left_uv[agrees], disparity)


def _in_both_images(
    landmarks: LandmarkEstimates, observations: StereoObservations
) -> tuple[LandmarkEstimates, StereoObservations]:
    """Return about `ENOUGH_LANDMARKS` of the landmarks that are observed in both images, with their observations."""
    count = len(observations.uv)
    chosen = np.arange(0, count, max(1, count // ENOUGH_LANDMARKS))
    in_both = chosen[np.isfinite(observations.uv[chosen, 0] + observations.uv[chosen, 2])]
    # `take` gives what an index gives, and is up to ten times faster for rows of few numbers
    hosts = Poses(landmarks.hosts.rotations.take(in_both, axis=0), landmarks.hosts.positions.take(in_both, axis=0))
    rays = landmarks.rays.take(in_both, axis=0)
    covariance = landmarks.covariance.take(in_both, axis=0)
    of_chosen = LandmarkEstimates(hosts, rays, landmarks.inverse_depth[in_both], covariance)
    uv = observations.uv.take(in_both, axis=0)
    return of_chosen, StereoObservations(uv, observations.variance.take(in_both, axis=0))


def _step_equations(
    linearised: Linearisation, weight: FloatArray, left_xy: FloatArray, right_xy: FloatArray
) -> _StepEquations:
    """Return the normal equations of a step, from normalised image coordinates `(N, 2)` of the observations.

    A yaw shifts a right position by `(1 + x^2, x y)` at a shift of one pixel at the centre. A shear shifts the rows of
    an image along u in proportion to y. On flat ground a shear of both images resembles a sideways motion; stones and
    the horizon separate the two.
    """
    x, y = right_xy.T
    jacobian = np.zeros((len(weight), 4, 9))
    jacobian[:, :, POSE] = linearised.jacobians
    jacobian[:, 2, SHIFT] = 1.0 + x * x
    jacobian[:, 3, SHIFT] = x * y
    jacobian[:, 0, SHEAR.start] = left_xy[:, 1]
    jacobian[:, 2, SHEAR.start + 1] = y
    weighted = (linearised.whitening * weight[:, None, None] @ jacobian).reshape(-1, 9)
    return _StepEquations(weighted.T @ jacobian.reshape(-1, 9), weighted.T @ linearised.residuals.ravel())


def _shift_of(equations: _StepEquations) -> tuple[float, float]:
    """Return the shift, px, and its variance, px^2, of a step without shear."""
    size = SHIFT + 1
    information = equations.information[:size, :size]
    inverse_row = np.linalg.solve(information, np.eye(size)[SHIFT])
    return float(inverse_row @ equations.rhs[:size]), float(inverse_row[SHIFT])


def _shear_of(equations: _StepEquations, lens_sigma: float) -> float:
    """Return the squared Mahalanobis norm `s^T C^-1 s / 2` of the shears: at most about 1 without shear.

    The covariance C is that of the step, plus the variance of a shear that lens distortion may resemble.
    """
    covariance = np.linalg.inv(equations.information)
    shears = (covariance @ equations.rhs)[SHEAR]
    covariance_of_shears = covariance[SHEAR, SHEAR] + np.eye(2) * lens_sigma**2
    return float(shears @ np.linalg.solve(covariance_of_shears, shears)) / 2.0

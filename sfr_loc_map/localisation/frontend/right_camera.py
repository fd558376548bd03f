"""Deviation of the right camera from its calibration.

A small rotation of the camera displaces right image positions (`RightCameraOffset`). The yaw since the landmarks were
triangulated is estimated after the pose of each pair (`PairYaw`). A yaw shifts the principal point along its row, and
is therefore given in pixels.

The Gauss-Newton step that estimates the yaw also estimates a shear of the rows of both images (rolling shutter).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, diagonal_matrix, is_finite, outer_square, read_only
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.jit import jit
from sfr_loc_map.localisation.frontend.pose_solver import (
    LandmarkEstimates,
    Linearisation,
    StereoObservations,
    geman_mcclure_weight,
    linearise,
)

YAW_SCALE = 4.0
"""Scale of the Geman-McClure weight: the squared residual per degree of freedom at which the weight is a quarter. It
corresponds to two standard deviations. The pose is already solved, so a larger scale is not required."""
MIN_INLIER_WEIGHT = 0.5
"""Minimum weight of a landmark that agrees with the pose. It corresponds to a residual of 1.3 standard deviations."""
MIN_YAW_LANDMARKS = 9  #: Minimum number of landmarks with a weight: one for each unknown of the step.
ENOUGH_LANDMARKS = 300
"""Minimum number of landmarks used, if there are as many. Every n-th landmark is used, at most twice this number. With
300, the error that all landmarks of an image have in common exceeds the random error of their mean."""
POSE, YAW, LEFT_SHEAR, RIGHT_SHEAR = slice(6), 6, 7, 8
"""Unknowns of the step: pose, yaw of the right camera, shears of the left and of the right image."""
SHEAR = slice(LEFT_SHEAR, RIGHT_SHEAR + 1)  #: Unknowns of both shears.
UNKNOWNS = 9  #: Number of unknowns of the step.


class RightCameraOffset(NamedTuple):
    """Extrinsic rotation error of the right camera, as the displacement of right image positions."""

    yaw_px: float = 0.0  #: Offset along the row at the principal point, pixels, positive to the right.
    pitch_px: float = 0.0  #: Offset along the column at the principal point, pixels, positive downwards.
    roll_px: float = 0.0  #: Rotation about the optical axis, pixels at one focal length from the principal point.

    def at(self, uv: FloatArray, camera: StereoCamera) -> FloatArray:
        """Return the offsets `(N, 2)` at pixels `(N, 2)` of the right image: the flow field of a small rotation."""
        return _offsets_at(self, np.ascontiguousarray(uv), camera)  # the kernel is compiled for this order


@jit
def _offsets_at(offset: RightCameraOffset, uv: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return `offset.at(uv, camera)`; a kernel, because each pair calls it for all landmarks."""
    yaw_px = offset.yaw_px
    pitch_px = offset.pitch_px
    roll_px = offset.roll_px
    offsets = np.empty((len(uv), 2))
    for n in range(len(uv)):
        x = (uv[n, 0] - camera.cx) / camera.fx
        y = (uv[n, 1] - camera.cy) / camera.fy
        offsets[n, 0] = yaw_px * (1.0 + x * x) + pitch_px * x * y - roll_px * y
        offsets[n, 1] = pitch_px * (1.0 + y * y) + yaw_px * x * y + roll_px * x
    return offsets


class RowShear(NamedTuple):
    """Shear of the rows of both images (rolling shutter)."""

    chi2: float  #: Squared Mahalanobis norm of the shears of both images, per degree of freedom.
    #: `(6,)` difference between the pose with the estimated shears and the pose without shears: position, m, and
    #: rotation about the axes of the world, rad.
    pose_shift: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the error of a pose that was solved without shears.

            covariance = max(1 - 1 / chi2, 0) pose_shift pose_shift^T

        Without shear, `chi2` is 1 on average, so that shears of this size are noise and add nothing.
        """
        excess = 1.0 - 1.0 / max(self.chi2, 1.0)
        return excess * outer_square(self.pose_shift)


NO_SHEAR = RowShear(0.0, read_only(np.zeros(6)))  #: Rows exposed at one time, or too few landmarks for an estimate.


class PairYaw(NamedTuple):
    """Yaw of the right camera in a pair, relative to its yaw when the landmarks were triangulated."""

    px: float  #: Yaw, px, in addition to the corrections that were applied when the landmarks were triangulated.
    shear: RowShear  #: Shear of the rows.
    uv: FloatArray  #: `(N, 2)` left pixels of the landmarks that agree with the pose.
    disparity: FloatArray  #: `(N,)` residual disparities of these landmarks, pixels.


class _StepTerms(NamedTuple):
    """Weights and derivatives of N landmarks in a Gauss-Newton step of pose, yaw and shears."""

    weight: FloatArray  #: `(N,)` Geman-McClure weights; 0 for a landmark behind the camera.
    jacobian: FloatArray  #: `(N, 4, 9)` derivatives of the projections with respect to the unknowns.


class _StepEquations(NamedTuple):
    """Normal equations of a Gauss-Newton step of pose, yaw and shears."""

    information: FloatArray  #: `(9, 9)`.
    rhs: FloatArray  #: `(9,)`.


def pair_yaw(
    pose: Pose,
    landmarks: LandmarkEstimates,
    observations: StereoObservations,
    camera: StereoCamera,
    shape: tuple[int, int],
    lens_px: float,
) -> PairYaw | None:
    """Estimate the yaw of the right camera in a pair whose pose is solved, and test whether an image is sheared.

    None if too few landmarks are observed in both images, or if the equations are not finite.

    The depths of the landmarks come from earlier pairs. If the right camera has rotated since then, all right positions
    are shifted by about the same amount, and left positions are not shifted. No motion of the rig explains such a
    shift. The pose of the pair was solved without a yaw, and the yaw is therefore estimated by one joint Gauss-Newton
    step of pose and yaw.

    Args:
        pose: Pose of the left camera in the pair.
        landmarks: The N landmarks.
        observations: Observations of the landmarks in the pair. Landmarks not observed in both images are ignored.
        camera: The camera.
        shape: Height and width of the images.
        lens_px: Standard deviation of disparities due to lens errors, pixels. Lens errors may resemble a shear.
    """
    landmarks, observations = _in_both_images(landmarks, observations)
    linearised = linearise(pose, landmarks, observations, camera)
    terms = _step_terms(linearised, observations.uv, camera)
    weight = terms.weight
    left_uv = observations.uv[:, :2]
    right_uv = observations.uv[:, 2:]
    if np.count_nonzero(weight) < MIN_YAW_LANDMARKS:
        return None
    equations = _step_equations(linearised, terms)
    if not is_finite(equations.information):
        return None
    # A shear about another row is the same shear plus a shift. Distances are therefore from the middle row.
    middle_row = 0.5 * (shape[0] - 1)
    farthest = float(np.abs((right_uv[:, 1] - middle_row) / camera.fy).max())
    shear = _row_shear(equations, lens_px / farthest)
    agrees = weight > MIN_INLIER_WEIGHT
    disparity = linearised.residuals[agrees, 2] - linearised.residuals[agrees, 0]
    return PairYaw(_yaw_px(equations), shear, left_uv[agrees], disparity)


def _in_both_images(
    landmarks: LandmarkEstimates, observations: StereoObservations
) -> tuple[LandmarkEstimates, StereoObservations]:
    """Select about `ENOUGH_LANDMARKS` landmarks; return those observed in both images, with their observations."""
    count = len(observations.uv)
    chosen = np.arange(0, count, max(1, count // ENOUGH_LANDMARKS))
    in_both = chosen[np.isfinite(observations.uv[chosen, 0] + observations.uv[chosen, 2])]
    return landmarks.take(in_both), observations.take(in_both)


@jit
def _step_terms(linearised: Linearisation, uv: FloatArray, camera: StereoCamera) -> _StepTerms:
    """Return the weights and derivatives of a step, from the observations `(N, 4)` u, v left, u, v right, pixels.

    A yaw that shifts the principal point by one pixel shifts a right position (x, y), in normalised coordinates, by
    `(1 + x^2, x y)` pixels. A shear shifts the rows of an image along u in proportion to y. On flat ground, a shear of
    both images resembles a sideways motion; stones and the horizon distinguish the two.
    """
    count = len(uv)
    weight = np.zeros(count)
    jacobian = np.zeros((count, 4, UNKNOWNS))
    for n in range(count):
        chi2 = linearised.chi2_per_dof[n]
        if not np.isnan(chi2):
            weight[n] = geman_mcclure_weight(chi2, YAW_SCALE)
        for i in range(4):
            for unknown in range(YAW):
                jacobian[n, i, unknown] = linearised.jacobians[n, i, unknown]
        x = (uv[n, 2] - camera.cx) / camera.fx
        y = (uv[n, 3] - camera.cy) / camera.fy
        jacobian[n, 2, YAW] = 1.0 + x * x
        jacobian[n, 3, YAW] = x * y
        jacobian[n, 0, LEFT_SHEAR] = (uv[n, 1] - camera.cy) / camera.fy
        jacobian[n, 2, RIGHT_SHEAR] = y
    return _StepTerms(weight, jacobian)


def _step_equations(linearised: Linearisation, terms: _StepTerms) -> _StepEquations:
    """Return the normal equations of a step."""
    jacobian = terms.jacobian.reshape(-1, UNKNOWNS)
    weighted = (linearised.inverse_covariance * terms.weight[:, None, None] @ terms.jacobian).reshape(-1, UNKNOWNS)
    return _StepEquations(weighted.T @ jacobian, weighted.T @ linearised.residuals.ravel())


def _yaw_px(equations: _StepEquations) -> float:
    """Return the yaw, px, from the equations of pose and yaw; the shears are held at 0."""
    size = YAW + 1
    information = equations.information[:size, :size]
    unit = np.zeros(size)
    unit[YAW] = 1.0
    inverse_row = np.linalg.solve(information, unit)
    return float(inverse_row @ equations.rhs[:size])


def _row_shear(equations: _StepEquations, lens_sigma: float) -> RowShear:
    """Estimate the shears of both images, and the shift of the pose that they cause.

        chi2 = s^T C_s^-1 s / 2
        pose_shift = C_ps C_s^-1 s

    s are the shears, C_s is their covariance in the step plus the variance of a shear that lens errors may resemble,
    and C_ps is the covariance of pose and shears in the step. The values of `chi2` on drives without shear are given at
    `guards.MAX_SHEAR` and `guards.MAX_MEAN_SHEAR`.
    """
    covariance = np.linalg.inv(equations.information)
    shears = (covariance @ equations.rhs)[SHEAR]
    covariance_of_shears = covariance[SHEAR, SHEAR] + diagonal_matrix((lens_sigma**2, lens_sigma**2))
    weighted_shears = np.linalg.solve(covariance_of_shears, shears)
    chi2 = float(shears @ weighted_shears) / 2.0
    return RowShear(chi2, covariance[POSE, SHEAR] @ weighted_shears)

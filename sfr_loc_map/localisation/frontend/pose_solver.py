"""Pose of one stereo pair from landmarks whose uncertainty is known; a rotation of its right camera.

A landmark is a host pixel with an inverse depth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.small_linalg import fill_inverse_4, reorder_to_median, retract, solve
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline


class Projection(NamedTuple):
    """A projected landmark with its Jacobians; rows are u, v in the left image, u, v in the right image.

    A rotation is about the fixed axes of the world: `R <- exp([w]x) R`.
    """

    uv: FloatArray  #: `(4,)` pixels.
    by_target: FloatArray  #: `(4, 6)` derivative by position and rotation of the target camera.
    by_landmark: FloatArray  #: `(4, 3)` by host pixel u, v and inverse depth.


class Intrinsics(NamedTuple):
    """Camera of both images, in arrays by axis (u, v).

    What is read from an array is a value of its own for the compiler, which sums in any order: with the scalars of
    `StereoCamera` in their place the results would differ by rounding.
    """

    focal: FloatArray  #: `(2,)` focal lengths, pixels.
    centre: FloatArray  #: `(2,)` principal point, pixels.
    baseline_m: float  #: Distance between the optical centres, metres.


@jit_fast_ir_inline
def intrinsics(camera: StereoCamera) -> Intrinsics:
    """Return the intrinsics of a camera."""
    return Intrinsics(np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy]), camera.baseline_m)


@jit_fast_ir_inline
def new_projection() -> Projection:
    """Return a projection to be filled."""
    return Projection(np.zeros(4), np.zeros((4, 6)), np.zeros((4, 3)))


@jit_fast_ir_inline
def linearise_in_host(landmark: FloatArray, camera: Intrinsics, out: Projection) -> None:
    """Project a landmark, `(3,)` u, v, px, and inverse depth, 1/m, into its own pair; `by_target` stays as it is."""
    uv, j_mark, per_depth = out.uv, out.by_landmark, camera.focal[0] * camera.baseline_m
    for i in range(4):
        uv[i] = landmark[i % 2]
        for b in range(3):
            j_mark[i, b] = 1.0 if b == i % 2 else 0.0
    uv[2] -= per_depth * landmark[2]
    j_mark[2, 2] = -per_depth


@jit_fast_ir_inline
def linearise_landmark(
    target: Pose, hosts: Poses, k: int, ray: FloatArray, inverse_depth: float, camera: Intrinsics, out: Projection
) -> float:
    """Project a landmark into both images, with Jacobians.

    The target is the left camera of the pair, `hosts[k]` that of the keyframe with the landmark, whose host ray
    `K^-1 (u, v, 1)` is `(3,)` and whose inverse depth is in 1/m. The projection is filled.

    Returns:
        Depth in the target camera times the inverse depth; 0, with `out` untouched, behind the camera.
    """
    r_cw, r_wh, p_h = target.rotation, hosts.rotations[k], hosts.positions[k]
    tx = r_wh[0, 0] * ray[0] + r_wh[0, 1] * ray[1] + r_wh[0, 2]
    ty = r_wh[1, 0] * ray[0] + r_wh[1, 1] * ray[1] + r_wh[1, 2]
    tz = r_wh[2, 0] * ray[0] + r_wh[2, 1] * ray[1] + r_wh[2, 2]
    p_c = target.position
    bx, by, bz = p_h[0] - p_c[0], p_h[1] - p_c[1], p_h[2] - p_c[2]
    wx, wy, wz = tx + inverse_depth * bx, ty + inverse_depth * by, tz + inverse_depth * bz
    z: float = r_cw[0, 2] * wx + r_cw[1, 2] * wy + r_cw[2, 2] * wz
    if z < 1e-6:
        return 0.0
    x = (r_cw[0, 0] * wx + r_cw[1, 0] * wy + r_cw[2, 0] * wz) / z
    y = (r_cw[0, 1] * wx + r_cw[1, 1] * wy + r_cw[2, 1] * wz) / z
    focal, centre, baseline = camera.focal, camera.centre, camera.baseline_m
    uv, j_pose, j_mark = out.uv, out.by_target, out.by_landmark
    for i in range(4):
        axis = i % 2
        f = focal[axis] / z
        s = (x if i == 0 else x - baseline * inverse_depth / z) if axis == 0 else y
        uv[i] = focal[axis] * s + centre[axis]
        # derivative by the point in world axes
        a = f * (r_cw[0, axis] - s * r_cw[0, 2])
        b = f * (r_cw[1, axis] - s * r_cw[1, 2])
        c = f * (r_cw[2, axis] - s * r_cw[2, 2])
        j_pose[i, 0], j_pose[i, 1], j_pose[i, 2] = -inverse_depth * a, -inverse_depth * b, -inverse_depth * c
        # rotating the camera by theta rotates the point by -theta: d y = R_wc [w]x theta
        j_pose[i, 3], j_pose[i, 4], j_pose[i, 5] = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
        j_mark[i, 0] = (a * r_wh[0, 0] + b * r_wh[1, 0] + c * r_wh[2, 0]) / focal[0]
        j_mark[i, 1] = (a * r_wh[0, 1] + b * r_wh[1, 1] + c * r_wh[2, 1]) / focal[1]
        j_mark[i, 2] = a * bx + b * by + c * bz
        if i == 2:
            j_mark[i, 2] -= f * baseline
    return z


class RightOffset(NamedTuple):
    """Extrinsic rotation error of the right camera, as the pixels by which it moves right image positions."""

    u: float = 0.0  #: Offset along the row at the image centre (yaw), pixels, positive to the right.
    v: float = 0.0  #: Offset along the column at the image centre (pitch), pixels, positive downwards.
    roll: float = 0.0  #: Rotation about the optical axis, pixels at a distance of the focal length.

    def at(self, uv: FloatArray, camera: StereoCamera) -> FloatArray:
        """Return the offsets `(N, 2)` at pixels `(N, 2)` of the right image: the flow field of a small rotation."""
        x, y = (uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy
        along_u = self.u * (1.0 + x * x) + self.v * x * y - self.roll * y
        return np.column_stack((along_u, self.v * (1.0 + y * y) + self.u * x * y + self.roll * x))


MIN_LANDMARKS = 6  #: Minimum number of observed landmarks.
UNOBSERVED_VARIANCE = 1e8  #: Variance of a position that was not observed, px^2.


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
def _linearise(
    pose: Pose,
    landmarks: LandmarkEstimates,
    observations: StereoObservations,
    camera: Intrinsics,
    is_first: bool,
    out: Linearisation,
    work: Projection,
    s: FloatArray,
) -> None:
    """Fill the linearisation at a pose; the whitening, for which `s` `(4, 4)` has room, is of the first iteration."""
    hosts, rays, rho = landmarks.hosts, landmarks.rays, landmarks.inverse_depth
    landmark_covariance, observed, variance = landmarks.covariance, observations.uv, observations.variance
    whitening, jacobians, residuals, chi2 = out.whitening, out.jacobians, out.residuals, out.chi2_per_dof
    by_landmark, uv = work.by_landmark, work.uv
    for n in range(len(rho)):
        chi2[n] = np.nan
        left, right = not np.isnan(observed[n, 0]), not np.isnan(observed[n, 2])
        if not (left or right):
            continue
        projection = Projection(uv, jacobians[n], by_landmark)
        if linearise_landmark(pose, hosts, n, rays[n], rho[n], camera, projection) <= 0.0:
            continue
        for i in range(4):
            residuals[n, i] = observed[n, i] - uv[i] if (left if i < 2 else right) else 0.0
        if is_first:
            _fill_covariance(landmark_covariance[n], by_landmark, variance[n], left, right, s)
            fill_inverse_4(s, whitening[n])
        total = 0.0
        for i in range(4):
            for j in range(4):
                total += residuals[n, i] * whitening[n, i, j] * residuals[n, j]
        chi2[n] = total / ((2.0 if left else 0.0) + (2.0 if right else 0.0))


@jit_fast_ir_inline
def _add_normal_equations(
    linearised: Linearisation, scale: float, weighted: FloatArray, h: FloatArray, g: FloatArray
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
    start: Pose, landmarks: LandmarkEstimates, observations: StereoObservations, camera: StereoCamera, iterations: int
) -> PoseSolution:
    """Estimate the pose of a pair by robust weighted least squares on both images.

    Each landmark's residual (u, v left, u, v right) is weighted by the inverse of `R + J P J^T`: the tracking noise and
    the landmark's own uncertainty, which is the same as estimating the landmark too (marginalisation). Robust by
    Geman-McClure weights whose scale comes down to the residuals' own (graduated). The start is of the left camera;
    observations are those of the N landmarks; there are at most so many Gauss-Newton iterations.
    """
    in_arrays, linearised = intrinsics(camera), new_linearisation(len(landmarks.inverse_depth))
    rotation, position = start.rotation.copy(), start.position.copy()
    h, g = np.zeros((6, 6)), np.zeros(6)
    work, s, weighted, used = new_projection(), np.zeros((4, 4)), np.zeros((4, 6)), np.zeros(len(observations.uv))
    for iteration in range(iterations):
        pose, is_first = Pose(rotation, position), iteration == 0
        _linearise(pose, landmarks, observations, in_arrays, is_first, linearised, work, s)
        count = 0
        for chi2 in linearised.chi2_per_dof:
            if not np.isnan(chi2):
                used[count] = chi2
                count += 1
        if count < MIN_LANDMARKS:
            break
        scale = max(1.0, reorder_to_median(used[:count]) * 1.5) * (4.0 if iteration == 0 else 1.0)
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
    return PoseSolution(Pose(rotation, position), h, linearised)


ROBUST_CHI2 = 4.0
"""Squared residual per degree of freedom at which the weight of a landmark has fallen to a quarter (Geman-McClure)."""
AGREES = 0.5  #: Weight from which on a landmark agrees with the pose.
ENOUGH = 300  #: About as many landmarks are used: the error that a whole image has is larger than that of their mean.


class RightShift(NamedTuple):
    """Shift of right positions along the rows at the image centre, as by a yaw of the right camera."""

    px: float  #: Pixels to the right, beyond the corrections that the landmarks were made with.
    variance: float  #: Of it, px^2, by the landmarks alone; infinite without enough of them.
    #: Squared shear of the rows of both images, as by a rolling shutter, over its variance, per degree of freedom.
    shear: float
    uv: FloatArray  #: `(N, 2)` left pixels of the landmarks that agree with the pose,
    disparity: FloatArray  #: `(N,)` and what is left of their disparities, pixels.


def right_shift(
    pose: Pose, landmarks: LandmarkEstimates, observations: StereoObservations, camera: StereoCamera, lens_px: float
) -> RightShift:
    """Estimate the shift from a solved pair: one Gauss-Newton step of pose and shift together.

    The landmarks' depths come from pairs before. If the right camera has turned since, all right positions are shifted
    alike and the left ones are not: no motion explains that. The pose of the left camera was solved for without a
    shift; of the N landmarks those observed in both images count. Another step has a shear of each image as well: over
    flat ground it looks like a sideways motion, stones and the horizon tell it from one. What a lens leaves of the
    disparities, pixels, may look like it, too.
    """
    some = np.arange(0, len(observations.uv), max(1, len(observations.uv) // ENOUGH))
    both = some[np.isfinite(observations.uv[some, 0] + observations.uv[some, 2])]
    (rotations, positions), *others = landmarks
    marks = LandmarkEstimates(Poses(rotations[both], positions[both]), *(array[both] for array in others))
    seen = StereoObservations(*(array[both] for array in observations))
    whitening, by_pose, residuals, chi2 = solve_pose(pose, marks, seen, camera, 1).linearised
    weight = 1.0 / (1.0 + np.where(np.isnan(chi2), np.inf, chi2) / ROBUST_CHI2) ** 2
    if np.count_nonzero(weight) < 9:
        return RightShift(0.0, np.inf, 0.0, seen.uv[:0], seen.uv[:0, 0])
    x, y = camera.normalised(seen.uv[:, 2:]).T
    jacobian = np.zeros((len(both), 4, 9))
    jacobian[:, :, :6], jacobian[:, 2, 6], jacobian[:, 3, 6] = by_pose, 1.0 + x * x, x * y
    jacobian[:, 0, 7], jacobian[:, 2, 8] = camera.normalised(seen.uv[:, :2])[:, 1], y
    weighted = (whitening * weight[:, None, None] @ jacobian).reshape(-1, 9)
    information, rhs = weighted.T @ jacobian.reshape(-1, 9), weighted.T @ residuals.ravel()
    by_shift = np.linalg.solve(information[:7, :7], np.eye(7)[6])
    covariance = np.linalg.inv(information)
    sheared = (covariance @ rhs)[7:]
    covariance[7:, 7:] += np.eye(2) * (lens_px / np.abs(y).max()) ** 2
    shear = float(sheared @ np.linalg.solve(covariance[7:, 7:], sheared)) / 2.0
    agree = weight > AGREES
    disparity = residuals[agree, 2] - residuals[agree, 0]
    return RightShift(float(by_shift @ rhs[:7]), float(by_shift[6]), shear, seen.uv[agree, :2], disparity)

"""Registration of views: the motion of a pair that makes it agree with the pairs before, where they overlap.

Six parameters are estimated by robust least squares on range and grey level (Gauss-Newton with numerical derivatives),
coarse to fine in the images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.fusion import MIN_OVERLAP
from sfr_loc_map.mapping.multiview.pair_view import PairView, ViewImages, reproject_into_view
from sfr_loc_map.mapping.robust_statistics import cauchy_weight, mad_sigma

MAX_POINTS = 10_000  #: About this many points of each other view are compared.
BLURS_PX = (12.0, 5.0, 2.0, 0.7)  #: Scales of the compared images; a degree is a dozen pixels.
MAX_ITERATIONS = 6  #: Gauss-Newton steps at each scale.
DERIVATIVE_STEPS = np.array([2e-4] * 3 + [1e-3] * 3)  #: Steps of the numerical derivatives, rad and m.
CONVERGED_STEP = 1e-5  #: The estimate has converged if no parameter changes by more than this, rad and m.
PRIOR_SIGMAS = np.array([np.deg2rad(0.5)] * 3 + [0.02] * 3)
"""Standard deviations of a pose error, rad and m: they divide what rotation and translation explain equally well."""
ROBUST_SIGMAS = 3.0  #: Residuals of this many standard deviations have half the weight.
MIN_RESIDUAL_SIGMA = 1e-6  #: Added to the standard deviation of residuals, which must not be 0.
MAX_ROTATION_DEG = 2.0  #: Poses that would have to be rotated by more are not changed.
MAX_TRANSLATION_M = 0.1  #: Poses that would have to be moved by more are not changed.


class RegisteredViews(NamedTuple):
    """Result of the registration."""

    views: Sequence[PairView]  #: Views at their registered poses.
    findings: Findings = Findings()  #: Motions, and poses that could not be changed.


def register_views(views: Sequence[PairView], rig: StereoRig) -> RegisteredViews:
    """Return the views, each moved to fit those before where they overlap."""
    registered = [views[0]]
    findings = Findings()
    for number, view in enumerate(views[1:], start=1):
        motion = estimate_motion(registered, view, rig)
        if motion is None:
            registered.append(view)
            continue
        rotation_deg = float(np.rad2deg(np.linalg.norm(rotvec_from_matrix(motion.rotation))))
        translation_m = float(np.linalg.norm(motion.translation))
        is_plausible = rotation_deg <= MAX_ROTATION_DEG and translation_m <= MAX_TRANSLATION_M
        registered.append(view.with_pose(view.T_lm_left @ motion) if is_plausible else view)
        warning = (
            f"pair {number} would fit if moved by {rotation_deg:.1f} deg and {translation_m:.2f} m: more than "
            f"{MAX_ROTATION_DEG} deg or {MAX_TRANSLATION_M} m, its pose is left as given"
        )
        statistics = {f"pose_turned_deg_{number}": rotation_deg, f"pose_moved_m_{number}": translation_m}
        findings += Findings(statistics, () if is_plausible else (warning,))
    return RegisteredViews(registered, findings)


def estimate_motion(fixed: Sequence[PairView], moved: PairView, rig: StereoRig) -> Transform | None:
    """Return the motion of a view, in its left optical frame, that makes it agree best with the fixed views.

    Ranges and grey levels of the fixed views' points are compared with those of the view where they are projected to.
    None if the views overlap too little.
    """
    clouds = []
    for view in fixed:
        index = reproject_into_view(view.cloud, moved.T_lm_left, moved.images, rig).index
        stride = max(1, len(index) // MAX_POINTS)
        clouds.append(view.cloud.select(index[::stride]))
    if sum(len(cloud) for cloud in clouds) < MIN_OVERLAP:
        return None
    pose = moved.T_lm_left
    for blur_px in BLURS_PX:
        images = moved.images._replace(grey=moved.grey_image(blur_px))
        points = _with_blurred_grey(clouds, fixed, blur_px)
        for _ in range(MAX_ITERATIONS):
            step = _gauss_newton_step(points, images, pose, moved.T_lm_left, rig)
            if step is None:
                return None
            pose = pose @ _motion(step)
            if np.abs(step).max() < CONVERGED_STEP:
                break
    return moved.T_lm_left.inverse() @ pose


def _with_blurred_grey(clouds: Sequence[PointCloud], views: Sequence[PairView], blur_px: float) -> PointCloud:
    """Return the points of all clouds with the grey levels of their views' blurred images."""
    blurred = []
    for cloud, view in zip(clouds, views, strict=True):
        grey = view.grey_image(blur_px)
        blurred.append(replace(cloud, intensity=grey[cloud.v, cloud.u]))
    return PointCloud.concatenate(blurred)


def _motion(parameters: FloatArray) -> Transform:
    """Return the motion of a rotation vector and a translation `(6,)`."""
    return Transform(matrix_from_rotvec(parameters[:3]), parameters[3:].copy())


def _gauss_newton_step(
    points: PointCloud, images: ViewImages, pose: Transform, given_pose: Transform, rig: StereoRig
) -> FloatArray | None:
    """Return one step `(6,)`, rotation vector and translation in the left optical frame; None for too few points."""

    def residuals(parameters: FloatArray) -> FloatArray:
        """Return normalised range differences and grey level differences `(2, N)`; NaN where there are none."""
        seen = reproject_into_view(points, pose @ _motion(parameters), images, rig)
        sigma = np.sqrt(np.square(points.sigma[seen.index]) + np.square(seen.sigma))
        out = np.full((2, len(points)), np.nan)
        out[0, seen.index] = seen.difference / sigma
        out[1, seen.index] = seen.grey_difference
        return out

    current = residuals(np.zeros(6))
    derivatives = [(residuals(h) - residuals(-h)) / (2.0 * h.sum()) for h in np.diag(DERIVATIVE_STEPS)]
    jacobian = np.stack(derivatives, axis=2)
    motion = given_pose.inverse() @ pose
    prior_information = 1.0 / np.square(PRIOR_SIGMAS)
    normal = np.diag(prior_information)
    rhs = -prior_information * np.concatenate((rotvec_from_matrix(motion.rotation), motion.translation))
    for residual, derivative in zip(current, jacobian, strict=True):
        known = np.isfinite(residual) & np.isfinite(derivative).all(axis=1)
        if known.sum() < MIN_OVERLAP:
            return None
        r = residual[known]
        j = derivative[known]
        sigma = mad_sigma(r) + MIN_RESIDUAL_SIGMA
        weighted = j * (cauchy_weight(r, ROBUST_SIGMAS * sigma) / sigma**2)[:, None]
        normal = normal + weighted.T @ j
        rhs = rhs - weighted.T @ r
    return np.asarray(np.linalg.solve(normal, rhs))

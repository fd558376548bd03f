"""Registration of views: each pair is moved to agree with the earlier pairs where they overlap.

The six parameters of a motion maximise a posterior. The posterior combines the residuals of range and grey level, with
Cauchy weights that are updated in each step, and a normal prior on the error of the given pose. Gauss-Newton steps with
numerical derivatives find the maximum, coarse to fine in the blur of the grey levels.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatArray, FloatImage
from sfr_loc_map.geometry.robust_statistics import cauchy_weight, mad_sigma
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.multiview.projection import MIN_OVERLAP, project_into_view
from sfr_loc_map.mapping.pair_view import PairView, ViewImages, ViewPoints

ENOUGH_POINTS = 10_000
"""Points of each other view are thinned by an integer stride, so that one to two times this number remain."""
BLURS_PX = (12.0, 5.0, 2.0, 0.7)
"""Standard deviations of the Gaussians that blur the compared images, pixels, coarse to fine."""
MAX_STEPS_PER_BLUR = 6
"""Maximum number of Gauss-Newton steps at each blur. The next blur continues from an estimate that has not
converged."""
ROTATION_STEP_RAD = 2e-4  #: Step of the numerical derivatives: a sixth of a pixel at a focal length of 800 pixels.
TRANSLATION_STEP_M = 1e-3  #: Step of the numerical derivatives: a sixth of a pixel at 5 m and 800 pixels.
DERIVATIVE_STEPS = np.array([ROTATION_STEP_RAD] * 3 + [TRANSLATION_STEP_M] * 3)
"""Steps of the six parameters: rotation vector (rad) and translation (m)."""
CONVERGED_STEP = 1e-5  #: The estimate has converged if no parameter changes by more than this, rad and m: 0.01 pixels.
MAX_ROTATION_DEG = 2.0
"""Maximum rotation of a registered pose, deg. A larger rotation is reported but not applied, because registration
should not hide a faulty pose."""
MAX_TRANSLATION_M = 0.1
"""Maximum translation of a registered pose, metres. A larger translation is reported but not applied."""
PRIOR_SIGMAS = np.array([np.deg2rad(0.5)] * 3 + [0.02] * 3)
"""Standard deviations of the error of a given pose, rad and m: 0.5 deg and 0.02 m."""
POSE_HALF_WEIGHT_SIGMAS = 3.0  #: Residuals of this many standard deviations have half the weight (`cauchy_weight`).
SIGMA_OFFSET = 1e-6  #: Added to the standard deviation of residuals, which is a divisor.
MIN_COVERAGE = F(1e-3)  #: Lower bound of the fraction of a window with points, which is a divisor and must not be 0.


def register_views(views: Sequence[PairView], rig: StereoRig) -> tuple[list[PairView], Findings]:
    """Return the views, each moved to agree with the earlier views where they overlap.

    The findings contain the motions, and warnings for poses that could not be registered or were not changed.
    """
    registered = [views[0]]
    findings = Findings()
    for index, view in enumerate(views[1:], start=1):
        motion = _estimate_motion(registered, view, rig)
        moved, of_motion = _apply_motion(motion, view, index)
        registered.append(moved)
        findings += of_motion
    return registered, findings


def _apply_motion(motion: Transform | None, view: PairView, index: int) -> tuple[PairView, Findings]:
    """Return the view moved by a motion. The view is unchanged if the motion is unknown or exceeds the limits."""
    if motion is None:
        warning = (
            f"pair {index} has too few points in common with the earlier pairs to be registered: its pose is left as "
            "given"
        )
        return view, Findings(warnings=(warning,))
    rotation_deg = float(np.rad2deg(np.linalg.norm(rotvec_from_matrix(motion.rotation))))
    translation_m = float(np.linalg.norm(motion.translation))
    statistics = {f"pose_turned_deg_{index}": rotation_deg, f"pose_moved_m_{index}": translation_m}
    if rotation_deg <= MAX_ROTATION_DEG and translation_m <= MAX_TRANSLATION_M:
        return view.with_pose(view.T_lm_left @ motion), Findings(statistics)
    warning = (
        f"pair {index} would agree with the earlier pairs if moved by {rotation_deg:.1f} deg and {translation_m:.2f} "
        f"m: this exceeds {MAX_ROTATION_DEG} deg or {MAX_TRANSLATION_M} m, and its pose is left as given"
    )
    return view, Findings(statistics, (warning,))


def _estimate_motion(fixed: Sequence[PairView], moved: PairView, rig: StereoRig) -> Transform | None:
    """Return the motion of a view, in its left optical frame, that aligns the view best with the fixed views.

    The points of the fixed views are projected into the moved view, where ranges and grey levels are compared. Returns
    None if the views have too few common points, at the given pose or at one of the steps.
    """
    overlapping: list[ViewPoints] = []
    for view in fixed:
        indices = project_into_view(view.points.xyz, moved.T_lm_left, moved.images, rig).indices
        stride = max(1, len(indices) // ENOUGH_POINTS)
        overlapping.append(view.points.select(indices[::stride]))
    if sum(points.size for points in overlapping) < MIN_OVERLAP:
        return None
    pose = moved.T_lm_left
    for blur_px in BLURS_PX:
        images = moved.images._replace(grey=_blurred_grey(moved, blur_px))
        points = _with_blurred_grey(overlapping, fixed, blur_px)
        for _ in range(MAX_STEPS_PER_BLUR):
            step = _gauss_newton_step(points, images, pose, moved.T_lm_left, rig)
            if step is None:
                return None
            pose = pose @ _motion(step)
            if np.abs(step).max() < CONVERGED_STEP:
                break
    return moved.T_lm_left.inverse() @ pose


def _with_blurred_grey(parts: Sequence[ViewPoints], views: Sequence[PairView], blur_px: float) -> ViewPoints:
    """Return the points of all views with the grey levels of the views' blurred images."""
    blurred = []
    for points, view in zip(parts, views, strict=True):
        grey = _blurred_grey(view, blur_px)
        blurred.append(points._replace(intensity=grey[points.v, points.u]))
    return ViewPoints.concatenated(blurred)


def _blurred_grey(view: PairView, blur_px: float) -> FloatImage:
    """Return the grey levels `(H, W)` at points, blurred by a Gaussian over pixels with points; NaN elsewhere."""
    has_point = np.isfinite(view.images.grey)
    total = cv2.GaussianBlur(np.where(has_point, view.images.grey, F(0.0)), (0, 0), blur_px)
    coverage = cv2.GaussianBlur(has_point.astype(F), (0, 0), blur_px)
    return np.asarray(np.where(has_point, total / np.maximum(coverage, MIN_COVERAGE), F(np.nan)), F)


def _motion(parameters: FloatArray) -> Transform:
    """Return the motion of the parameters `(6,)`: rotation vector and translation."""
    return Transform(matrix_from_rotvec(parameters[:3]), parameters[3:].copy())


def _gauss_newton_step(
    points: ViewPoints, images: ViewImages, pose: Transform, given_pose: Transform, rig: StereoRig
) -> FloatArray | None:
    """Return one step `(6,)`, rotation vector and translation in the left optical frame; None for too few points.

    The prior applies to the motion relative to the given pose. Its Jacobian is approximated by the identity. A step
    changes the rotation vector of the motion by the inverse right Jacobian of this rotation, and the translation by the
    rotation itself. At `MAX_ROTATION_DEG` they differ from the identity by 1.7 and 3.5 %.
    """

    def residuals(parameters: FloatArray) -> FloatArray:
        """Return the normalised range differences and the grey level differences `(2, N)`; NaN where unobserved."""
        observed = project_into_view(points.xyz, pose @ _motion(parameters), images, rig)
        range_residuals = observed.difference / observed.difference_sigma(points.fusion_sigma)
        grey_residuals = observed.grey - points.intensity
        return np.array([range_residuals, grey_residuals], np.float64)

    current = residuals(np.zeros(6))
    derivatives = []
    for index, size in enumerate(DERIVATIVE_STEPS):
        change = np.zeros(6)
        change[index] = size
        derivatives.append((residuals(change) - residuals(-change)) / (2.0 * size))
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
        sigma = mad_sigma(r) + SIGMA_OFFSET
        weighted = j * (cauchy_weight(r, POSE_HALF_WEIGHT_SIGMAS * sigma) / sigma**2)[:, None]
        normal = normal + weighted.T @ j
        rhs = rhs - weighted.T @ r
    return np.asarray(np.linalg.solve(normal, rhs))

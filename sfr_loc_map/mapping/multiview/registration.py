"""Registration of views: the motion of a pair that makes it agree with other pairs where they overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.disparity.filters import mad_sigma
from sfr_loc_map.mapping.multiview.fusion import MIN_OVERLAP
from sfr_loc_map.mapping.multiview.pair_view import PairView, ViewImages, reproject_into_view

POINTS = 10_000
BLURS_PX = (12.0, 5.0, 2.0, 0.7)
"""Images are compared at these scales, coarse to fine, so that a degree (a dozen pixels) can be compensated."""
ITERATIONS = 6
DERIVATIVE_STEPS = np.array([2e-4] * 3 + [1e-3] * 3)  #: Steps of numerical derivatives, radians and metres.
CONVERGED_STEP = 1e-5  #: Radians and metres: less than what the last image row of a pair can show.
PRIOR_SIGMAS = np.array([np.deg2rad(0.5)] * 3 + [0.02] * 3)
"""Standard deviations of a pose error, radians and metres: where rotation and translation look alike, they share."""
TAIL = 3.0  #: Residuals of so many standard deviations have half their weight.
MAX_ROTATION_DEG, MAX_TRANSLATION_M = 2.0, 0.1
"""Poses that would have to be moved farther are left as given, with a warning."""


def register_views(
    views: Sequence[PairView], rig: StereoRig
) -> tuple[list[PairView], dict[str, float], tuple[str, ...]]:
    """Return views moved to fit those before, where they overlap, how far, and what could not be done."""
    registered, statistics, warnings = [views[0]], {}, []
    for number, view in enumerate(views[1:], start=1):
        motion = estimate_motion(registered, view, rig)
        if motion is not None:
            turned_deg = float(np.rad2deg(np.linalg.norm(rotvec_from_matrix(motion.rotation))))
            moved_m = float(np.linalg.norm(motion.translation))
            statistics[f"pose_turned_deg_{number}"] = turned_deg
            statistics[f"pose_moved_m_{number}"] = moved_m
            if turned_deg <= MAX_ROTATION_DEG and moved_m <= MAX_TRANSLATION_M:
                view = view.with_pose(view.T_lm_left @ motion)
            else:
                warnings.append(
                    f"pair {number} would fit if moved by {turned_deg:.1f} deg and {moved_m:.2f} m: that is beyond "
                    f"{MAX_ROTATION_DEG} deg or {MAX_TRANSLATION_M} m, its pose is left as given"
                )
        registered.append(view)
    return registered, statistics, tuple(warnings)


def estimate_motion(fixed: Sequence[PairView], moved: PairView, rig: StereoRig) -> Transform | None:
    """Return the motion of a view, in its left optical frame, that makes it agree best with others.

    Ranges and grey levels of the others' points are compared with those of the view where they fall; six parameters,
    robust least squares (Gauss-Newton, numerical derivatives), coarse to fine in the images. None where they overlap
    too little.
    """
    clouds = []
    for view in fixed:
        index = reproject_into_view(view.cloud, moved.T_lm_left, moved.images, rig).index
        clouds.append(view.cloud.select(index[:: max(1, len(index) // POINTS)]))
    if sum(len(cloud) for cloud in clouds) < MIN_OVERLAP:
        return None
    pose = moved.T_lm_left
    for blur in BLURS_PX:
        blurred = moved.images._replace(grey=moved.grey_image(blur))
        pairs = zip(clouds, (view.grey_image(blur) for view in fixed), strict=True)
        points = PointCloud.concatenate([replace(cloud, intensity=grey[cloud.v, cloud.u]) for cloud, grey in pairs])
        for _ in range(ITERATIONS):
            step = _gauss_newton_step(points, blurred, pose, moved.T_lm_left, rig)
            if step is None:
                return None
            pose = pose @ _motion(step)
            if np.abs(step).max() < CONVERGED_STEP:
                break
    return moved.T_lm_left.inverse() @ pose


def _motion(parameters: FloatArray) -> Transform:
    return Transform(matrix_from_rotvec(parameters[:3]), parameters[3:].copy())


def _gauss_newton_step(
    points: PointCloud, images: ViewImages, pose: Transform, given: Transform, rig: StereoRig
) -> FloatArray | None:
    """Return one step `(6,)`, rotation vector and translation in the left optical frame; None for too few points."""

    def residuals(parameters: FloatArray) -> FloatArray:
        """Return differences of range over standard deviation, and of grey level `(2, N)`; NaN where there are none."""
        seen = reproject_into_view(points, pose @ _motion(parameters), images, rig)
        out = np.full((2, len(points)), np.nan)
        out[0, seen.index] = seen.difference / np.sqrt(np.square(points.sigma[seen.index]) + np.square(seen.deviation))
        out[1, seen.index] = seen.grey_difference
        return out

    present = residuals(np.zeros(6))
    differences = [(residuals(h) - residuals(-h)) / (2.0 * h.sum()) for h in np.diag(DERIVATIVE_STEPS)]
    jacobian = np.stack(differences, axis=2)
    moved = given.inverse() @ pose
    information = 1.0 / np.square(PRIOR_SIGMAS)
    normal = np.diag(information)
    rhs = -information * np.concatenate((rotvec_from_matrix(moved.rotation), moved.translation))
    for r, j in zip(present, jacobian, strict=True):
        known = np.isfinite(r) & np.isfinite(j).all(axis=1)
        if known.sum() < MIN_OVERLAP:
            return None
        r, j = r[known], j[known]
        scale = mad_sigma(r) + 1e-6
        weighted = j * (1.0 / (1.0 + np.square(r / (TAIL * scale))) / scale**2)[:, None]
        normal = normal + weighted.T @ j
        rhs = rhs - weighted.T @ r
    return np.asarray(np.linalg.solve(normal, rhs))

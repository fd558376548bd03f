"""How far a pair's pose must be moved for it to agree with another pair where they overlap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.fusion import LEAST_OVERLAP, Seen, View, looked_up, weight_picture

F = np.float32

POINTS = 10_000
BLURS_PX = (12.0, 5.0, 2.0, 0.7)
"""Pictures are compared at these scales, coarse to fine, so that a degree (a dozen pixels) can be made up for."""
ROUNDS = 6
STEP_TURN, STEP_SHIFT = 2e-4, 1e-3
"""Steps of numerical derivatives, radians and metres."""
SMALL_STEP = 1e-5
"""Radians and metres: less than what the last picture row of a pair can show."""
USUAL_TURN, USUAL_SHIFT = np.deg2rad(0.5), 0.02
"""Standard deviations of a pose error before anything is seen: where turns and shifts look alike, they share."""
TAIL = 3.0
"""Residuals of so many standard deviations have half their weight."""
MAX_TURN_DEG, MAX_SHIFT_M = 2.0, 0.1
"""Poses that would have to be moved farther are left and named."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Pairs with poses that fit each other.

    Attributes:
        views: The pairs.
        statistics: How far each pose was moved, by name.
        warnings: What could not be done, one line each.
    """

    views: Sequence[View]
    statistics: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What must be done to a pose.

    Attributes:
        T_left_left: Takes points of the left optical frame as posed to where they should be in that frame.
        turn_deg: Its angle.
        shift_m: Its length.
    """

    T_left_left: Transform
    turn_deg: float
    shift_m: float


def fitted(views: Sequence[View], rig: StereoRig) -> Fit:
    """Return pairs with the second and third moved to fit those before; poses of pairs without overlap stay."""
    done, statistics, warnings = [views[0]], {}, []
    for number, view in enumerate(views[1:], start=1):
        found = correction(done, view, rig)
        if found is None:
            done.append(view)
            continue
        statistics[f"pose_turned_deg_{number}"] = found.turn_deg
        statistics[f"pose_moved_m_{number}"] = found.shift_m
        if found.turn_deg > MAX_TURN_DEG or found.shift_m > MAX_SHIFT_M:
            warnings.append(
                f"pair {number} would fit if moved by {found.turn_deg:.1f} deg and {found.shift_m:.2f} m: that is "
                f"beyond {MAX_TURN_DEG} deg or {MAX_SHIFT_M} m, its pose is left as given"
            )
            done.append(view)
            continue
        done.append(_moved(view, found.T_left_left))
    return Fit(done, statistics, tuple(warnings))


def _moved(view: View, T_left_left: Transform) -> View:
    pose = view.T_lm_left @ T_left_left
    cloud = view.cloud
    xyz = (pose @ view.T_lm_left.inverse()).apply(cloud.xyz).astype(F)
    turned = PointCloud(xyz, cloud.sigma, cloud.intensity, cloud.u, cloud.v, cloud.pair)
    return View(turned, view.disparity_px, pose, view.noise_grey)


def correction(fixed: Sequence[View], moved: View, rig: StereoRig) -> Correction | None:
    """Return the motion of a pair that makes it agree best with others, None where they overlap too little.

    Ranges and grey levels of the others' points are compared with what the pair has where they fall; six parameters,
    robust least squares (Gauss-Newton, numerical derivatives), coarse to fine in the pictures.

    Args:
        fixed: Pairs whose poses are taken as right.
        moved: The pair.
        rig: Rig of all.
    """
    pose = moved.T_lm_left
    weight = weight_picture(moved)
    clouds = [_seen_part(view, moved, weight, rig) for view in fixed]
    if sum(len(cloud) for cloud in clouds) < LEAST_OVERLAP:
        return None
    for blur in BLURS_PX:
        picture = _smooth(moved, blur)
        points = _with_grey(clouds, [_smooth(view, blur) for view in fixed])
        for _ in range(ROUNDS):
            step = _step(points, moved, pose, weight, picture, rig, moved.T_lm_left)
            if step is None:
                return None
            pose = pose @ _motion(step)
            if np.abs(step).max() < SMALL_STEP:
                break
    total = moved.T_lm_left.inverse() @ pose
    turn = float(np.rad2deg(np.linalg.norm(rotvec_from_matrix(total.rotation))))
    return Correction(total, turn, float(np.linalg.norm(total.translation)))


def _seen_part(view: View, moved: View, weight: FloatImage, rig: StereoRig) -> PointCloud:
    """Return an even choice of a pair's points that the other sees as well, as posed now."""
    index = looked_up(view.cloud, moved, weight, _smooth(moved, 0.0), rig).index
    return view.cloud.select(index[:: max(1, len(index) // POINTS)])


def _smooth(view: View, blur_px: float) -> FloatImage:
    """Return the left picture where there are points, smoothed over these alone, NaN elsewhere."""
    known = np.zeros(view.disparity_px.shape, F)
    grey = np.zeros_like(known)
    known[view.cloud.v, view.cloud.u] = 1.0
    grey[view.cloud.v, view.cloud.u] = view.cloud.intensity
    if blur_px > 0.0:
        total, share = (cv2.GaussianBlur(image, (0, 0), blur_px) for image in (grey, known))
        grey = np.asarray(total / np.maximum(share, F(1e-3)), F)
    grey[known == 0.0] = np.nan
    return grey


def _with_grey(clouds: list[PointCloud], pictures: list[FloatImage]) -> PointCloud:
    """Return all points with the grey level of the smoothed pictures."""
    turned = [
        PointCloud(cloud.xyz, cloud.sigma, picture[cloud.v, cloud.u], cloud.u, cloud.v, cloud.pair)
        for cloud, picture in zip(clouds, pictures, strict=True)
    ]
    return PointCloud.concatenate(turned)


def _motion(parameters: FloatArray) -> Transform:
    return Transform(matrix_from_rotvec(parameters[:3]), parameters[3:].copy())


def _step(
    points: PointCloud,
    moved: View,
    pose: Transform,
    weight: FloatImage,
    picture: FloatImage,
    rig: StereoRig,
    given: Transform,
) -> FloatArray | None:
    """Return one Gauss-Newton step `(6,)`: rotation vector and translation in the left optical frame."""

    def residuals(parameters: FloatArray) -> FloatArray:
        view = View(moved.cloud, moved.disparity_px, pose @ _motion(parameters), moved.noise_grey)
        return _residuals(points, looked_up(points, view, weight, picture, rig))

    steps = np.array([STEP_TURN] * 3 + [STEP_SHIFT] * 3)
    here = residuals(np.zeros(6))
    derivative = np.stack([(residuals(one) - residuals(-one)) / (2.0 * one.sum()) for one in np.diag(steps)], axis=2)
    sofar = given.inverse() @ pose
    past = np.concatenate((rotvec_from_matrix(sofar.rotation), sofar.translation))
    usual = 1.0 / np.square(np.array([USUAL_TURN] * 3 + [USUAL_SHIFT] * 3))
    normal, right = np.diag(usual), -usual * past
    for r, d in zip(here, derivative, strict=True):
        known = np.isfinite(r) & np.isfinite(d).all(axis=1)
        if known.sum() < LEAST_OVERLAP:
            return None
        r, d = r[known], d[known]
        scale = 1.4826 * float(np.median(np.abs(r))) + 1e-6
        robust = 1.0 / (1.0 + np.square(r / (TAIL * scale))) / scale**2
        normal = normal + (d * robust[:, None]).T @ d
        right = right - (d * robust[:, None]).T @ r
    return np.asarray(np.linalg.solve(normal, right))


def _residuals(points: PointCloud, seen: Seen) -> FloatArray:
    """Return differences of range over standard deviation, and of grey level `(2, N)`; NaN where there are none."""
    out = np.full((2, len(points)), np.nan)
    out[0, seen.index] = seen.difference / np.sqrt(np.square(points.sigma[seen.index]) + np.square(seen.deviation))
    out[1, seen.index] = seen.grey_difference
    return out

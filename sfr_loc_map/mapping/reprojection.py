"""From a disparity image to points in LM, and the part of their standard deviation that all points share.

The calibration is known to so much only. A constant error of the disparity, as a yaw of the right camera makes it, is
an error of `Z^2 / (fx baseline)` of the depth for each pixel. No pair can tell it from depth, and no mean over points
or pairs removes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage, IntArray
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.config import CalibrationUncertainty
from sfr_loc_map.mapping.disparity.right_camera import MIN_ROLL_PX, CameraRotation

MEASURED_SIGMAS = 3.0  #: A yaw counts as measured from so many of its standard deviations on.
MIN_WARNING_DEG = 0.02  #: Less yaw than this is not warned of, however well the calibration is said to be known.


def cloud_from_disparity(
    disparity_px: FloatImage, sigma_px: FloatImage, left: GreyImage, rig: StereoRig, T_lm_left: Transform, index: int
) -> PointCloud:
    """Return the points of all pixels that have a disparity.

    `Z = fx baseline / d`; the ray of pixel (u, v) is `((u - cx) / fx, (v - cy) / fy, 1)` in the left optical frame; to
    first order the standard deviation along the ray is `|ray| Z^2 / (fx baseline) sigma_d`.

    The disparity `(H, W)` is NaN where there is none; `index` is the number of the pair within its set.
    """
    ends = np.cumsum(np.isfinite(disparity_px).sum(axis=1))
    columns = _reproject(disparity_px, sigma_px, left, rig.camera, Pose.of(T_lm_left), ends)
    return PointCloud(*columns, np.full(ends[-1], index, np.uint8), fused=False)


@jit_rows
def _reproject(
    disparity: FloatImage, deviation: FloatImage, left: GreyImage, camera: StereoCamera, pose: Pose, ends: IntArray
) -> tuple[FloatImage, FloatImage, FloatImage, NDArray[np.uint16], NDArray[np.uint16]]:
    """Return the columns of a cloud, filled row by row; `ends` `(H,)` counts the points up to the end of each row."""
    rows, cols = disparity.shape
    count = ends[-1]
    xyz, sigma, intensity = np.empty((count, 3), np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    u, v = np.empty(count, np.uint16), np.empty(count, np.uint16)
    rotation, position = pose.rotation, pose.position
    scale = camera.fx * camera.baseline_m
    for i in prange(rows):
        n = ends[i - 1] if i > 0 else 0
        ray_y = (i - camera.cy) / camera.fy
        for j in range(cols):
            if not np.isfinite(disparity[i, j]):
                continue
            depth = scale / np.float64(disparity[i, j])
            ray_x = (j - camera.cx) / camera.fx
            length = np.sqrt(ray_x * ray_x + ray_y * ray_y + 1.0)
            for k in range(3):
                along = rotation[k, 0] * ray_x + rotation[k, 1] * ray_y + rotation[k, 2]
                xyz[n, k] = depth * along + position[k]
            sigma[n] = length * depth * depth / scale * deviation[i, j]
            intensity[n] = left[i, j]
            u[n], v[n] = j, i
            n += 1
    return xyz, sigma, intensity, u, v


class CalibrationSigma(NamedTuple):
    """Standard deviations of a calibration as kernels take them: angles of the right camera in rad, shares."""

    yaw: float
    pitch: float
    roll: float
    focal: float
    baseline: float
    distortion: float  # along rows, as an angle


NO_CALIBRATION = CalibrationSigma(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  #: A calibration that is exact.


def check_calibration(
    stated: CalibrationUncertainty, rotation: CameraRotation, rig: StereoRig
) -> tuple[CalibrationSigma, tuple[str, ...]]:
    """Return the uncertainty of a calibration after a pair was seen, and what is suspicious, one line each.

    Left-over distortion makes the saddle of a yaw as well: a yaw is measured no more surely than the stated distortion
    allows. One that is measured is added to the uncertainty, not taken out of the map. A vertical offset larger than
    the stated distortion may be a pitch, and is added as one. Roll has been taken out where it is measured. All other
    vertical disparity is left-over distortion, and the disparity is as uncertain; not where none is stated.
    """
    yaw, pitch, roll = (math.radians(value) for value in (stated.yaw_deg, stated.pitch_deg, stated.roll_deg))
    warnings: tuple[str, ...] = ()
    saddle = 0.25 * rig.width * rig.height / (rig.fx * rig.fy)  # x y in the corner
    doubt = math.hypot(rotation.yaw_sigma_rad, stated.distortion_px / (rig.fy * saddle), yaw)
    if abs(rotation.yaw_rad) > max(MEASURED_SIGMAS * doubt, math.radians(MIN_WARNING_DEG)):
        yaw_deg = math.degrees(rotation.yaw_rad)
        side = "right" if yaw_deg > 0 else "left"
        warnings = (
            f"the right camera seems to look {abs(yaw_deg):.3f} deg to the {side} of its calibration (vertical "
            "disparity has the saddle of a yaw): all depths err alike, sigma is widened; calibrate the cameras",
        )
        yaw = math.hypot(yaw, rotation.yaw_rad)
    if abs(rotation.pitch_rad) * rig.fy > max(stated.distortion_px, MIN_ROLL_PX):
        pitch = math.hypot(pitch, rotation.pitch_rad)
    distortion_px = min(rotation.vertical_px, max(stated.distortion_px, rotation.bent_px))
    if not stated.distortion_px:
        distortion_px = 0.0
    shares = stated.focal_share, stated.baseline_share
    return CalibrationSigma(yaw, pitch, roll, *shares, distortion_px / rig.fx), warnings


def total_sigma(
    cloud: PointCloud, T_lm_left: Sequence[Transform], rig: StereoRig, calibration: CalibrationSigma
) -> NDArray[np.float32]:
    """Return the standard deviation along the ray of each point `(N,)`, metres, with the calibration's part.

    With range r, disparity d and normalised coordinates (x, y) of the left pixel and (xr, y) of the right one the
    variance is `sigma^2 + r^2 (a^2 (fx / d)^2 + focal^2 + baseline^2)`, where
    `a^2 = (yaw (1 + xr^2))^2 + (pitch xr y)^2 + (roll y)^2 + distortion^2`.

    Poses of the left cameras are in the order of the points' `pair`.
    """
    axes = np.stack([pose.rotation[:, 2] for pose in T_lm_left])
    centres = np.stack([pose.translation for pose in T_lm_left])
    columns = cloud.xyz, cloud.sigma, cloud.u, cloud.v, cloud.pair
    return _total_sigma(*columns, axes, centres, rig.camera, calibration)


@jit_rows
def _total_sigma(
    xyz: NDArray[np.float32],
    sigma: NDArray[np.float32],
    us: NDArray[np.uint16],
    vs: NDArray[np.uint16],
    pairs: NDArray[np.uint8],
    axes: FloatArray,
    centres: FloatArray,
    camera: StereoCamera,
    calibration: CalibrationSigma,
) -> NDArray[np.float32]:
    total = np.empty(len(sigma), np.float32)
    yaw, pitch, roll = calibration.yaw, calibration.pitch, calibration.roll
    distortion = calibration.distortion * calibration.distortion
    scale = calibration.focal * calibration.focal + calibration.baseline * calibration.baseline
    for n in prange(len(total)):
        pair = pairs[n]
        depth = 0.0
        for k in range(3):
            depth += axes[pair, k] * (np.float64(xyz[n, k]) - centres[pair, k])
        x, y = (us[n] - camera.cx) / camera.fx, (vs[n] - camera.cy) / camera.fy
        right = x - camera.baseline_m / depth
        by_yaw, by_pitch, by_roll = yaw * (1.0 + right * right), pitch * right * y, roll * y
        angle = by_yaw * by_yaw + by_pitch * by_pitch + by_roll * by_roll + distortion
        share = angle * (depth / camera.baseline_m) ** 2 + scale
        reach = depth * depth * (x * x + y * y + 1.0)
        total[n] = np.sqrt(np.float64(sigma[n]) * sigma[n] + reach * share)
    return total

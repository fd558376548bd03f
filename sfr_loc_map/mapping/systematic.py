"""The part of a point's standard deviation that all points share: the calibration is known to so much only.

A constant error of the disparity, as a yaw of the right camera makes it, is an error of `Z^2 / (fx baseline)` of the
depth for each pixel. No pair can tell it from depth, and no mean over points or pairs removes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.config import CalibrationUncertainty
from sfr_loc_map.mapping.disparity.camera_rotation import MIN_ROLL_PX, CameraRotation

MEASURED_SIGMAS = 5.0
"""A yaw counts as measured from so many of its standard deviations on."""
WARNING_FACTOR = 2.0
"""A measured yaw is warned of from so many standard deviations of the calibration on."""
MIN_WARNING_DEG = 0.02
"""Less yaw than this is not warned of, however well the calibration is said to be known."""


class CalibrationSigma(NamedTuple):
    """Standard deviations of a calibration as kernels take them: angles of the right camera in rad, shares."""

    yaw: float
    pitch: float
    roll: float
    focal: float
    baseline: float


@dataclass(frozen=True, slots=True)
class CalibrationCheck:
    """What a pair says of its calibration.

    Attributes:
        sigma: The stated uncertainty, widened by what the pair shows.
        warnings: What is suspicious, one line each.
    """

    sigma: CalibrationSigma
    warnings: tuple[str, ...]


def check_calibration(stated: CalibrationUncertainty, rotation: CameraRotation, rig: StereoRig) -> CalibrationCheck:
    """Return the uncertainty of a calibration after a pair was seen.

    A yaw that is measured and larger than stated is added to the uncertainty, not taken out of the map: a lens that is
    not modelled well makes a saddle as well. A vertical offset may be a pitch, and is added as one. Roll has been taken
    out where it is measured.
    """
    yaw, pitch, roll = (math.radians(value) for value in (stated.yaw_deg, stated.pitch_deg, stated.roll_deg))
    measured = abs(rotation.yaw_rad) > max(yaw, MEASURED_SIGMAS * rotation.yaw_sigma_rad)
    warnings: tuple[str, ...] = ()
    if measured:
        yaw_deg = math.degrees(rotation.yaw_rad)
        if abs(yaw_deg) > max(WARNING_FACTOR * stated.yaw_deg, MIN_WARNING_DEG):
            side = "right" if yaw_deg > 0 else "left"
            warnings = (
                f"the right camera seems to look {abs(yaw_deg):.3f} deg to the {side} of its calibration (vertical "
                "disparity has the saddle of a yaw): all depths err alike, sigma is widened; calibrate the cameras",
            )
        yaw = math.hypot(yaw, rotation.yaw_rad)
    if abs(rotation.pitch_rad) * rig.fy > MIN_ROLL_PX:
        pitch = math.hypot(pitch, rotation.pitch_rad)
    sigma = CalibrationSigma(yaw, pitch, roll, stated.focal_share, stated.baseline_share)
    return CalibrationCheck(sigma, warnings)


def widest(sigmas: Sequence[CalibrationSigma]) -> CalibrationSigma:
    """Return the largest of each: pairs of one rig share its calibration."""
    return CalibrationSigma(*(max(values) for values in zip(*sigmas, strict=True)))


def total_sigma(
    cloud: PointCloud, T_lm_left: Sequence[Transform], rig: StereoRig, calibration: CalibrationSigma
) -> NDArray[np.float32]:
    """Return the standard deviation along the ray of each point `(N,)`, metres, with the calibration's part.

    With range r, disparity d and normalised coordinates (x, y) of the left pixel and (xr, y) of the right one the
    variance is `sigma^2 + r^2 ((fx / d)^2 ((yaw (1 + xr^2))^2 + (pitch xr y)^2 + (roll y)^2) + focal^2 + baseline^2)`.

    Args:
        cloud: Points in LM with the sigma of noise and smoothing.
        T_lm_left: Pose of the left camera of each pair, in the order of the points' `pair`.
        rig: Rig of all pairs.
        calibration: Standard deviations of its calibration.
    """
    total = np.empty(len(cloud), np.float32)
    poses = _Views(
        np.stack([pose.rotation[:, 2] for pose in T_lm_left]), np.stack([pose.translation for pose in T_lm_left])
    )
    points = _Points(cloud.xyz, cloud.sigma, cloud.u, cloud.v, cloud.pair)
    _add_calibration(points, poses, rig.camera, calibration, total)
    return total


class _Points(NamedTuple):
    """Columns of a cloud of N points, as `PointCloud` describes them."""

    xyz: NDArray[np.float32]
    sigma: NDArray[np.float32]
    u: NDArray[np.uint16]
    v: NDArray[np.uint16]
    pair: NDArray[np.uint8]


class _Views(NamedTuple):
    """Optical axes `(P, 3)` and centres `(P, 3)` of the left cameras in LM."""

    axes: FloatArray
    centres: FloatArray


@jit_rows
def _add_calibration(
    points: _Points, views: _Views, camera: StereoCamera, calibration: CalibrationSigma, total: NDArray[np.float32]
) -> None:
    """Fill the total standard deviation of each point `(N,)`."""
    xyz, sigma, us, vs, pairs = points.xyz, points.sigma, points.u, points.v, points.pair
    axes, centres = views.axes, views.centres
    yaw, pitch, roll = calibration.yaw, calibration.pitch, calibration.roll
    scale = calibration.focal * calibration.focal + calibration.baseline * calibration.baseline
    for n in prange(len(total)):
        pair = pairs[n]
        depth = 0.0
        for k in range(3):
            depth += axes[pair, k] * (np.float64(xyz[n, k]) - centres[pair, k])
        x, y = (us[n] - camera.cx) / camera.fx, (vs[n] - camera.cy) / camera.fy
        right = x - camera.baseline_m / depth
        by_yaw, by_pitch, by_roll = yaw * (1.0 + right * right), pitch * right * y, roll * y
        angle = by_yaw * by_yaw + by_pitch * by_pitch + by_roll * by_roll
        share = angle * (depth / camera.baseline_m) ** 2 + scale
        reach = depth * depth * (x * x + y * y + 1.0)
        total[n] = np.sqrt(np.float64(sigma[n]) * sigma[n] + reach * share)

"""The uncertainty of the calibration given what a pair shows of its right camera.

What vertical disparity means depends on the residual distortion that is configured (`CalibrationUncertainty`):

- A yaw is reported, and increases sigma, beyond `SIGNIFICANT_SIGMAS` standard deviations, of which a saddle of vertical
  disparity as large as the distortion in the corners is a part (`_yaw_threshold_rad`).
- A vertical offset beyond the distortion, at least `MIN_ROTATION_PX`, increases sigma as a pitch
  (`_pitch_threshold_px`).
- Vertical disparity beyond a multiple of the distortion is reported by a warning (`pair_findings.vertical_warning_px`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import CalibrationUncertainty
from sfr_loc_map.mapping.disparity.right_camera import MIN_ROTATION_PX, CameraRotation

SIGNIFICANT_SIGMAS = 3.0  #: A yaw is significant from this many of its standard deviations on: 0.3 % by chance.
MIN_SIGNIFICANT_YAW_DEG = 0.02
"""Smallest significant yaw, deg, however small the configured uncertainty is: at a focal length of 800 pixels it
changes disparities by 0.3 pixels."""


class CalibrationSigma(NamedTuple):
    """Standard deviations of a calibration given a pair, in rad and fractions; the default is an exact calibration.

    `CalibrationUncertainty` has those that are configured, in deg and pixels.
    """

    yaw_rad: float = 0.0  #: Of the right camera.
    pitch_rad: float = 0.0  #: Of the right camera.
    roll_rad: float = 0.0  #: Of the right camera.
    focal_fraction: float = 0.0  #: Of the focal length.
    baseline_fraction: float = 0.0  #: Of the baseline.
    distortion_rad: float = 0.0  #: Residual distortion along rows, as an angle.


def is_yaw_significant(rotation: CameraRotation, rig: StereoRig, configured: CalibrationUncertainty) -> bool:
    """Return whether the measured yaw exceeds what noise and the configured uncertainty of the calibration explain."""
    return abs(rotation.yaw_rad) > _yaw_threshold_rad(rotation, rig, configured)


def _yaw_threshold_rad(rotation: CameraRotation, rig: StereoRig, configured: CalibrationUncertainty) -> float:
    """Return the largest yaw that is not significant, rad.

    Residual distortion causes the saddle of a yaw as well. Its configured root mean square, taken as the value of such
    a saddle in the corners, limits the accuracy of the yaw.
    """
    corner_saddle = 0.25 * rig.width * rig.height / (rig.fx * rig.fy)  # x y in the corner, normalised coordinates
    distortion_rad = configured.distortion_px / (rig.fy * corner_saddle)
    sigma_rad = math.hypot(rotation.yaw_sigma_rad, distortion_rad, math.radians(configured.yaw_deg))
    return max(SIGNIFICANT_SIGMAS * sigma_rad, math.radians(MIN_SIGNIFICANT_YAW_DEG))


def _pitch_threshold_px(configured: CalibrationUncertainty) -> float:
    """Return the largest vertical offset that residual distortion explains, pixels; a larger one may be a pitch."""
    return max(configured.distortion_px, MIN_ROTATION_PX)


def calibration_sigma(rotation: CameraRotation, rig: StereoRig, configured: CalibrationUncertainty) -> CalibrationSigma:
    """Return the uncertainty of the calibration given what a pair shows of the right camera.

    A significant yaw is added to the configured uncertainty; it is not compensated. A vertical offset beyond
    `_pitch_threshold_px` is added as a pitch and not reported. Roll is compensated (`without_roll`).

    Residual distortion causes an error along rows of the size of the vertical disparity. An offset and a roll may have
    other causes. With the root mean squares over the image of all vertical disparity and of its rest without offset and
    roll, the distortion is

        min(max(configured, rest), all)    if the vertical disparity was measured
        max(configured, rest)              otherwise; the rest is then what the correction has removed
        0                                  if the configured one is 0
    """
    yaw_rad = math.radians(configured.yaw_deg)
    if is_yaw_significant(rotation, rig, configured):
        yaw_rad = math.hypot(yaw_rad, rotation.yaw_rad)
    pitch_rad = math.radians(configured.pitch_deg)
    if abs(rotation.pitch_rad) * rig.fy > _pitch_threshold_px(configured):
        pitch_rad = math.hypot(pitch_rad, rotation.pitch_rad)
    distortion_px = 0.0
    if configured.distortion_px > 0.0:
        distortion_px = max(configured.distortion_px, rotation.distortion_rms_px)
        if rotation.is_measured:
            distortion_px = min(distortion_px, rotation.vertical_rms_px)
    return CalibrationSigma(
        yaw_rad=yaw_rad,
        pitch_rad=pitch_rad,
        roll_rad=math.radians(configured.roll_deg),
        focal_fraction=configured.focal_share,
        baseline_fraction=configured.baseline_share,
        distortion_rad=distortion_px / rig.fx,
    )


def largest_of(calibrations: Iterable[CalibrationSigma]) -> CalibrationSigma:
    """Return the largest standard deviation of each part: pairs of one rig share its calibration."""
    return CalibrationSigma(*(max(values) for values in zip(*calibrations, strict=True)))

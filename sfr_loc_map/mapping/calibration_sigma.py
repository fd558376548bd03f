"""The uncertainty of the calibration given the rotation of the right camera that is measured in a pair.

The configured residual distortion (`CalibrationPrior.distortion_px`) sets the thresholds of vertical disparity:

- A yaw above `SIGNIFICANT_SIGMAS` standard deviations is reported and increases sigma. Residual distortion can appear
  as a yaw, up to the yaw whose vertical disparity in the image corners equals the configured distortion. The standard
  deviation combines this apparent yaw, the noise of the measured yaw and the configured uncertainty of the yaw
  (`_yaw_threshold_rad`).
- A vertical offset that exceeds both the distortion and `MIN_ROTATION_PX` is treated as a pitch error and increases
  sigma accordingly. The threshold contains no noise, because an offset is measured to a few hundredths of a pixel.
- Vertical disparity above a multiple of the distortion causes a warning (`pair_findings.vertical_warning_px`).

A larger configured distortion therefore increases sigma, but also raises the yaw, the offset and the vertical disparity
that remain without effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import CalibrationPrior
from sfr_loc_map.mapping.disparity.right_camera.rotation import MIN_ROTATION_PX, CameraRotation

SIGNIFICANT_SIGMAS = 3.0  #: A yaw above this many standard deviations is significant: 0.3 % by chance.
MIN_SIGNIFICANT_YAW_DEG = 0.02  #: Lower bound of a significant yaw, deg.


class CalibrationSigma(NamedTuple):
    """Standard deviations of the calibration error given the measurements in a pair; by default an exact calibration.

    `CalibrationPrior` contains the configured standard deviations, in degrees and pixels.
    """

    yaw_rad: float = 0.0  #: Yaw of the right camera.
    pitch_rad: float = 0.0  #: Pitch of the right camera.
    roll_rad: float = 0.0  #: Roll of the right camera.
    focal_fraction: float = 0.0  #: Focal length, as a fraction.
    baseline_fraction: float = 0.0  #: Baseline, as a fraction.
    distortion_rad: float = 0.0  #: Residual distortion along rows, as an angle.


def is_yaw_significant(rotation: CameraRotation, rig: StereoRig, prior: CalibrationPrior) -> bool:
    """Return whether the measured yaw exceeds what noise and the configured uncertainty of the calibration explain."""
    if rotation.yaw_sigma_rad is None:
        return False
    return abs(rotation.yaw_rad) > _yaw_threshold_rad(rotation.yaw_sigma_rad, rig, prior)


def _yaw_threshold_rad(yaw_sigma_rad: float, rig: StereoRig, prior: CalibrationPrior) -> float:
    """Return the largest yaw that is not significant, rad, given the standard deviation of the measured yaw.

    The vertical disparity of a yaw is a saddle over the image, and residual distortion can have the same shape. The
    accuracy of the yaw is therefore limited to the yaw whose saddle equals the configured distortion in the corners.

    The saddle is computed about the image centre even if the principal point is elsewhere. A saddle about the principal
    point differs only by an offset and a tilt, which are fitted separately and do not indicate a yaw.
    """
    # (x - x of the image centre) (y - y of the image centre) in the corner, normalised coordinates
    corner_saddle = 0.25 * rig.width * rig.height / (rig.fx * rig.fy)
    distortion_rad = prior.distortion_px / (rig.fy * corner_saddle)
    sigma_rad = math.hypot(yaw_sigma_rad, distortion_rad, math.radians(prior.yaw_deg))
    return max(SIGNIFICANT_SIGMAS * sigma_rad, math.radians(MIN_SIGNIFICANT_YAW_DEG))


def sigma_of_calibration(rotation: CameraRotation, rig: StereoRig, prior: CalibrationPrior) -> CalibrationSigma:
    """Return the uncertainty of the calibration given the rotation of the right camera that is measured in a pair.

    A significant yaw is added to the configured uncertainty in quadrature and is not compensated. A vertical offset
    that residual distortion does not explain is added as a pitch and is not reported. Roll is compensated
    (`estimate_disparity`).

    Residual distortion causes an error along rows that is about as large as the vertical disparity:

        distortion_px = min(max(prior.distortion_px, distortion_rms_px), vertical_rms_px)

    The minimum assumes that distortion has the shape of the five terms of `VerticalPolynomial`. Other distortion, such
    as cubic terms or an error along rows alone, is not measured, and sigma is too small where such distortion
    dominates. Without vertical disparity, the distortion is 0 for any prior. If the rotation was not measured, only a
    part of the vertical disparity is known, and the minimum is omitted. If the prior is 0, the distortion is 0.

    The saddle of a yaw is also part of `distortion_rms_px`, because distortion can cause the same saddle. A significant
    yaw therefore increases sigma twice, which is conservative.
    """
    yaw_rad = math.radians(prior.yaw_deg)
    if is_yaw_significant(rotation, rig, prior):
        yaw_rad = math.hypot(yaw_rad, rotation.yaw_rad)
    pitch_rad = math.radians(prior.pitch_deg)
    if abs(rotation.pitch_rad) * rig.fy > max(prior.distortion_px, MIN_ROTATION_PX):
        pitch_rad = math.hypot(pitch_rad, rotation.pitch_rad)
    distortion_px = 0.0
    if prior.distortion_px > 0.0:
        distortion_px = max(prior.distortion_px, rotation.distortion_rms_px)
        if rotation.yaw_sigma_rad is not None:
            distortion_px = min(distortion_px, rotation.vertical_rms_px)
    return CalibrationSigma(
        yaw_rad=yaw_rad,
        pitch_rad=pitch_rad,
        roll_rad=math.radians(prior.roll_deg),
        focal_fraction=prior.focal_share,
        baseline_fraction=prior.baseline_share,
        distortion_rad=distortion_px / rig.fx,
    )


def largest_of(calibrations: Iterable[CalibrationSigma]) -> CalibrationSigma:
    """Return the largest value of each standard deviation, because the pairs of a rig share its calibration."""
    return CalibrationSigma(*(max(values) for values in zip(*calibrations, strict=True)))

"""The uncertainty of the calibration given what a pair shows of its right camera."""

import math

import pytest

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.config import CalibrationUncertainty
from sfr_loc_map.mapping.disparity.right_camera import CameraRotation
from sfr_loc_map.mapping.point_sigma import calibration_sigma

RIG = StereoRig(640, 480, 400.0, 400.0, 319.5, 239.5, 0.2)
CONFIGURED = CalibrationUncertainty()


def rotation(yaw_sigma_rad: float, vertical_rms_px: float, distortion_rms_px: float) -> CameraRotation:
    return CameraRotation(0.0, yaw_sigma_rad, 0.0, 0.0, vertical_rms_px, distortion_rms_px)


@pytest.mark.parametrize(
    ("yaw_sigma_rad", "vertical_rms_px", "distortion_rms_px", "expected_px"),
    [
        (math.inf, 0.0, 0.0, CONFIGURED.distortion_px),  # not measured: no smaller than configured
        (math.inf, 1.0, 0.8, 0.8),  # not measured, but the correction has removed a stretch
        (1e-5, 0.1, 0.05, 0.1),  # measured: no more than all vertical disparity
        (1e-5, 1.0, 0.05, CONFIGURED.distortion_px),  # measured: an offset or a roll
        (1e-5, 1.0, 0.8, 0.8),  # measured: distortion
    ],
)
def test_distortion_is_the_configured_one_unless_the_pair_shows_another(
    yaw_sigma_rad: float, vertical_rms_px: float, distortion_rms_px: float, expected_px: float
) -> None:
    found = calibration_sigma(rotation(yaw_sigma_rad, vertical_rms_px, distortion_rms_px), RIG, CONFIGURED)
    assert found.distortion_rad * RIG.fx == pytest.approx(expected_px)

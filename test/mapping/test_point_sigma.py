"""The uncertainty of the calibration given what a pair shows of its right camera."""

import dataclasses
import math
import re

import numpy as np
import pytest

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping import point_sigma
from sfr_loc_map.mapping.calibration_sigma import is_yaw_significant, sigma_of_calibration
from sfr_loc_map.mapping.config import CalibrationPrior
from sfr_loc_map.mapping.disparity import hole_filling
from sfr_loc_map.mapping.disparity.refinement import disparity_sigma, residual_noise
from sfr_loc_map.mapping.disparity.right_camera.rotation import CameraRotation
from sfr_loc_map.mapping.disparity.validity import saturation
from sfr_loc_map.mapping.multiview import fusion
from sfr_loc_map.mapping.pair_findings import MIN_VERTICAL_WARNING_PX, vertical_warning_px

RIG = StereoRig(640, 480, 400.0, 400.0, 319.5, 239.5, 0.2)
CONFIGURED = CalibrationPrior()


def rotation(yaw_sigma_rad: float | None, vertical_rms_px: float, distortion_rms_px: float) -> CameraRotation:
    return CameraRotation(0.0, yaw_sigma_rad, 0.0, 0.0, vertical_rms_px, distortion_rms_px)


@pytest.mark.parametrize(
    ("yaw_sigma_rad", "vertical_rms_px", "distortion_rms_px", "expected_px"),
    [
        (None, 0.0, 0.0, CONFIGURED.distortion_px),  # not measured: no smaller than configured
        (None, 1.0, 0.8, 0.8),  # not measured, but the correction has removed a stretch
        (1e-5, 0.1, 0.05, 0.1),  # measured: no more than all vertical disparity
        (1e-5, 1.0, 0.05, CONFIGURED.distortion_px),  # measured: an offset or a roll
        (1e-5, 1.0, 0.8, 0.8),  # measured: distortion
        (1e-5, 0.0, 0.0, 0.0),  # measured: distortion of other shapes is not included
    ],
)
def test_distortion_is_the_configured_one_unless_the_pair_shows_another(
    yaw_sigma_rad: float | None, vertical_rms_px: float, distortion_rms_px: float, expected_px: float
) -> None:
    found = sigma_of_calibration(rotation(yaw_sigma_rad, vertical_rms_px, distortion_rms_px), RIG, CONFIGURED)
    assert found.distortion_rad * RIG.fx == pytest.approx(expected_px)


def test_a_significant_yaw_increases_sigma_as_yaw_and_by_its_saddle_as_distortion() -> None:
    rotation_of_yaw = CameraRotation(math.radians(1.0), 1e-5, 0.0, 0.0, 0.8, 0.8)
    found = sigma_of_calibration(rotation_of_yaw, RIG, CONFIGURED)
    assert found.yaw_rad > math.radians(1.0)
    assert found.distortion_rad * RIG.fx == pytest.approx(0.8)


def test_the_constants_that_the_table_of_sigma_names_exist() -> None:
    named = set(re.findall(r"[A-Z]+(?:_[A-Z]+)+", point_sigma.__doc__ or ""))
    defined = {
        name
        for module in (fusion, hole_filling, point_sigma, residual_noise, saturation, disparity_sigma)
        for name in vars(module)
    }
    assert {"SMOOTHING_BIAS", "COMMON_VARIANCE", "SIGMA_GROWTH"} <= named <= defined


@pytest.mark.parametrize("distortion_px", [0.1, 0.3])
def test_distortion_sets_the_thresholds_that_its_text_names(distortion_px: float) -> None:
    """A yaw is reported beyond three times the distortion in the corners, a pitch never is and only increases sigma."""
    configured = CalibrationPrior(yaw_deg=0.0, pitch_deg=0.0, distortion_px=distortion_px)
    corner_px_per_rad = RIG.fy * (0.5 * RIG.width / RIG.fx) * (0.5 * RIG.height / RIG.fy)
    largest_rad = 3.0 * distortion_px / corner_px_per_rad
    for yaw_rad, is_significant in ((0.99 * largest_rad, False), (1.01 * largest_rad, True)):
        turned = CameraRotation(yaw_rad, 0.0, 0.0, 0.0, 0.0, 0.0)
        assert is_yaw_significant(turned, RIG, configured) == is_significant
        assert (sigma_of_calibration(turned, RIG, configured).yaw_rad > 0.0) == is_significant
    for offset_px, is_pitch in ((0.99 * distortion_px, False), (1.01 * distortion_px, True)):
        tilted = CameraRotation(0.0, 0.0, 0.0, offset_px / RIG.fy, offset_px, 0.0)
        assert (sigma_of_calibration(tilted, RIG, configured).pitch_rad > 0.0) == is_pitch
    assert vertical_warning_px(configured) == pytest.approx(max(3.0 * distortion_px, MIN_VERTICAL_WARNING_PX))


@pytest.mark.parametrize("centre", [(319.5, 239.5), (0.0, 479.0), (-500.0, 100.0)])
def test_a_yaw_that_distortion_explains_is_not_significant_wherever_the_image_was_cropped(
    centre: tuple[float, float],
) -> None:
    rig = dataclasses.replace(RIG, cx=centre[0], cy=centre[1])
    configured = CalibrationPrior(yaw_deg=0.0)
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 640.0, 20.0), np.arange(0.0, 480.0, 20.0)))
    distortion_px = configured.distortion_px * (columns - 319.5) * (rows - 239.5) / (320.0 * 240.0)
    x, y = rig.camera.normalised(np.column_stack((columns, rows))).T
    terms = np.column_stack((np.ones(len(x)), x, y, x * y, y * y))  # as `VerticalPolynomial`
    saddle = np.linalg.lstsq(terms, distortion_px)[0][3]
    for factor, is_significant in ((2.9, False), (3.1, True)):
        turned = CameraRotation(-factor * saddle / rig.fy, 0.0, 0.0, 0.0, 0.0, 0.0)
        assert is_yaw_significant(turned, rig, configured) == is_significant

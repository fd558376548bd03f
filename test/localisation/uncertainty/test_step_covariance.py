"""The terms of the covariance of a step, for a rover whose left camera is RB."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration, YawEstimate
from sfr_loc_map.localisation.backend.sliding_window import KeyframeMotion
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.frontend.right_camera import RowShear
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW_RATIO
from sfr_loc_map.localisation.motion_size import MotionSize
from sfr_loc_map.localisation.uncertainty.error_sources import RoverModel
from sfr_loc_map.localisation.uncertainty.step_covariance import (
    EXPECTED_CHI_MEDIAN,
    MIN_VARIANCE,
    StepMotion,
    pose_noise,
    step_covariance,
    systematic_step,
    updated_variance_factor,
)

RIG = StereoRig(640, 480, 400.0, 400.0, 320.0, 240.0, 0.2, Transform.identity())
IN_CAMERA = replace(RIG, T_rb_sb=RIG.T_sb_left.inverse())
MODEL = RoverModel.of(IN_CAMERA, MotionBounds(), KEYFRAME_FLOW_RATIO)
SOURCES = MODEL.sources
DEPTH_M = 5.0
HERE = Transform.identity()
AHEAD = Transform(np.eye(3), np.array([0.3, 0.0, 0.0]))
GIVEN = np.diag([1e-6, 2e-6, 3e-6, 1e-8, 2e-8, 3e-8])
SETTLED = OnlineCalibration(RIG.camera, (480, 640), 7, yaw=YawEstimate(0.0, 1e-4))


def by_rb(now: Transform) -> StepMotion:
    return StepMotion.between(HERE, now, MODEL)


@pytest.mark.parametrize(
    ("keyframes", "step_ratio"),
    [
        # flow of the step: 0.3 m / 5 m; of the keyframes: 0.6 m / 5 m + 0.03 rad
        (KeyframeMotion(GIVEN, MotionSize(0.6, 0.03)), 0.06 / 0.15),
        (KeyframeMotion(GIVEN, MotionSize(0.0, 0.0)), 0.06 / (0.25 * 0.05 * 640 / 400)),
        (None, 0.06 / (0.05 * 640 / 400)),
        (KeyframeMotion(GIVEN, MotionSize(500.0, 0.0)), 0.02),
    ],
)
@pytest.mark.parametrize(("variance_factor", "factor"), [(None, 1.0), (2.0, 3.0), (0.01, 1.5 * 0.2)])
def test_errors_from_images_grow_with_the_part_of_the_keyframe_interval(
    keyframes: KeyframeMotion | None, step_ratio: float, variance_factor: float | None, factor: float
) -> None:
    found = step_covariance(by_rb(AHEAD), keyframes, GIVEN, DEPTH_M, variance_factor, MODEL)
    common = np.diag([(0.01 * DEPTH_M / 400.0) ** 2] * 3 + [0.0] * 3)
    np.testing.assert_allclose(found, factor * step_ratio * (2.0 * GIVEN + common) + MIN_VARIANCE * np.eye(6))


def test_white_noise_grows_with_the_residuals_and_the_shear() -> None:
    shift = np.array([3e-3, 0.0, 0.0, 0.0, 0.0, 4e-4])  # m and rad

    def noise(variance_factor: float | None, shear_chi2: float) -> np.ndarray:
        shear = RowShear(shear_chi2, shift)
        noise = pose_noise(GIVEN, R_world_left=np.eye(3), variance_factor=variance_factor, shear=shear, model=MODEL)
        noise[3:, 3:] -= SOURCES.exposure_rad**2 * np.eye(3)
        return np.asarray(noise)

    np.testing.assert_allclose(noise(None, 0.0), 0.5 * GIVEN, atol=1e-16)
    by_shear = np.zeros((6, 6))  # three quarters of the squares of the shift
    by_shear[0, 0] = 6.75e-6
    by_shear[5, 5] = 1.2e-7
    by_shear[0, 5] = by_shear[5, 0] = 9e-7
    np.testing.assert_allclose(noise(3.0, 4.0), 0.5 * 3.0 * GIVEN + by_shear, atol=1e-16)
    np.testing.assert_allclose(noise(0.0, 1.0), 0.5 * 0.2 * GIVEN, atol=1e-16)


def test_systematic_errors_of_a_step_forwards_and_of_a_step_backwards_cancel() -> None:
    forwards = systematic_step(by_rb(AHEAD), DEPTH_M, SETTLED, MODEL)
    backwards = systematic_step(by_rb(AHEAD.inverse()), DEPTH_M, SETTLED, MODEL)
    np.testing.assert_allclose(forwards + backwards, 0.0, atol=1e-15)
    metres = np.hypot(0.01, 0.01) * DEPTH_M / 80.0 * 0.3  # disparity_px, and the sigma of the yaw
    np.testing.assert_allclose(forwards, [metres, 0.0, 0.0, *[0.0007 / 80.0 * 0.3] * 3], rtol=1e-9, atol=1e-15)


def test_a_step_is_given_in_the_frame_of_the_previous_pose() -> None:
    turned = Transform(matrix_from_rotvec([0.0, 0.0, 0.7]), np.array([1.0, 2.0, 3.0]))
    step = StepMotion.between(turned, turned @ AHEAD, MODEL)
    np.testing.assert_allclose(step.vector, [0.3, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(step.R_rb_world @ step.displacement, [0.3, 0.0, 0.0], atol=1e-12)


def test_the_variance_factor_follows_the_residuals() -> None:
    assert updated_variance_factor(None, np.nan, SOURCES) is None
    assert updated_variance_factor(None, 2.0 * EXPECTED_CHI_MEDIAN, SOURCES) == pytest.approx(2.0)
    assert updated_variance_factor(1.0, 2.0 * EXPECTED_CHI_MEDIAN, SOURCES) == pytest.approx(1.1)
    assert updated_variance_factor(1.0, np.nan, SOURCES) == 1.0

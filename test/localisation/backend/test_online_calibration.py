"""Errors of the stereo calibration that the images themselves show."""

import cv2
import numpy as np
import pytest

from helpers.loc_drive import drive, run
from helpers.made_scene import LOC_RIG, PERIOD_NS, START_NS, true_pose
from sfr_loc_map.bench.fault_benchmark import TruePoses, pose_error
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.estimate import StateReason, TrackingState
from sfr_loc_map.localisation.frontend.right_camera import PairYaw

CAMERA = StereoCamera(400.0, 400.0, 256.0, 256.0, 0.15)


def test_a_turn_of_the_right_camera_is_learnt_from_rows_and_moves_columns_as_it_does() -> None:
    # independent of the model: rays turned by a rotation matrix and projected again
    turn = np.radians([0.05, 0.0, -0.1])
    random = np.random.default_rng(0)
    places = random.uniform(20, 490, (400, 2))
    rays = np.column_stack((CAMERA.normalised(places), np.ones(400)))
    rotated = rays @ cv2.Rodrigues(turn)[0].T
    moved = rotated[:, :2] / rotated[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    calibration = OnlineCalibration(CAMERA, (512, 512), 7)
    noisy = moved[:, 1] - places[:, 1] + random.normal(0, 0.1, 400)
    noisy[:30] += random.uniform(-3, 3, 30)  # wrong matches
    calibration = calibration.with_matches(moved[:10], noisy[:10])
    assert (calibration.offset.pitch_px, calibration.offset.roll_px) == (0.0, 0.0)  # too few to say
    for _ in range(3):
        calibration = calibration.with_matches(moved, noisy)
    assert calibration.offset.pitch_px == pytest.approx(-CAMERA.fx * turn[0], abs=0.03)
    assert calibration.offset.roll_px == pytest.approx(CAMERA.fx * turn[2], abs=0.06)
    np.testing.assert_allclose(calibration.offset.at(moved, CAMERA), moved - places, atol=0.06)


@pytest.mark.parametrize("centre", [(255.5, 255.5), (0.0, 0.0), (-300.0, 700.0)])
def test_lens_errors_are_measured_over_the_image_wherever_the_principal_point_is(centre: tuple[float, float]) -> None:
    random = np.random.default_rng(0)
    uv = random.uniform(0, 511, (300, 2))
    disparity = 0.2 * np.sin(uv[:, 0] / 80.0) + 0.2 * np.sin(uv[:, 1] / 80.0)
    camera = CAMERA._replace(cx=centre[0], cy=centre[1])
    calibration = OnlineCalibration(camera, (512, 512), 7)
    for _ in range(20):
        calibration, _ = calibration.with_pair(PairYaw(0.0, 0.0, uv, disparity))
    assert np.count_nonzero(calibration.lens.sums[0]) == calibration.lens.sums.shape[1]
    assert calibration.lens.rms_px == pytest.approx(0.2, abs=0.05)


def test_right_camera_that_turns_is_followed_and_reported() -> None:
    """Its yaw changes by a degree: without following it the attitude is off by more than ten times its 3 sigma."""
    fault = parse_fault("drift:amount=2.5")
    pairs = [pair for _, pair in FaultInjector([fault], 0, 40, LOC_RIG).pairs(drive(40))]
    estimates = run(pairs)
    truth = Trajectory.from_poses((START_NS + k * PERIOD_NS, true_pose(k)) for k in range(40))
    errors, sigmas = np.transpose([pose_error(estimate, TruePoses(truth)) for estimate in estimates], (1, 0, 2))
    assert (errors / (3 * sigmas)).max() < 2.0
    assert estimates[-1].state is TrackingState.DEGRADED
    assert estimates[-1].reason is StateReason.CALIBRATION_DRIFT
    turned_px = LOC_RIG.fx * np.tan(np.radians(2.5 * 39 / 100))
    assert estimates[-1].statistics.disparity_offset_px == pytest.approx(-turned_px, abs=0.35)

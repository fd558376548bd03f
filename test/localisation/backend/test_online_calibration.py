"""Errors of the stereo calibration that the images themselves show."""

import cv2
import numpy as np
import pytest

from sfr_loc_map.geometry.camera import Poses, StereoCamera
from sfr_loc_map.localisation.backend.bundle_adjustment import BundleAdjustmentResult, Prior, adjust
from sfr_loc_map.localisation.backend.linearisation import BundleProblem
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.frontend.right_offset import RightOffset

CAMERA = StereoCamera(400.0, 400.0, 256.0, 256.0, 0.15)
WINDOW = 5


def adjusted(
    offset_px: float, seed: int, noise_px: float = 0.1, depths: tuple[float, float] = (1.5, 15.0)
) -> BundleAdjustmentResult:
    """Adjust landmarks seen from five places along the optical axis, right images moved along the columns."""
    random = np.random.default_rng(seed)
    count = 300
    rotations, positions = np.repeat(np.eye(3)[None], WINDOW, axis=0), np.zeros((WINDOW, 3))
    positions[:, 2] = 0.2 * np.arange(WINDOW)
    uv, depth = random.uniform(60, 450, (count, 2)), random.uniform(*depths, count)
    points = np.column_stack((CAMERA.normalised(uv), np.ones(count))) * depth[:, None]
    seen = points[:, None] - positions
    left = seen[..., :2] / seen[..., 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    right = left - np.stack((CAMERA.fx * CAMERA.baseline_m / seen[..., 2], np.zeros(seen.shape[:2])), axis=2)
    right[..., 0] += offset_px
    observed = np.concatenate((left, right), axis=2)
    observed += random.normal(0, noise_px, observed.shape)
    observed[:, 0, :2] = uv
    variance = np.tile([noise_px**2, 0.0, noise_px**2], (count, WINDOW, 2, 1))
    rho = (observed[:, 0, 0] - observed[:, 0, 2]) / (CAMERA.fx * CAMERA.baseline_m)
    h = np.zeros((6 * WINDOW, 6 * WINDOW))
    h[:6, :6] = 1e12 * np.eye(6)
    prior = Prior(h, np.zeros(6 * WINDOW), Poses(rotations, positions))
    start = positions + np.array([0.0, 0.0, 0.003]) * np.arange(WINDOW)[:, None]
    host, uv_inverse_depth = np.zeros(count, np.int64), np.column_stack((uv, rho))
    problem = BundleProblem(Poses(rotations, start), host, uv_inverse_depth, observed, variance, CAMERA)
    return adjust(problem, prior, 4)


@pytest.mark.parametrize("offset_px", [0.0, 0.15, -0.3])
def test_the_window_shows_an_offset_along_the_columns_with_its_variance(offset_px: float) -> None:
    # robust weights make each step fall short by up to a third: what is left is seen when the rest is corrected
    found = np.zeros((12, 2))
    for seed in range(12):
        for _ in range(4):
            beyond, variance = adjusted(offset_px - found[seed, 0], seed).right_offset
            found[seed] = found[seed, 0] + beyond, variance
    normalised = (found[:, 0] - offset_px) / np.sqrt(found[:, 1])
    assert np.sqrt(found[:, 1]).max() < 0.05
    assert abs(normalised.mean()) < 4 / np.sqrt(12)
    assert 0.4 < np.sqrt(np.mean(normalised**2)) < 2.0


def test_one_step_goes_most_of_the_way() -> None:
    for offset_px in (0.05, -0.3):
        assert 0.6 < adjusted(offset_px, 0, 0.05).right_offset[0] / offset_px < 1.2


def test_points_at_one_distance_say_little_of_it() -> None:
    flat, deep = adjusted(0.1, 0, depths=(3.0, 3.01)), adjusted(0.1, 0)
    assert flat.right_offset[1] > 4 * deep.right_offset[1]


def test_an_offset_is_corrected_once_it_is_beyond_doubt_and_no_other() -> None:
    random = np.random.default_rng(3)
    true, knocked, straight = 0.12, OnlineCalibration(CAMERA, 7), OnlineCalibration(CAMERA, 7)
    applied = [0.0]
    for _ in range(60):
        change = knocked.learn_yaw(true - knocked.offset.u + random.normal(0, 0.015), 0.015**2)
        applied.append(knocked.offset.u)
        assert change == pytest.approx(applied[-1] - applied[-2], abs=1e-15)
        assert abs(change) <= 0.05
        straight.learn_yaw(random.normal(0, 0.015) - straight.offset.u, 0.015**2)
        assert straight.offset.u == 0.0
    assert applied[-1] == pytest.approx(true, abs=0.02)
    assert OnlineCalibration(CAMERA, 7).learn_yaw(5.0, np.inf) == 0.0


def test_a_turn_of_the_right_camera_is_learnt_from_rows_and_moves_columns_as_it_does() -> None:
    # independent of the model: rays turned by a rotation matrix and projected again
    turn = np.radians([0.05, 0.0, -0.1])
    random = np.random.default_rng(0)
    places = random.uniform(20, 490, (400, 2))
    rays = np.column_stack((CAMERA.normalised(places), np.ones(400)))
    rotated = rays @ cv2.Rodrigues(turn)[0].T
    moved = rotated[:, :2] / rotated[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    calibration = OnlineCalibration(CAMERA, 7)
    noisy = moved[:, 1] - places[:, 1] + random.normal(0, 0.1, 400)
    noisy[:30] += random.uniform(-3, 3, 30)  # wrong matches
    calibration.learn_vertical(moved[:10], noisy[:10])
    assert (calibration.offset.v, calibration.offset.roll) == (0.0, 0.0)  # too few to say
    for _ in range(3):
        calibration.learn_vertical(moved, noisy)
    assert calibration.offset.v == pytest.approx(-CAMERA.fx * turn[0], abs=0.03)
    assert calibration.offset.roll == pytest.approx(CAMERA.fx * turn[2], abs=0.06)
    np.testing.assert_allclose(calibration.offset.at(moved, CAMERA), moved - places, atol=0.06)


def test_rows_are_followed_ever_more_slowly() -> None:
    calibration, places = OnlineCalibration(CAMERA, 7), np.random.default_rng(1).uniform(20, 490, (50, 2))
    shapes = 1.0 + ((places[:, 1] - CAMERA.cy) / CAMERA.fy) ** 2
    calibration.learn_vertical(places, 0.5 * shapes)
    assert calibration.offset.v == pytest.approx(0.5, abs=3e-3)
    calibration.learn_vertical(places, 0.0 * shapes)
    assert calibration.offset.v == pytest.approx(0.25, abs=0.01)
    for _ in range(400):
        calibration.learn_vertical(places, 0.0 * shapes)
    assert abs(calibration.offset.v) < 1e-3


def test_matches_in_a_corner_do_not_say_much_of_the_rest() -> None:
    """As in an image with glare over all but a strip, where the edge of the glare is matched with itself."""
    calibration, random = OnlineCalibration(CAMERA, 7), np.random.default_rng(2)
    for _ in range(5):
        places = random.uniform(20, 490, (300, 2))
        calibration.learn_vertical(places, 0.2 + random.normal(0, 0.1, 300))
    for _ in range(5):
        strip = np.column_stack((np.linspace(470, 490, 40), random.uniform(20, 490, 40)))
        calibration.learn_vertical(strip, 0.2 + np.linspace(-0.9, 0.9, 40))
    assert calibration.offset.at(np.array([[256.0, 256.0]]), CAMERA)[0, 1] == pytest.approx(0.2, abs=0.1)
    assert calibration.offset.at(np.array([[30.0, 256.0]]), CAMERA)[0, 1] == pytest.approx(0.2, abs=0.2)


def test_vertical_disparity_of_a_known_yaw_is_no_pitch_and_no_roll() -> None:
    calibration, uv = OnlineCalibration(CAMERA, 7), np.random.default_rng(4).uniform(20, 490, (200, 2))
    calibration.offset = RightOffset(u=3.0)
    calibration.learn_vertical(uv, calibration.offset.at(uv, CAMERA)[:, 1])
    assert calibration.offset.v == pytest.approx(0.0, abs=1e-9)
    assert calibration.offset.roll == pytest.approx(0.0, abs=1e-9)

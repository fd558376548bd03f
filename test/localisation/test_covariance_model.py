"""What is added to the covariance of a pose in its window."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import FIRST_SIGMA_PX, OnlineCalibration
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.covariance_model import (
    CovarianceModel,
    Start,
    covariance_of_point,
    systematic_covariance,
)

RIG = StereoRig(640, 480, 400.0, 400.0, 320.0, 240.0, 0.2)
CONFIG = LocalisationConfig(common_px=0.04, common_disparity_px=0.0, inflation=2.0)
CAMERA = StereoCamera(400.0, 400.0, 320.0, 240.0, 0.2)
DEPTH_M = 5.0
STEP = np.array([0.1, 0.0, 0.3])
NOTHING = np.zeros((6, 6))


def calibration(window: int = 7) -> OnlineCalibration:
    return OnlineCalibration(CAMERA, window)


@pytest.fixture
def model() -> CovarianceModel:
    model = CovarianceModel(RIG, CONFIG)
    model.start(np.zeros(3), NOTHING, NOTHING, DEPTH_M)
    return model


def random_covariance(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return 1e-6 * root @ root.T


def numeric_jacobian(moved: Callable[[np.ndarray], Transform]) -> np.ndarray:
    """Return the derivative `(6, 6)` of a pose by position and rotation about fixed axes of another."""
    step, columns = 1e-6, []
    for axis in range(6):
        ends = []
        for sign in (1.0, -1.0):
            change = np.zeros(6)
            change[axis] = sign * step
            ends.append(moved(change))
        translation = (ends[0].translation - ends[1].translation) / (2.0 * step)
        rotation = rotvec_from_matrix(ends[0].rotation @ ends[1].rotation.T) / (2.0 * step)
        columns.append(np.concatenate((translation, rotation)))
    return np.column_stack(columns)


def perturbed(pose: Transform, change: np.ndarray) -> Transform:
    return Transform(matrix_from_rotvec(change[3:]) @ pose.rotation, pose.translation + change[:3])


def test_error_of_a_whole_image_is_an_angle_and_that_angle_at_the_depth() -> None:
    sigma = np.sqrt(np.diag(systematic_covariance(DEPTH_M, 0.04, 400.0)))
    np.testing.assert_allclose(sigma, [5e-4] * 3 + [1e-4] * 3)


def test_nothing_is_known_worse_than_an_image_at_the_start(model: CovarianceModel) -> None:
    np.testing.assert_array_equal(model.path_covariance(calibration()), np.zeros((3, 3)))
    first_and_this = 2.0 * systematic_covariance(DEPTH_M, 0.04, 400.0)
    np.testing.assert_allclose(model.of_left(np.zeros(3), DEPTH_M, calibration()), first_and_this)


def test_yaw_error_grows_in_proportion_to_the_path(model: CovarianceModel) -> None:
    """A disparity error of one pixel scales a step by depth / (f b): 5 / (400 * 0.2)."""
    sigma = FIRST_SIGMA_PX * DEPTH_M / 80.0 * np.linalg.norm(STEP)
    for count in range(1, 6):
        model.step(STEP, DEPTH_M, 0.0)
        covariance = model.path_covariance(calibration())
        assert np.sqrt(np.trace(covariance)) == pytest.approx(count * sigma)
        np.testing.assert_allclose(covariance @ np.array([0.3, 0.0, -0.1]), 0.0, atol=1e-12)  # along the path alone


def test_a_path_back_takes_the_yaw_error_back(model: CovarianceModel) -> None:
    for step in (STEP, -STEP):
        model.step(step, DEPTH_M, 0.0)
    np.testing.assert_allclose(model.path_covariance(calibration()), 0.0, atol=1e-18)


def test_a_yaw_found_late_leaves_the_path_before_it_uncertain(model: CovarianceModel) -> None:
    known = calibration()
    known.target_u, known._variance_u = 0.5, 0.0
    model.step(STEP, DEPTH_M, 0.0)  # not corrected
    before = model.path_covariance(known)
    assert np.sqrt(np.trace(before)) == pytest.approx(0.5 * DEPTH_M / 80.0 * np.linalg.norm(STEP))
    model.step(STEP, DEPTH_M, 0.5)  # corrected
    np.testing.assert_allclose(model.path_covariance(known), before, atol=1e-15)


def test_disparity_error_that_is_never_known_stays() -> None:
    model = CovarianceModel(RIG, LocalisationConfig(common_disparity_px=0.02))
    known = calibration()
    known._variance_u = 0.0
    model.step(STEP, DEPTH_M, 0.0)
    sigma = 0.02 * DEPTH_M / 80.0 * np.linalg.norm(STEP)
    assert np.sqrt(np.trace(model.path_covariance(known))) == pytest.approx(sigma)


def test_window_covariance_is_inflated_and_the_start_is_not() -> None:
    model, window, start = CovarianceModel(RIG, CONFIG), random_covariance(0), random_covariance(1)
    model.start(np.zeros(3), start, window, 0.0)
    rotation_only = 2.0 * systematic_covariance(0.0, 0.04, 400.0)
    np.testing.assert_allclose(model.of_left(np.zeros(3), 0.0, calibration()), 2.0 * window + start + rotation_only)


def test_a_motion_that_no_image_shows_counts_until_the_next_pose(model: CovarianceModel) -> None:
    still, unseen = model.of_left(np.zeros(3), DEPTH_M, calibration()), random_covariance(7)
    model.allow_unseen(unseen)
    np.testing.assert_allclose(model.of_left(np.zeros(3), DEPTH_M, calibration()) - still, unseen)
    model.set_in_window(NOTHING)
    np.testing.assert_array_equal(model.of_left(np.zeros(3), DEPTH_M, calibration()), still)


def test_a_gap_adds_what_a_rover_may_have_moved(model: CovarianceModel) -> None:
    window, unseen, position = random_covariance(2), random_covariance(8), np.array([3.0, -1.0, 0.5])
    model.set_in_window(window)
    image = Start(np.zeros(3), systematic_covariance(DEPTH_M, 0.04, 400.0))
    known = 2.0 * window + image.propagated_to(position)
    np.testing.assert_allclose(model.after_gap(position, unseen), known + unseen)


def test_a_pose_given_for_the_past_replaces_what_was_known_then(model: CovarianceModel) -> None:
    """The drift of the window and the yaw error of the path before it do not count any more."""
    early, late, given = random_covariance(2), random_covariance(3), random_covariance(4)
    there, here = Transform(np.eye(3), STEP), 3.0 * STEP
    model.set_in_window(early)
    model.step(STEP, DEPTH_M, 0.0)
    mark = model.mark(there)
    model.rebase(mark, given)
    image = systematic_covariance(DEPTH_M, 0.04, 400.0)
    np.testing.assert_allclose(model.of_left(STEP, DEPTH_M, calibration()), given + image, atol=1e-15)
    model.step(2.0 * STEP, DEPTH_M, 0.0)
    model.set_in_window(Start(STEP, early).propagated_to(here) + late)
    expected = Start(STEP, given).propagated_to(here) + 2.0 * late + image
    expected[:3, :3] += FIRST_SIGMA_PX**2 * np.outer(2.0 * STEP, 2.0 * STEP) * (DEPTH_M / 80.0) ** 2
    np.testing.assert_allclose(model.of_left(here, DEPTH_M, calibration()), expected, atol=1e-15)


def test_a_pose_given_for_an_earlier_window_keeps_what_was_not_seen_between(model: CovarianceModel) -> None:
    given, unseen = random_covariance(4), random_covariance(5)
    mark = model.mark(Transform.identity())
    model.start(STEP, unseen, NOTHING, DEPTH_M)
    before = model.of_left(STEP, DEPTH_M, calibration())
    model.rebase(mark, given)
    added = model.of_left(STEP, DEPTH_M, calibration()) - before
    np.testing.assert_allclose(added, Start(np.zeros(3), given).propagated_to(STEP), atol=1e-15)


def test_rotation_error_of_the_start_swings_the_path() -> None:
    start = Transform.from_quat([1.0, 2.0, 3.0], [0.1, 0.3, 0.3, 0.9])
    later = Transform.from_quat([4.0, 0.5, 3.5], [0.0, 0.2, 0.0, 0.98])
    relative, covariance = start.inverse() @ later, random_covariance(3)
    jacobian = numeric_jacobian(lambda change: perturbed(start, change) @ relative)
    propagated = Start(start.translation, covariance).propagated_to(later.translation)
    np.testing.assert_allclose(propagated, jacobian @ covariance @ jacobian.T, atol=1e-12)
    np.testing.assert_array_equal(Start(start.translation, covariance).propagated_to(start.translation), covariance)


def test_covariance_of_the_rover_follows_its_extrinsics() -> None:
    T_ds_world = Transform.from_quat([5.0, 6.0, 7.0], [0.3, -0.1, 0.5, 0.8])
    T_world_left = Transform.from_quat([1.0, -2.0, 0.5], [0.2, 0.1, -0.4, 0.9])
    T_left_rb = Transform.from_quat([0.3, 0.4, -0.5], [0.5, 0.5, -0.5, 0.5])
    covariance = random_covariance(4)
    jacobian = numeric_jacobian(lambda change: T_ds_world @ perturbed(T_world_left, change) @ T_left_rb)
    T_ds_left = T_ds_world @ T_world_left
    lever = (T_ds_left @ T_left_rb).translation - T_ds_left.translation
    found = covariance_of_point(covariance, T_ds_world.rotation, lever)
    np.testing.assert_allclose(found, jacobian @ covariance @ jacobian.T, atol=1e-12)
    np.testing.assert_array_equal(found, found.T)


def test_the_start_s_covariance_moves_later_poses_as_samples_of_it_do() -> None:
    """A start that is off by a small motion about fixed axes moves what is driven from it; sampled, not derived."""
    random = np.random.default_rng(3)
    root = 0.01 * random.normal(size=(6, 6))
    later = Transform(np.eye(3), np.array([1.0, 2.0, 3.0]) + np.array([4.0, -2.0, 1.0]))
    start = Start(np.array([1.0, 2.0, 3.0]), root @ root.T)
    samples = random.normal(size=(200_000, 6)) @ root.T
    step = later.translation - np.array([1.0, 2.0, 3.0])
    moved = samples[:, :3] + np.cross(samples[:, 3:], step)
    expected = np.cov(np.column_stack((moved, samples[:, 3:])), rowvar=False)
    found = start.propagated_to(later.translation)
    assert np.allclose(
        found, expected, rtol=0.02, atol=0.02 * np.sqrt(np.outer(np.diag(expected), np.diag(expected))).max()
    )
    assert np.array_equal(start.propagated_to(np.array([1.0, 2.0, 3.0])), start.covariance)

"""What is added to the covariance of a pose in its window."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import FIRST_SIGMA_PX, OnlineCalibration
from sfr_loc_map.localisation.covariance_model import (
    COMMON_DISPARITY_PX,
    COMMON_PX,
    INFLATION,
    CovarianceMark,
    CovarianceModel,
    covariance_of_point,
)

RIG = StereoRig(640, 480, 400.0, 400.0, 320.0, 240.0, 0.2)
CAMERA = StereoCamera(400.0, 400.0, 320.0, 240.0, 0.2)
DEPTH_M, PER_PX = 5.0, 5.0 / 80.0
"""Depth, metres, and its share by which a disparity error of one pixel scales a step: depth / (f b)."""
STEP, NOTHING, AT_START = np.array([0.1, 0.0, 0.3]), np.zeros((6, 6)), np.zeros(3)
ANGLE = COMMON_PX / 400.0
IMAGE = np.diag(np.square([ANGLE * DEPTH_M] * 3 + [ANGLE] * 3))
"""Covariance of an error of a whole image: an angle, and that angle at the depth."""
UNKNOWN_PX = np.hypot(FIRST_SIGMA_PX, COMMON_DISPARITY_PX)


@pytest.fixture
def model() -> CovarianceModel:
    model = CovarianceModel(RIG)
    model.start(AT_START, NOTHING, NOTHING, DEPTH_M)
    return model


def random_covariance(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return 1e-6 * root @ root.T


def of_left(model: CovarianceModel, position: np.ndarray, known: OnlineCalibration | None = None) -> np.ndarray:
    return model.of_left(position, DEPTH_M, known or OnlineCalibration(CAMERA, 7))


def follow(
    model: CovarianceModel, position: np.ndarray, step: np.ndarray, in_window: np.ndarray = NOTHING, u: float = 0.0
) -> CovarianceMark:
    return model.follow(position, step, in_window, DEPTH_M, u)


def of_path(model: CovarianceModel, known: OnlineCalibration | None = None) -> np.ndarray:
    """Return what the path adds to the covariance of the position at the start."""
    return (of_left(model, AT_START, known) - 2.0 * IMAGE)[:3, :3]


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


def test_the_first_image_and_this_one_have_the_error_of_a_whole_image(model: CovarianceModel) -> None:
    np.testing.assert_allclose(of_left(model, AT_START), 2.0 * IMAGE)


def test_yaw_error_grows_in_proportion_to_the_path_and_a_path_back_takes_it_back(model: CovarianceModel) -> None:
    for count in range(1, 6):
        follow(model, AT_START, STEP)
        covariance = of_path(model)
        assert np.sqrt(np.trace(covariance)) == pytest.approx(count * UNKNOWN_PX * PER_PX * np.linalg.norm(STEP))
        np.testing.assert_allclose(covariance @ np.array([0.3, 0.0, -0.1]), 0.0, atol=1e-12)  # along the path alone
    follow(model, AT_START, -5.0 * STEP)
    np.testing.assert_allclose(of_path(model), 0.0, atol=1e-18)


def test_a_yaw_found_late_leaves_the_path_before_it_uncertain(model: CovarianceModel) -> None:
    known = OnlineCalibration(CAMERA, 7)
    known.target_u, known.sigma_u = 0.5, 0.0
    common = COMMON_DISPARITY_PX * PER_PX * np.linalg.norm(STEP)
    follow(model, AT_START, STEP)  # not corrected
    assert np.trace(of_path(model, known)) == pytest.approx((0.5 * PER_PX * np.linalg.norm(STEP)) ** 2 + common**2)
    follow(model, AT_START, STEP, u=0.5)  # corrected
    after = (0.5 * PER_PX * np.linalg.norm(STEP)) ** 2 + (2 * common) ** 2
    assert np.trace(of_path(model, known)) == pytest.approx(after)


def test_a_motion_that_may_have_been_another_one_counts_for_good(model: CovarianceModel) -> None:
    for _ in range(2):  # always the same way: metres and radians add up
        model.doubt(STEP, (0.2, 0.1))
        follow(model, STEP, 0.0 * STEP)
    added = np.diag(of_left(model, STEP) - IMAGE - propagated_covariance(IMAGE, STEP))
    np.testing.assert_allclose(added, [0.16] * 3 + [0.04] * 3, rtol=0.05)


def test_a_pose_given_for_the_past_replaces_what_was_known_then(model: CovarianceModel) -> None:
    """The drift of the window and the yaw error of the path before it do not count any more."""
    early, late, given, here = random_covariance(2), random_covariance(3), random_covariance(4), 3.0 * STEP
    model.rebase(follow(model, STEP, STEP, early), given)
    np.testing.assert_allclose(of_left(model, STEP), given + IMAGE, atol=1e-15)
    follow(model, here, 2.0 * STEP, propagated_covariance(early, here - STEP) + late)
    expected = propagated_covariance(given, here - STEP) + INFLATION * late + IMAGE
    expected[:3, :3] += UNKNOWN_PX**2 * np.outer(2.0 * STEP, 2.0 * STEP) * PER_PX**2
    np.testing.assert_allclose(of_left(model, here), expected, atol=1e-15)


def test_rotation_error_of_the_start_swings_the_path() -> None:
    start = Transform.from_quat([1.0, 2.0, 3.0], [0.1, 0.3, 0.3, 0.9])
    later = Transform.from_quat([4.0, 0.5, 3.5], [0.0, 0.2, 0.0, 0.98])
    relative, covariance, model = start.inverse() @ later, random_covariance(3), CovarianceModel(RIG)
    jacobian = numeric_jacobian(lambda change: perturbed(start, change) @ relative)
    model.restart(start.translation, covariance)
    found = model.of_start_and_drift(later.translation)
    np.testing.assert_allclose(found, jacobian @ covariance @ jacobian.T, atol=1e-12)
    np.testing.assert_array_equal(model.of_start_and_drift(start.translation), covariance)


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

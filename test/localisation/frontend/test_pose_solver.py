"""Pose of a pair: information by central differences, known poses recovered; yaw of the right camera."""

import numpy as np
import pytest

from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.localisation.frontend.pose_solver import (
    LandmarkEstimates,
    PoseSolution,
    StereoObservations,
    solve_pose,
)
from sfr_loc_map.localisation.frontend.right_camera import PairYaw, RightCameraOffset, pair_yaw

CAMERA = StereoCamera(400.0, 410.0, 256.0, 240.0, 0.2)
SHAPE = (481, 513)
COUNT, NOISE_PX = 120, 0.2
RANDOM = np.random.default_rng(0)
HOST = Pose(matrix_from_rotvec([0.05, 0.1, -0.03]), np.array([0.2, -0.1, 0.3]))
TRUTH = Pose(matrix_from_rotvec([0.1, 0.05, 0.02]), np.array([0.5, 0.0, 0.8]))
UV, RHO = RANDOM.uniform(120, 400, (COUNT, 2)), RANDOM.uniform(0.08, 0.3, COUNT)
VARIANCE = np.tile([NOISE_PX**2, 0.0, NOISE_PX**2], (COUNT, 2, 1))
START = Pose(np.eye(3), np.zeros(3))


def project(pose: Pose, uv: np.ndarray = UV, rho: np.ndarray = RHO, camera: StereoCamera = CAMERA) -> np.ndarray:
    rays = np.column_stack((camera.normalised(uv), np.ones(COUNT)))
    seen = (rays @ HOST.rotation.T + rho[:, None] * (HOST.position - pose.position)) @ pose.rotation
    u = camera.fx * seen[:, 0] / seen[:, 2] + camera.cx
    v = camera.fy * seen[:, 1] / seen[:, 2] + camera.cy
    return np.column_stack((u, v, u - camera.fx * camera.baseline_m * rho / seen[:, 2], v))


def landmarks_of(camera: StereoCamera) -> LandmarkEstimates:
    return LandmarkEstimates(
        Poses(np.tile(HOST.rotation, (COUNT, 1, 1)), np.tile(HOST.position, (COUNT, 1))),
        np.column_stack((camera.normalised(UV), np.ones(COUNT))),
        RHO,
        np.zeros((COUNT, 3, 3)),
    )


LANDMARKS = landmarks_of(CAMERA)


def solve(uv: np.ndarray, covariance: np.ndarray = LANDMARKS.covariance, start: Pose = START) -> PoseSolution:
    landmarks = LANDMARKS._replace(covariance=covariance)
    return solve_pose(start, landmarks, StereoObservations(uv, VARIANCE), CAMERA, 30)


def error(pose: Pose) -> np.ndarray:
    return np.concatenate((pose.position - TRUTH.position, rotvec_from_matrix(pose.rotation @ TRUTH.rotation.T)))


@pytest.mark.parametrize("hidden", [slice(0), slice(0, 2), slice(2, 4)])
def test_the_true_pose_is_found_from_exact_observations_of_either_image(hidden: slice) -> None:
    uv = project(TRUTH)
    uv[:60, hidden] = np.nan
    solution = solve(uv)
    np.testing.assert_allclose(error(solution.pose), 0.0, atol=1e-6)
    assert np.nanmax(solution.linearised.chi2_per_dof) < 1e-6


def test_information_is_that_of_finite_differences() -> None:
    # with landmarks that are themselves uncertain: R + J P J^T
    covariance = np.tile(np.diag([0.3**2, 0.3**2, 0.01**2]), (COUNT, 1, 1))
    step, expected = 1e-6, np.zeros((6, 6))

    def moved(change: np.ndarray) -> Pose:
        return Pose(matrix_from_rotvec(change[3:]) @ TRUTH.rotation, TRUTH.position + change[:3])

    by_pose = np.stack([(project(moved(e)) - project(moved(-e))) / (2 * step) for e in step * np.eye(6)], -1)
    units = step * np.eye(3)
    by_landmark = np.stack(
        [(project(TRUTH, UV + e[:2], RHO + e[2]) - project(TRUTH, UV - e[:2], RHO - e[2])) / (2 * step) for e in units],
        axis=-1,
    )
    for n in range(COUNT):
        noise = NOISE_PX**2 * np.eye(4) + by_landmark[n] @ covariance[n] @ by_landmark[n].T
        expected += by_pose[n].T @ np.linalg.inv(noise) @ by_pose[n]
    scale = np.sqrt(np.diag(expected))
    found = solve(project(TRUTH), covariance, TRUTH).information
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)


def test_a_landmark_behind_the_start_pose_is_weighted_once_it_is_in_front() -> None:
    """From the host, half a metre behind the truth, all landmarks are in front; one is behind the start."""
    near = RHO.copy()
    near[0] = 1.0
    landmarks = LANDMARKS._replace(inverse_depth=near)
    uv = project(TRUTH, rho=near)
    uv[0] += 200.0
    start = Pose(TRUTH.rotation, TRUTH.position + np.array([0.0, 0.0, 0.6]))
    solution = solve_pose(start, landmarks, StereoObservations(uv, VARIANCE), CAMERA, 30)
    np.testing.assert_allclose(error(solution.pose), 0.0, atol=1e-5)
    assert abs(solution.linearised.residuals[0]).max() > 100.0
    assert solution.linearised.chi2_per_dof[0] > 1e4
    np.testing.assert_allclose(solution.linearised.chi2_per_dof[1:], 0.0, atol=1e-4)


# ---- rotation of the right camera


def shift_found(uv: np.ndarray) -> PairYaw | None:
    observations = StereoObservations(uv, VARIANCE)
    pose = solve_pose(START, LANDMARKS, observations, CAMERA, 30).pose
    return pair_yaw(pose, LANDMARKS, observations, CAMERA, SHAPE, 0.0)


@pytest.mark.parametrize("shift_px", [0.0, 0.1, -0.2])
def test_a_shift_is_found_though_the_pose_was_solved_without_and_some_landmarks_are_wrong(shift_px: float) -> None:
    uv = project(TRUTH)
    uv[:, 2:] += RightCameraOffset(yaw_px=shift_px).at(uv[:, 2:], CAMERA)
    uv[:20, 2] += RANDOM.uniform(3, 20, 20)
    uv[20:30, 2:] = np.nan
    found = shift_found(uv)
    assert found is not None
    # robust weights make one step fall short by up to a third
    assert found.px == pytest.approx(shift_px, rel=0.3, abs=0.005)
    uv[6:, 2:] = np.nan
    assert shift_found(uv) is None


def test_the_shear_statistic_is_small_for_noise_and_large_for_a_rolling_shutter() -> None:
    random = np.random.default_rng(5)
    noisy = [project(TRUTH) + random.normal(0.0, NOISE_PX, (COUNT, 4)) for _ in range(100)]
    statistics = [shift_found(uv).shear.chi2 for uv in noisy]
    # chi2 per degree of freedom is 1 on average; robust weights shorten the step
    assert 0.4 < np.mean(statistics) < 1.0
    rows = CAMERA.normalised(noisy[0][:, :2])[:, 1]
    noisy[0][:, 0] += rows
    noisy[0][:, 2] += rows
    assert shift_found(noisy[0]).shear.chi2 > 20.0


def test_the_shift_of_the_pose_by_a_shear_is_the_error_of_a_pose_that_was_solved_without_shears() -> None:
    uv = project(TRUTH)
    rows = CAMERA.normalised(uv[:, :2])[:, 1]
    uv[:, 0] += rows
    uv[:, 2] += rows
    observations = StereoObservations(uv, VARIANCE)
    sheared = solve_pose(START, LANDMARKS, observations, CAMERA, 30).pose
    found = pair_yaw(sheared, LANDMARKS, observations, CAMERA, SHAPE, 0.0)
    error = np.concatenate((TRUTH.position - sheared.position, rotvec_from_matrix(TRUTH.rotation @ sheared.rotation.T)))
    # robust weights make one step fall short
    np.testing.assert_allclose(found.shear.pose_shift, error, atol=0.4 * np.abs(error).max())


@pytest.mark.parametrize("centre_row", [240.0, 0.0, -300.0])
def test_a_shear_that_lens_errors_explain_is_not_significant_wherever_the_image_was_cropped(centre_row: float) -> None:
    camera = CAMERA._replace(cy=centre_row)
    landmarks = landmarks_of(camera)
    uv = project(TRUTH, camera=camera)
    lens_px = 2.0
    from_middle = uv[:, 3] - 240.0
    uv[:, 2] += lens_px * from_middle / np.abs(from_middle).max()
    observations = StereoObservations(uv, VARIANCE)
    assert pair_yaw(TRUTH, landmarks, observations, camera, SHAPE, 0.0).shear.chi2 > 10.0
    assert pair_yaw(TRUTH, landmarks, observations, camera, SHAPE, lens_px).shear.chi2 < 2.0

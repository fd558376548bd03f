"""Pose solver: a known pose is found again, its information is that of finite differences and of many noisy pairs."""

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

CAMERA = StereoCamera(400.0, 410.0, 256.0, 240.0, 0.2)
COUNT, NOISE_PX = 120, 0.2
RANDOM = np.random.default_rng(0)
HOST = Pose(matrix_from_rotvec([0.05, 0.1, -0.03]), np.array([0.2, -0.1, 0.3]))
TRUTH = Pose(matrix_from_rotvec([0.1, 0.05, 0.02]), np.array([0.5, 0.0, 0.8]))
UV, RHO = RANDOM.uniform(120, 400, (COUNT, 2)), RANDOM.uniform(0.08, 0.3, COUNT)
VARIANCE = np.tile([NOISE_PX**2, 0.0, NOISE_PX**2], (COUNT, 2, 1))
START = Pose(np.eye(3), np.zeros(3))


def project(pose: Pose, uv: np.ndarray = UV, rho: np.ndarray = RHO) -> np.ndarray:
    rays = np.column_stack((CAMERA.normalised(uv), np.ones(COUNT)))
    seen = (rays @ HOST.rotation.T + rho[:, None] * (HOST.position - pose.position)) @ pose.rotation
    u = CAMERA.fx * seen[:, 0] / seen[:, 2] + CAMERA.cx
    v = CAMERA.fy * seen[:, 1] / seen[:, 2] + CAMERA.cy
    return np.column_stack((u, v, u - CAMERA.fx * CAMERA.baseline_m * rho / seen[:, 2], v))


def solve(
    uv: np.ndarray, covariance: np.ndarray | None = None, start: Pose = START, iterations: int = 30
) -> PoseSolution:
    hosts = Poses(np.tile(HOST.rotation, (COUNT, 1, 1)), np.tile(HOST.position, (COUNT, 1)))
    rays = np.column_stack((CAMERA.normalised(UV), np.ones(COUNT)))
    covariance = np.zeros((COUNT, 3, 3)) if covariance is None else covariance
    landmarks = LandmarkEstimates(hosts, rays, RHO, covariance)
    return solve_pose(start, landmarks, StereoObservations(uv, VARIANCE), CAMERA, iterations)


def error(pose: Pose) -> np.ndarray:
    return np.concatenate((pose.position - TRUTH.position, rotvec_from_matrix(pose.rotation @ TRUTH.rotation.T)))


@pytest.mark.parametrize("hidden", [slice(0), slice(0, 2), slice(2, 4)])
def test_the_true_pose_is_found_from_exact_observations_of_either_image(hidden: slice) -> None:
    uv = project(TRUTH)
    uv[:60, hidden] = np.nan
    solution = solve(uv)
    np.testing.assert_allclose(error(solution.pose), 0.0, atol=1e-6)
    assert np.nanmax(solution.chi2_per_dof) < 1e-6


def test_wrong_observations_have_no_effect_and_are_told() -> None:
    uv = project(TRUTH)
    uv[:30] += RANDOM.uniform(5, 30, (30, 4))
    solution = solve(uv)
    np.testing.assert_allclose(error(solution.pose), 0.0, atol=1e-3)
    assert solution.chi2_per_dof[:30].min() > 9.0 > solution.chi2_per_dof[30:].max()


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


def test_information_is_that_of_many_noisy_pairs() -> None:
    errors = []
    for _ in range(300):
        solution = solve(project(TRUTH) + RANDOM.normal(0, NOISE_PX, (COUNT, 4)), start=TRUTH)
        errors.append(error(solution.pose))
    sigma = np.sqrt(np.diag(np.linalg.inv(solve(project(TRUTH), start=TRUTH).information)))
    np.testing.assert_allclose(np.std(errors, axis=0) / sigma, 1.0, atol=0.25)  # robust weights cost a little
    assert np.abs(np.mean(errors, axis=0) / sigma).max() < 4.5 / np.sqrt(300)


def test_too_few_observations_leave_the_start() -> None:
    uv = np.full((COUNT, 4), np.nan)
    uv[:5] = project(TRUTH)[:5]
    np.testing.assert_array_equal(solve(uv).pose.position, START.position)

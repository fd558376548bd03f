"""Projection of a landmark: Jacobians against central differences, pixels against the pinhole model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.projection import (
    Projection,
    intrinsics,
    linearise_in_host,
    linearise_landmark,
    new_projection,
)

CAMERA = StereoCamera(400.0, 420.0, 256.0, 240.0, 0.15)
STEP = 1e-6
TARGET, LANDMARK, UNKNOWNS = 0, 6, 9
"""Unknowns: the pose of the target, the landmark."""


@njit
def _project(target, host, landmark, out):  # noqa: ANN001, ANN202
    ray = np.array([(landmark[0] - CAMERA.cx) / CAMERA.fx, (landmark[1] - CAMERA.cy) / CAMERA.fy, 1.0])
    return linearise_landmark(target, host, 0, ray, landmark[2], intrinsics(CAMERA), out)


def project(unknowns: np.ndarray, poses: list[Pose], landmark: np.ndarray) -> tuple[float, Projection]:
    """Project with the target retracted by `unknowns[TARGET:LANDMARK]` and the landmark moved by the rest."""
    (pose, host), change, out = poses, unknowns[TARGET:LANDMARK], new_projection()
    target = Pose(matrix_from_rotvec(change[3:]) @ pose.rotation, pose.position + change[:3])
    hosts = Poses(host.rotation[None].copy(), host.position[None].copy())
    return _project(target, hosts, landmark + unknowns[LANDMARK:], out), out


def scene(seed: int) -> tuple[list[Pose], np.ndarray]:
    random = np.random.default_rng(seed)
    poses = [Pose(matrix_from_rotvec(random.normal(0, 0.1, 3)), random.normal(0, 0.3, 3)) for _ in range(2)]
    return poses, np.array([*random.uniform(100, 400, 2), random.uniform(0.05, 0.5)])


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_jacobians_are_central_differences(seed: int) -> None:
    poses, landmark = scene(seed)
    _, out = project(np.zeros(UNKNOWNS), poses, landmark)
    jacobian = np.hstack(out[1:])
    for column, step in enumerate(STEP * np.eye(UNKNOWNS)):
        difference = project(step, poses, landmark)[1].uv - project(-step, poses, landmark)[1].uv
        np.testing.assert_allclose(jacobian[:, column], difference / (2 * STEP), rtol=1e-6, atol=2e-5)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_pixels_are_those_of_the_point_in_both_cameras(seed: int) -> None:
    (target, host), landmark = scene(seed)
    ray = np.append(CAMERA.normalised(landmark[None, :2])[0], 1.0)
    point = target.rotation.T @ (host.rotation @ ray / landmark[2] + host.position - target.position)
    depth, out = project(np.zeros(UNKNOWNS), [target, host], landmark)
    u, v = CAMERA.fx * point[0] / point[2] + CAMERA.cx, CAMERA.fy * point[1] / point[2] + CAMERA.cy
    np.testing.assert_allclose(out.uv, [u, v, u - CAMERA.fx * CAMERA.baseline_m / point[2], v], atol=1e-9)
    assert depth == pytest.approx(point[2] * landmark[2])


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_in_its_own_pair_a_landmark_is_projected_as_in_any(seed: int) -> None:
    (_, host), landmark = scene(seed)
    _, expected = project(np.zeros(UNKNOWNS), [host, host], landmark)
    found = new_projection()
    linearise_in_host(landmark, intrinsics(CAMERA), found)
    np.testing.assert_allclose(found.uv, expected.uv, atol=1e-9)
    np.testing.assert_allclose(found.by_landmark, expected.by_landmark, atol=1e-9)
    assert not found.by_target.any()


def test_behind_the_camera_nothing_is_filled() -> None:
    pose = Pose(np.eye(3), np.zeros(3))
    behind = Pose(np.eye(3), np.array([0.0, 0.0, 10.0]))
    depth, out = project(np.zeros(UNKNOWNS), [behind, pose], np.array([250.0, 250.0, 0.5]))
    assert depth == 0.0
    assert not any(array.any() for array in out)

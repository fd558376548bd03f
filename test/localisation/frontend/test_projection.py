"""Projection into both images: its Jacobians against central differences."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.frontend.projection import (
    StereoProjection,
    intrinsics,
    linearise_landmark,
    new_projection,
)

CAMERA = StereoCamera(400.0, 410.0, 256.0, 240.0, 0.2)
STEP = 1e-6
TARGET, LANDMARK, UNKNOWNS = 0, 6, 9
"""Unknowns: the pose of the target, the landmark."""


@njit
def _project(target, host, landmark, out):  # noqa: ANN001, ANN202
    ray = np.array([(landmark[0] - CAMERA.cx) / CAMERA.fx, (landmark[1] - CAMERA.cy) / CAMERA.fy, 1.0])
    return linearise_landmark(target, host, 0, ray, landmark[2], intrinsics(CAMERA), out)


def projected(unknowns: np.ndarray, poses: list[Pose], landmark: np.ndarray) -> tuple[float, StereoProjection]:
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
    _, out = projected(np.zeros(UNKNOWNS), poses, landmark)
    jacobian = np.hstack(out[1:])
    for column, step in enumerate(STEP * np.eye(UNKNOWNS)):
        difference = projected(step, poses, landmark)[1].uv - projected(-step, poses, landmark)[1].uv
        np.testing.assert_allclose(jacobian[:, column], difference / (2 * STEP), rtol=1e-6, atol=2e-5)

"""Homographies of local planes: identity at zero motion, exact warp of a plane, derivative by differences."""

import numpy as np
import pytest
from numba import njit

from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.frontend.homography import (
    BEHIND,
    LocalPlanes,
    LocalWarp,
    local_warp,
    plane_homographies,
)

CAMERA = StereoCamera(400.0, 420.0, 256.0, 240.0, 0.2)
HOST = Pose(matrix_from_rotvec([0.1, -0.2, 0.05]), np.array([1.0, -2.0, 0.5]))
NORMAL, DISTANCE = np.array([0.2, -0.4, 1.0]), 3.0
"""A plane `NORMAL . X = DISTANCE` in the host camera."""


@njit
def around(h, u, v):  # noqa: ANN001, ANN201
    return local_warp(h, u, v)


def warped(h: np.ndarray, u: float, v: float, i: float = 0.0, j: float = 0.0) -> tuple[float, float]:
    """Return where the pixel (i, j) beside another one is, by the warp around that."""
    by = LocalWarp(*around(h, u, v))
    scale = 1.0 / (1.0 + by.wu * i + by.wv * j)
    return by.x + scale * (by.xu * i + by.xv * j), by.y + scale * (by.yu * i + by.yv * j)


def planes(uv: np.ndarray) -> LocalPlanes:
    """Return the plane at host pixels; its inverse depth is `NORMAL . ray / DISTANCE`."""
    hosts = Poses(np.tile(HOST.rotation, (len(uv), 1, 1)), np.tile(HOST.position, (len(uv), 1)))
    rays = np.column_stack((CAMERA.normalised(uv), np.ones(len(uv))))
    slopes = np.tile(NORMAL[:2] / [CAMERA.fx, CAMERA.fy] / DISTANCE, (len(uv), 1))
    return LocalPlanes(hosts, uv, rays @ NORMAL / DISTANCE, slopes)


UV = np.array([[200.0, 180.0], [300.5, 250.25], [90.0, 400.0]])


def test_zero_motion_is_the_identity() -> None:
    for h in plane_homographies(HOST, planes(UV), CAMERA, 0.0):
        np.testing.assert_allclose(h / h[2, 2], np.eye(3), atol=1e-9)


@pytest.mark.parametrize("offset_x", [0.0, CAMERA.baseline_m])
def test_pixels_around_the_host_pixel_move_as_points_of_the_plane_do(offset_x: float) -> None:
    target = Pose(matrix_from_rotvec([0.05, -0.1, 0.2]), HOST.position + np.array([0.3, -0.1, 0.2]))
    for (u, v), h in zip(UV, plane_homographies(target, planes(UV), CAMERA, offset_x), strict=True):
        for pixel in ([u, v], [u + 20, v - 10], [u - 5, v + 30]):
            ray = np.append(CAMERA.normalised(np.array([pixel]))[0], 1.0)
            world = HOST.rotation @ (ray * DISTANCE / (NORMAL @ ray)) + HOST.position
            x, y, z = target.rotation.T @ (world - target.position) - [offset_x, 0.0, 0.0]
            expected = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
            np.testing.assert_allclose(warped(h, *pixel), expected, atol=1e-8)
            beside = warped(h, u, v, pixel[0] - u, pixel[1] - v)
            np.testing.assert_allclose(beside, expected, atol=1e-8)


def test_derivative_is_that_of_the_warp() -> None:
    target = Pose(matrix_from_rotvec([0.05, -0.1, 0.2]), HOST.position + np.array([0.3, -0.1, 0.2]))
    h, step = plane_homographies(target, planes(UV), CAMERA, 0.0)[0], 1e-5
    by_u = (np.subtract(warped(h, 200 + step, 180.0), warped(h, 200 - step, 180.0))) / (2 * step)
    by_v = (np.subtract(warped(h, 200.0, 180 + step), warped(h, 200.0, 180 - step))) / (2 * step)
    np.testing.assert_allclose(around(h, 200.0, 180.0)[2:6], [by_u[0], by_v[0], by_u[1], by_v[1]], atol=1e-7)


def test_behind_the_camera() -> None:
    h = np.diag([1.0, 1.0, -1.0])
    assert warped(h, 1.0, 1.0) == (BEHIND, BEHIND)
    assert tuple(around(h, 1.0, 1.0))[2:] == (0.0,) * 6

"""Image pyramids, homographies of local planes and patches by their definitions."""

import numpy as np
import pytest
from numba import njit
from scipy.ndimage import gaussian_filter

from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.frontend.patch import HALF, SIDE, cut_patches, half_width, templates_of
from sfr_loc_map.localisation.frontend.plane_warp import LocalPlanes, LocalWarp, local_warp, plane_homographies

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
RANDOM = np.random.default_rng(0)
IMAGE = gaussian_filter(RANDOM.normal(128.0, 400.0, (120, 160)), 2.0).astype(np.float32)
PLACES = RANDOM.integers(25, 95, (30, 2)).astype(float)


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


def test_patches_hold_values_and_central_differences() -> None:
    patches = cut_patches(IMAGE, PLACES, HALF)
    assert patches.shape == (len(PLACES), 3, SIDE * SIDE)
    assert half_width(SIDE * SIDE) == HALF
    for patch, (u, v) in zip(patches, PLACES.astype(int), strict=True):
        rows, columns = slice(v - HALF, v + HALF + 1), slice(u - HALF, u + HALF + 1)
        dy, dx = np.gradient(IMAGE.astype(float))
        for values, whole in zip(patch, (IMAGE, dx, dy), strict=True):
            np.testing.assert_allclose(values.reshape(SIDE, SIDE), whole[rows, columns], atol=1e-3)


def test_templates_have_no_mean_and_no_derivative_by_contrast() -> None:
    patches = cut_patches(IMAGE, PLACES, HALF)
    values, moments = templates_of(patches.copy())
    centred = patches.astype(float) - patches.mean(axis=2, keepdims=True, dtype=float)
    power = np.einsum("nk,nk->n", centred[:, 0], centred[:, 0])
    np.testing.assert_allclose(moments[:, 0], power, rtol=1e-4)
    along = np.einsum("nk,nik->ni", centred[:, 0], centred[:, 1:]) / power[:, None]
    np.testing.assert_allclose(moments[:, 1:3], along, atol=1e-4)
    expected = centred[:, 1:] - along[:, :, None] * centred[:, :1]
    np.testing.assert_allclose(values[:, 1:], expected, atol=1e-2)
    products = np.einsum("nik,njk->nij", expected, expected)
    np.testing.assert_allclose(moments[:, 3:], products[:, [0, 0, 1], [0, 1, 1]], rtol=1e-3, atol=1.0)
    assert not templates_of(np.full((1, 3, SIDE * SIDE), 7.0, np.float32)).moments.any()  # no texture

"""Photometric alignment: its gradient against central differences, and a known pose found from a textured plane."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from helpers.wall import wall_view
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.localisation.frontend import photometric_alignment as alignment
from sfr_loc_map.localisation.frontend.patch import Templates, cut_patches, templates_of
from sfr_loc_map.localisation.frontend.plane_warp import LocalPlanes, plane_homographies
from sfr_loc_map.localisation.frontend.pyramid import ImageLevel

CAMERA = StereoCamera(200.0, 210.0, 119.5, 89.5, 0.1)
HEIGHT, WIDTH, DEPTH, HALF = 180, 240, 2.0, 3
RANDOM = np.random.default_rng(0)
IMAGE = gaussian_filter(RANDOM.normal(128.0, 600.0, (HEIGHT, WIDTH)), 4.0)
START = Pose(np.eye(3), np.zeros(3))
UV = RANDOM.integers((40, 40), (200, 140), (60, 2)).astype(float)


def planes(uv: np.ndarray = UV) -> LocalPlanes:
    """A wall at 2 m in front of the host, which is the world."""
    count = len(uv)
    hosts = Poses(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    return LocalPlanes(hosts, uv, np.full(count, 1.0 / DEPTH), np.zeros((count, 2)))


def view(pose: Pose) -> np.ndarray:
    """Render the wall from another pose: each pixel looks up the host image."""
    return wall_view(IMAGE, CAMERA, DEPTH, pose).astype(np.float32)


def aligned(
    level: ImageLevel, templates: Templates, planes: LocalPlanes, start: Pose, iterations: int
) -> alignment.PoseAlignment:
    homographies = plane_homographies(start, planes, CAMERA, 0.0)
    return alignment.align_patches(level, templates, homographies, planes, start, CAMERA, iterations)


def moved(pose: Pose, change: np.ndarray) -> Pose:
    return Pose(matrix_from_rotvec(change[3:]) @ pose.rotation, pose.position + change[:3])


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_jacobian_of_the_pixel_is_that_of_central_differences(scale: float) -> None:
    pose, out, step = Pose(matrix_from_rotvec([0.1, -0.2, 0.05]), np.array([0.1, 0.2, -0.3])), np.zeros((2, 6)), 1e-6
    point = alignment._project(planes(), 0, pose, CAMERA)
    alignment._fill_jacobian(point, 1.0 / DEPTH, pose.rotation, CAMERA, scale, out)

    def pixel(change: np.ndarray) -> np.ndarray:
        point = alignment._project(planes(), 0, moved(pose, change), CAMERA)
        return np.array([CAMERA.fx * point.x, CAMERA.fy * point.y]) / scale

    expected = np.stack([(pixel(e) - pixel(-e)) / (2 * step) for e in step * np.eye(6)], axis=-1)
    np.testing.assert_allclose(out, expected, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("size", [0.0, 1.0, -1.0])
def test_a_known_pose_is_found(size: float) -> None:
    truth = moved(START, size * np.array([0.012, -0.01, 0.02, 0.006, -0.004, 0.01]))
    patches = templates_of(cut_patches(IMAGE.astype(np.float32), UV, HALF))
    found = aligned(ImageLevel(view(truth), 1.0), patches, planes(), START, 15)
    assert found.correlation > 0.99
    np.testing.assert_allclose(found.pose.position, truth.position, atol=4e-3)
    np.testing.assert_allclose(rotvec_from_matrix(found.pose.rotation @ truth.rotation.T), 0.0, atol=1e-3)

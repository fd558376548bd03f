import cv2
import numpy as np
import pytest

from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.localisation.frontend.right_offset import RightOffset

CAMERA = StereoCamera(400.0, 400.0, 256.0, 240.0, 0.2)


@pytest.mark.parametrize("rotvec", [(1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3), (2e-4, -5e-4, 8e-4)])
def test_flow_of_a_small_rotation(rotvec: tuple[float, float, float]) -> None:
    """Rays rotated by a rotation matrix and projected again, square pixels."""
    camera = StereoCamera(400.0, 400.0, 256.0, 240.0, 0.2)
    uv = np.random.default_rng(0).uniform(0.0, 512.0, (200, 2))
    rays = np.column_stack((camera.normalised(uv), np.ones(200)))
    rotated = rays @ cv2.Rodrigues(np.array(rotvec))[0].T
    moved = rotated[:, :2] / rotated[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy] - uv
    pitch, yaw, roll = rotvec
    offset = RightOffset(u=400.0 * yaw, v=-400.0 * pitch, roll=400.0 * roll)
    np.testing.assert_allclose(offset.at(uv, camera), moved, atol=1e-3)


def test_at_the_centre_it_is_the_offset_itself() -> None:
    np.testing.assert_allclose(
        RightOffset(0.3, -0.2, 5.0).at(np.array([[CAMERA.cx, CAMERA.cy]]), CAMERA), [[0.3, -0.2]]
    )
    np.testing.assert_array_equal(RightOffset().at(np.ones((3, 2)), CAMERA), np.zeros((3, 2)))

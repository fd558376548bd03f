"""Relocalisation: poses from optical flow and from descriptors."""

from __future__ import annotations

import numpy as np
import pytest
from loc_drive import pair_of_drive
from made_scene import LOC_RIG, true_pose, wall_points

from sfr_loc_map.localisation.frontend.feature_detection import find_corners
from sfr_loc_map.localisation.relocalisation import pnp_from_descriptors, pnp_from_optical_flow

CAMERA, ENOUGH = LOC_RIG.camera, 20


def corners_of(image: np.ndarray) -> np.ndarray:
    return find_corners(image.astype(np.float32), np.zeros((0, 2)), 400, 20)


def known() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first image with pixels of it and their points."""
    image = pair_of_drive(0).left
    uv = corners_of(image)
    points = wall_points(true_pose(0) @ LOC_RIG.T_rb_left, LOC_RIG)[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    return image, uv, points


@pytest.mark.parametrize(("index", "by_flow"), [(3, True), (8, True), (20, False)])
def test_poses_by_flow_and_from_afar_by_descriptors(index: int, by_flow: bool) -> None:
    image, truth = pair_of_drive(index).left, true_pose(index) @ LOC_RIG.T_rb_left
    if by_flow:
        pose = pnp_from_optical_flow(*known(), image, CAMERA, ENOUGH)
    else:
        pose = pnp_from_descriptors(*known(), image, corners_of(image), CAMERA, ENOUGH)
    assert pose is not None
    np.testing.assert_allclose(pose.position, truth.translation, atol=0.02 if by_flow else 0.05)
    np.testing.assert_allclose(pose.rotation, truth.rotation, atol=0.01 if by_flow else 0.05)

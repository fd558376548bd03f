"""Weights of a second exposure: blends of two views of a wall whose weights are known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from helpers.wall import wall_view
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.frontend.landmarks import NO_PATCHES, HostPatches, LandmarkTemplates
from sfr_loc_map.localisation.frontend.plane_warp import LocalPlanes, plane_homographies
from sfr_loc_map.localisation.frontend.pyramid import build_pyramid
from sfr_loc_map.localisation.ground.double_exposure import MIXTURE_LEVEL, Mixture, mixture_of, shows_second_exposure
from sfr_loc_map.localisation.ground.evidence import MIXTURE_LANDMARKS

CAMERA = StereoCamera(200.0, 210.0, 119.5, 89.5, 0.1)
HEIGHT, WIDTH, DEPTH_M = 180, 240, 2.0
RANDOM = np.random.default_rng(0)
WALL = gaussian_filter(RANDOM.normal(128.0, 200.0, (HEIGHT, WIDTH)), 2.0)
HOST = Pose(np.eye(3), np.zeros(3))
SHOWN = Pose(matrix_from_rotvec([0.005, -0.01, 0.01]), np.array([0.02, -0.01, 0.03]))
OTHER = Pose(matrix_from_rotvec([0.02, -0.02, 0.0]), np.array([0.07, 0.02, 0.08]))  # some 10 px apart
AWAY = Pose(matrix_from_rotvec([-0.02, 0.03, 0.0]), np.array([-0.05, 0.02, 0.0]))


def view(pose: Pose) -> np.ndarray:
    """Render the wall at 2 m: each pixel looks up the host image."""
    return wall_view(WALL, CAMERA, DEPTH_M, pose)


def landmarks(count: int = 150) -> Any:
    """Return landmarks of two keyframes at the same pose, of which the first hosts none."""
    uv = np.random.default_rng(1).integers((40, 40), (200, 140), (count, 2)).astype(float)
    planes = LocalPlanes(
        Poses(np.tile(HOST.rotation, (len(uv), 1, 1)), np.zeros((len(uv), 3))),
        uv,
        np.full(len(uv), 1.0 / DEPTH_M),
        np.zeros((len(uv), 2)),
    )
    host = HostPatches(uv, NO_PATCHES.fine, build_pyramid(grey(WALL))[1:])
    return SimpleNamespace(planes=planes, patches=LandmarkTemplates((NO_PATCHES, host), np.arange(len(uv))))


def grey(image: np.ndarray, noise: float = 0.0) -> np.ndarray:
    noisy = image + noise * np.random.default_rng(2).standard_normal(image.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def homographies(found: Any, pose: Pose) -> np.ndarray:
    return plane_homographies(pose, found.planes, CAMERA, 0.0)


def mixture(image: np.ndarray, other: Pose = OTHER, noise: float = 0.0) -> Mixture:
    level = build_pyramid(grey(image, noise))[MIXTURE_LEVEL].image
    found = landmarks()
    return mixture_of(level, found, homographies(found, SHOWN), homographies(found, other))


@pytest.mark.parametrize("weight", [0.0, 0.1, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("noise", [0.0, 5.0])
def test_the_weight_of_the_other_exposure_is_found(weight: float, noise: float) -> None:
    found = mixture((1.0 - weight) * view(SHOWN) + weight * view(OTHER), noise=noise)
    assert found.patches > 60
    assert found.weight == pytest.approx(weight, abs=0.03)
    assert found.standard_error < 0.03


@pytest.mark.parametrize("min_tracked", [25, 100])
def test_a_second_exposure_is_found_however_many_landmarks_a_pose_requires(min_tracked: int) -> None:
    few = landmarks(MIXTURE_LANDMARKS)
    for weight in (0.0, 0.5):
        image = build_pyramid(grey((1.0 - weight) * view(SHOWN) + weight * view(OTHER)))[MIXTURE_LEVEL].image
        found = shows_second_exposure(image, few, homographies(few, SHOWN), homographies(few, OTHER), min_tracked)
        assert found == (weight > 0.0)


def test_brightness_and_contrast_do_not_change_the_weight() -> None:
    blend = 0.6 * view(SHOWN) + 0.4 * view(OTHER)
    assert mixture(0.6 * blend + 40.0).weight == pytest.approx(0.4, abs=0.03)


def test_an_exposure_from_elsewhere_is_not_found() -> None:
    assert mixture(0.5 * view(SHOWN) + 0.5 * view(AWAY)).weight < 0.1


def test_poses_that_see_the_same_do_not_determine_a_weight() -> None:
    found = mixture(view(SHOWN), other=SHOWN)
    assert found.patches == 0
    assert np.isnan(found.weight)


def test_a_saturated_image_does_not_determine_a_weight() -> None:
    assert mixture(np.full((HEIGHT, WIDTH), 255.0)).patches == 0

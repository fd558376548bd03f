"""Which pixels are kept: one cause of invalidity at a time, on a scene that is otherwise perfect."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from disparity_world import make_world, slope

from sfr_loc_map.mapping.disparity.filters import local_variance
from sfr_loc_map.mapping.disparity.uncertainty import NOISE_INFORMATION, disparity_sigma
from sfr_loc_map.mapping.disparity.validity import MAX_CHANGE_PX, occlusion_mask, valid_mask
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity, refine

F = np.float32
PART = np.s_[100:140, 150:190]
"""Region where something is wrong."""
INNER = np.s_[8:-8, 48:-8]


class Scene:
    """A refined scene and its start."""

    def __init__(self, made: Any) -> None:
        self.left, self.right = made.pair.left.astype(F), made.pair.right.astype(F)
        self.initial = made.disparity.astype(F)
        self.refined = refine(self.left, self.right, self.initial)

    def mask(self, refined: RefinedDisparity | None = None, initial: np.ndarray | None = None) -> np.ndarray:
        refined = refined or self.refined
        start = self.initial if initial is None else initial
        return valid_mask(self.left, refined, start, disparity_sigma(refined), local_variance(self.left))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(make_world(slope, noise=2.0))


def test_a_good_scene_is_kept_where_both_cameras_see_it(scene: Scene) -> None:
    mask, columns = scene.mask(), np.arange(scene.left.shape[1])
    assert mask[INNER].mean() > 0.999
    assert not mask[columns[None] - scene.refined.disparity_px < -1.0].any()


@pytest.mark.parametrize("cause", ["not matched", "moved far", "textureless", "unlike"])
def test_a_region_is_invalid_for_each_cause_alone(scene: Scene, cause: str) -> None:
    initial, information, residual = (
        np.array(image) for image in (scene.initial, scene.refined.information, scene.refined.normalised_residual)
    )
    noise = scene.refined.noise
    match cause:
        case "not matched":
            initial[PART] = np.nan
        case "moved far":
            initial[PART] += 2.0 * MAX_CHANGE_PX
        case "textureless":
            information[40:80, 65:105] = NOISE_INFORMATION  # of cells of 2 x 2 pixels
        case "unlike":
            noise = 6.0
            contrast = scene.left[PART].std() / noise
            residual[PART] = np.random.default_rng(0).normal(0.0, 1.4 * contrast, residual[PART].shape)
    refined = replace(scene.refined, information=information, normalised_residual=residual, noise=noise)
    mask = scene.mask(refined, initial)
    assert mask[110:130, 160:180].mean() < 0.2
    mask[80:164, 130:210] = True
    assert mask[INNER].mean() > 0.99


def test_the_background_left_of_a_block_is_occluded() -> None:
    """The block covers columns 46-75 of the right image; there the background of columns 52-81 would be."""
    disparity, valid = np.full((40, 120), F(6.0)), np.ones((40, 120), bool)
    disparity[10:30, 60:90] = 14.0
    expected = np.zeros_like(valid)
    expected[:, :6] = True
    expected[10:30, 52:60] = True
    np.testing.assert_array_equal(occlusion_mask(disparity, valid, F(1.0)), expected)
    assert not occlusion_mask(disparity, valid, F(8.5))[:, 14:].any()  # nearer by less than the jump
    valid[10:30, 60:90] = False  # what is not valid occludes nothing
    assert not occlusion_mask(disparity, valid, F(1.0))[:, 6:].any()

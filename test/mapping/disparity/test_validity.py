"""Which pixels are kept: one cause of invalidity at a time, on a scene that is otherwise perfect."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.mapping.disparity.filters import local_variance
from sfr_loc_map.mapping.disparity.segments import MIN_PIXELS
from sfr_loc_map.mapping.disparity.uncertainty import NOISE_INFORMATION, disparity_sigma
from sfr_loc_map.mapping.disparity.validity import MAX_CHANGE_PX, MAX_SLOPE, Likeness, _passing, valid_mask
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity, refine

F = np.float32
PART = np.s_[100:140, 150:190]
"""Region where something is wrong."""
SURE = np.s_[110:130, 160:180]
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
def scene(world: Any, slope_field: Any) -> Scene:
    return Scene(world(slope_field, noise=2.0))


def outside(mask: np.ndarray) -> np.ndarray:
    """Return the mask far from the region."""
    far = mask.copy()[INNER]
    far[72:156, 82:162] = True
    return far


def test_a_good_scene_is_kept(scene: Scene) -> None:
    assert scene.mask()[INNER].mean() > 0.999


def test_columns_that_the_right_camera_does_not_see_are_invalid(scene: Scene) -> None:
    columns = np.arange(scene.left.shape[1])
    out_of_view = columns[None] - scene.refined.disparity_px < -1.0
    assert not scene.mask()[out_of_view].any()


def test_what_the_matcher_left_out_is_invalid(scene: Scene) -> None:
    initial = scene.initial.copy()
    initial[PART] = np.nan
    mask = scene.mask(initial=initial)
    assert not mask[PART].any()
    assert outside(mask).mean() > 0.999
    assert not scene.mask(initial=np.full_like(initial, np.nan)).any()


def test_what_refinement_moved_far_is_invalid(scene: Scene) -> None:
    initial = scene.initial.copy()
    initial[PART] += 2.0 * MAX_CHANGE_PX
    mask = scene.mask(initial=initial)
    assert not mask[PART].any()
    assert outside(mask).mean() > 0.999


def test_textureless_regions_are_invalid(scene: Scene) -> None:
    information = scene.refined.information.copy()
    information[40:80, 65:105] = NOISE_INFORMATION
    mask = scene.mask(replace(scene.refined, information=information))
    assert not mask[SURE].any()
    assert outside(mask).mean() > 0.99


def test_regions_that_differ_between_the_images_are_invalid(scene: Scene) -> None:
    residual = scene.refined.normalised_residual.copy()
    noise = 6.0
    contrast = scene.left[PART].std() / noise
    residual[PART] = np.random.default_rng(0).normal(0.0, 1.4 * contrast, residual[PART].shape)
    mask = scene.mask(replace(scene.refined, normalised_residual=residual, noise=noise))
    assert mask[SURE].mean() < 0.2
    assert outside(mask).mean() > 0.999


def test_specks_are_invalid_and_islands_are_not(scene: Scene) -> None:
    initial = np.full_like(scene.initial, np.nan)
    side = int(np.sqrt(MIN_PIXELS))
    speck, island = np.s_[50 : 50 + side, 100 : 100 + side], np.s_[150 : 152 + side, 200 : 202 + side]
    for part in (speck, island):
        initial[part] = scene.initial[part]
    mask = scene.mask(initial=initial)
    assert not mask[speck].any()
    assert mask[island].all()


def test_pixels_of_a_surface_that_is_not_theirs_are_invalid(scene: Scene) -> None:
    """A ridge of three pixels that no image shows: the surface beside it matches better."""
    disparity = scene.refined.disparity_px.copy()
    disparity[60:120, 200:203] += 4.0
    initial = scene.initial.copy()
    initial[60:120, 200:203] += 4.0
    mask = scene.mask(replace(scene.refined, disparity_px=disparity), initial)
    assert mask[60:120, 200:203].mean() < 0.1
    assert mask[60:120, 206:216].mean() > 0.9


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_ramps_between_surfaces_are_invalid(scene: Scene, sign: float) -> None:
    """Six columns that rise or fall by a pixel each lie on one ray of a camera; half as steep ground stays."""
    for slope, kept in ((0.95, False), (0.5 * MAX_SLOPE, True)):
        ramp = np.clip(np.arange(scene.left.shape[1]) - 200.0, 0.0, 6.0) * sign * slope
        initial = (scene.initial + ramp).astype(F)
        refined = replace(scene.refined, disparity_px=(scene.refined.disparity_px + ramp).astype(F))
        flat = np.ones_like(initial)
        alike = Likeness(flat, 0.0 * flat, flat, F(1.0))
        assert _passing(refined.disparity_px, flat > 0.0, flat < 0.0, alike)[50:150, 202:205].any() == kept
        if not kept:
            assert not scene.mask(refined, initial)[50:150, 202:205].any()

"""The own body and rows of another pair are found by what two pairs show at the same pixels, ground is not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from helpers.made_scene import NAV_RIG, nav_pair
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.maps import FusedMap

FIRST_ROW, DISPARITY = 80, 14


def with_body(item: PosedStereoPair, seed: int = 0) -> PosedStereoPair:
    """Cover the lower third of both images by a textured plane that moves with the camera."""
    noise = np.random.default_rng(seed).normal(size=(120, 200)).astype(np.float32)
    texture = cv2.GaussianBlur(noise, (0, 0), 1.5)
    texture = np.clip(128.0 + 40.0 * texture / texture.std(), 0, 255).astype(np.uint8)
    left, right = item.pair.left.copy(), item.pair.right.copy()
    left[FIRST_ROW:] = texture[FIRST_ROW:, :160]
    right[FIRST_ROW:] = texture[FIRST_ROW:, DISPARITY : 160 + DISPARITY]
    return replace(item, pair=StereoPair(item.pair.stamp_ns, left, right))


def fused(items: list[PosedStereoPair]) -> FusedMap:
    mapper = Mapper(NAV_RIG, MappingConfig())
    return mapper.fuse([mapper.process(item.pair, item.T_lm_navsb, k) for k, item in enumerate(items)])


@pytest.fixture(scope="module")
def ground() -> list[PosedStereoPair]:
    return [nav_pair(0), nav_pair(2)]


def test_ground_is_kept(ground: list[PosedStereoPair]) -> None:
    result = fused(ground)
    assert not any("is the same in pairs" in line for line in result.warnings)
    assert "fixed_share_0" not in result.statistics


def test_the_own_body_is_left_out_and_told(ground: list[PosedStereoPair]) -> None:
    result = fused([with_body(item) for item in ground])
    assert any("is the same in pairs 0 and 1 although the camera has moved" in line for line in result.warnings)
    assert result.statistics["fixed_share_0"] > 0.2
    rows = result.cloud.v
    assert (rows > FIRST_ROW + 8).mean() < 0.02
    assert (rows < FIRST_ROW - 12).mean() > 0.8


def test_rows_of_another_pair_are_left_out(ground: list[PosedStereoPair]) -> None:
    one, other = (item.pair for item in ground)
    left, right = np.vstack((other.left[:60], one.left[60:])), np.vstack((other.right[:60], one.right[60:]))
    result = fused([ground[0], replace(ground[1], pair=StereoPair(other.stamp_ns, left, right))])
    assert any("rows of another pair" in line for line in result.warnings)
    assert (result.cloud.v > 70).mean() < 0.02


def test_a_camera_that_stands_still_sees_the_same_and_so_do_unlike_bodies(ground: list[PosedStereoPair]) -> None:
    again = replace(ground[0], pair=replace(ground[0].pair, stamp_ns=ground[0].pair.stamp_ns + 1))
    assert "fixed_share_0" not in fused([ground[0], again]).statistics
    other = fused([with_body(ground[0], seed=1), with_body(ground[1], seed=2)])
    assert "fixed_share_0" not in other.statistics

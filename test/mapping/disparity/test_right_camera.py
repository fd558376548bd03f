"""Exposure and vertical disparity of a right camera are compensated; its rotation is found, told, and in sigma."""

from typing import Any

import cv2
import numpy as np
import pytest
from disparity_world import World, hills, make_world

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper, PairMap

INNER = np.s_[16:-16, 64:-16]


def mapped(made: Any, rotvec_deg: tuple[float, float, float]) -> PairMap:
    """Map a world with the right camera rotated about x (right), y (down) and z (forward)."""
    K = made.rig.camera_matrix
    homography = K @ matrix_from_rotvec(np.radians(rotvec_deg)).T @ np.linalg.inv(K)
    size = (made.rig.width, made.rig.height)
    right = cv2.warpPerspective(made.pair.right, homography, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    pair = StereoPair(0, made.pair.left, np.asarray(right, np.uint8))
    return Mapper(made.rig, MappingConfig()).process(pair, Transform.identity(), 0)


@pytest.fixture(scope="module")
def made() -> World:
    return make_world(hills, width=512, height=448, noise=2.0, seed=4)


@pytest.fixture(scope="module")
def straight(made: Any) -> PairMap:
    return mapped(made, (0.0, 0.0, 0.0))


def test_a_camera_that_is_as_calibrated_is_not_doubted(straight: PairMap) -> None:
    assert abs(straight.statistics["right_yaw_deg"]) < 0.015
    assert abs(straight.statistics["right_roll_deg"]) < 0.01
    assert straight.warnings == ()


@pytest.mark.parametrize("yaw_deg", [-0.15, 0.15])
def test_a_yaw_is_measured_told_and_covered_by_sigma(made: Any, straight: PairMap, yaw_deg: float) -> None:
    result = mapped(made, (0.0, yaw_deg, 0.0))
    assert result.statistics["right_yaw_deg"] == pytest.approx(yaw_deg, rel=0.35)
    assert any("deg to the " + ("right" if yaw_deg > 0 else "left") in line for line in result.warnings)
    scale = made.rig.fx * made.rig.baseline_m
    error = (scale / result.disparity_px - scale / made.disparity)[INNER]
    total, random = np.full((2, *made.disparity.shape), np.nan)
    total[result.cloud.v, result.cloud.u] = result.cloud.sigma
    random[result.cloud.v, result.cloud.u] = result.random_sigma
    assert np.nanmedian(np.abs(error / total[INNER])) < 2.0
    assert np.nanmedian(np.abs(error / random[INNER])) > 10.0  # what noise alone would have stated
    assert np.median(result.cloud.sigma) > 3.0 * np.median(straight.cloud.sigma)


def test_a_roll_is_taken_out_of_the_disparities(made: Any) -> None:
    result = mapped(made, (0.0, 0.0, 0.15))
    assert result.statistics["right_roll_deg"] == pytest.approx(0.15, abs=0.015)
    error = (result.disparity_px - made.disparity)[INNER]
    assert np.nanmedian(np.abs(error)) < 0.04  # 0.3 px at the upper and lower edge without
    assert any("vertical disparity" in line for line in result.warnings)

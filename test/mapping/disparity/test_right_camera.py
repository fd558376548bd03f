"""Exposure and vertical disparity of a right camera are compensated; its rotation is found, told, and in sigma."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from helpers.disparity_world import World, hills, make_world
from sfr_loc_map.faults.injector import FaultInjector
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import CalibrationPrior, MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.maps import PairMap

DEFAULTS = MappingConfig()
INNER = np.s_[16:-16, 64:-16]


def mapped(
    made: Any, rotvec_deg: tuple[float, float, float], decentring_px: float = 0.0, config: MappingConfig = DEFAULTS
) -> PairMap:
    """Map a world with the right camera rotated about x (right), y (down) and z (forward), and its lens decentred.

    Decentring distortion moves content by `a (3 x^2 + y^2, 2 x y)` (Brown 1966): the saddle of a yaw.
    """
    K = made.rig.camera_matrix
    v, u = np.mgrid[: made.rig.height, : made.rig.width].astype(np.float64)
    x, y = (u - made.rig.cx) / (0.5 * made.rig.width), (v - made.rig.cy) / (0.5 * made.rig.height)
    u, v = u - decentring_px * (3 * x * x + y * y - 4 / 3), v - decentring_px * 2 * x * y
    points = (
        np.stack((u, v, np.ones_like(u)), axis=-1)
        @ (K @ matrix_from_rotvec(np.radians(rotvec_deg)) @ np.linalg.inv(K)).T
    )
    places = (points[..., :2] / points[..., 2:]).astype(np.float32)
    right = cv2.remap(made.pair.right, places, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    pair = StereoPair(0, made.pair.left, np.asarray(right, np.uint8))
    return Mapper(made.rig, config).process(pair, Transform.identity(), 0)


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


def errors_over_sigma(made: Any, result: PairMap) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the depths over sigma, and over its random part."""
    scale = made.rig.fx * made.rig.baseline_m
    error = (scale / result.disparity_px - scale / made.disparity)[INNER]
    total, random = np.full((2, *made.disparity.shape), np.nan)
    total[result.cloud.v, result.cloud.u] = result.cloud.sigma
    random[result.cloud.v, result.cloud.u] = result.random_sigma
    return error / total[INNER], error / random[INNER]


def test_sigma_of_an_exact_calibration_is_that_of_noise(made: Any) -> None:
    exact = MappingConfig(calibration=CalibrationPrior(0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    for decentring_px in (0.0, 0.02):  # less vertical disparity than is ever warned of
        result = mapped(made, (0.0, 0.0, 0.0), decentring_px, exact)
        assert result.warnings == ()
        np.testing.assert_array_equal(result.cloud.sigma, result.random_sigma)


@pytest.mark.parametrize("yaw_deg", [-0.8, 0.25, 0.6])
def test_a_yaw_is_measured_although_the_disparities_explain_a_part_of_it(made: Any, yaw_deg: float) -> None:
    statistics = mapped(made, (0.0, yaw_deg, 0.0)).statistics
    assert statistics["right_yaw_deg"] == pytest.approx(yaw_deg, rel=0.1)
    assert abs(statistics["right_yaw_deg"] - yaw_deg) < 2.0 * statistics["right_yaw_sigma_deg"]


@pytest.mark.parametrize("yaw_deg", [-0.4, 0.4])
def test_a_yaw_is_measured_told_and_covered_by_sigma(made: Any, straight: PairMap, yaw_deg: float) -> None:
    result = mapped(made, (0.0, yaw_deg, 0.0))
    assert result.statistics["right_yaw_deg"] == pytest.approx(yaw_deg, rel=0.1)
    assert any("deg to the " + ("right" if yaw_deg > 0 else "left") in line for line in result.warnings)
    total, random = errors_over_sigma(made, result)
    assert np.nanmedian(np.abs(total)) < 2.0
    assert np.nanmedian(np.abs(random)) > 10.0  # what noise alone would have stated
    assert np.median(result.cloud.sigma) > 3.0 * np.median(straight.cloud.sigma)


@pytest.mark.parametrize("decentring_px", [-0.2, 0.2])
def test_left_over_distortion_is_no_yaw_and_is_covered_by_sigma(made: Any, decentring_px: float) -> None:
    result = mapped(made, (0.0, 0.0, 0.0), decentring_px)
    assert result.statistics["right_yaw_deg"] == pytest.approx(-0.1 * np.sign(decentring_px), abs=0.03)
    assert result.warnings == ()
    total, random = errors_over_sigma(made, result)
    assert 0.1 < np.nanmedian(np.square(total)) < 0.7
    assert np.nanmean(np.abs(total) < 3.0) > 0.95
    assert np.nanmedian(np.square(random)) > 5.0


@pytest.mark.parametrize("fy", [250.0, 350.0])
def test_a_roll_is_taken_out_of_the_disparities(made: World, fy: float) -> None:
    made = replace(made, rig=replace(made.rig, fy=fy))
    result = mapped(made, (0.0, 0.0, 0.25))
    assert result.statistics["right_roll_deg"] == pytest.approx(0.25, abs=0.015)
    error = (result.disparity_px - made.disparity)[INNER]
    assert np.nanmedian(np.abs(error)) < 0.04  # 0.5 px at the upper and lower edge without
    assert any("vertical disparity" in line for line in result.warnings)


@pytest.mark.parametrize(
    ("fault", "statistic", "expected"),
    [
        ("yaw:amount=0.3", "right_yaw_deg", -0.3),
        ("pitch:amount=0.1", "vertical_offset_px", -np.radians(0.1)),
        ("roll:amount=0.2", "right_roll_deg", 0.2),
    ],
)
def test_injected_yaw_and_pitch_are_measured_with_the_opposite_sign(
    made: World, fault: str, statistic: str, expected: float
) -> None:
    [(_, pair)] = FaultInjector([parse_fault(fault)], 0, 1, made.rig).pairs([made.pair])
    found = Mapper(made.rig).process(pair, Transform.identity()).statistics[statistic]
    unit = made.rig.fy if statistic == "vertical_offset_px" else 1.0
    assert found / (unit * expected) == pytest.approx(1.0, abs=0.5)

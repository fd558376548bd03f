"""Poses that are wrong by known amounts are found back."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper, PairMap

POSE = Transform(matrix_from_rotvec([0.0, 0.4, 0.3]), np.array([0.0, 0.0, 2.0]))


@pytest.fixture(scope="module")
def two(world: Any, hills_field: Any) -> tuple[Mapper, list[PairMap]]:
    """Two pairs of the same ground from the same place with other noise."""
    first, second = (world(hills_field, width=384, height=320, noise=3.0, noise_seed=n) for n in (1, 2))
    mapper = Mapper(first.rig, MappingConfig(refine_poses=True))
    return mapper, [mapper.process(first.pair, POSE, 0), mapper.process(second.pair, POSE, 1)]


def posed(item: PairMap, error: Transform) -> PairMap:
    cloud = item.cloud
    pose = POSE @ error
    xyz = (pose @ POSE.inverse()).apply(cloud.xyz).astype(np.float32)
    moved = PointCloud(xyz, cloud.sigma, cloud.intensity, cloud.u, cloud.v, cloud.pair)
    return PairMap(item.stamp_ns, pose, item.disparity_px, moved, item.statistics)


@pytest.mark.parametrize(
    ("turn_deg", "shift_m"),
    [((0, 0, 0), (0, 0, 0)), ((0, 0, 1), (0, 0, 0)), ((1, 0, 0), (0, 0, 0)), ((0.3, -0.6, 0.4), (0.01, 0.0, -0.01))],
)
def test_pose_errors_are_found_back(two: Any, turn_deg: tuple[float, ...], shift_m: tuple[float, ...]) -> None:
    mapper, maps = two
    error = Transform(matrix_from_rotvec(np.deg2rad(turn_deg)), np.array(shift_m, float))
    fused = mapper.fuse([maps[0], posed(maps[1], error)])
    rest = POSE.inverse() @ fused.T_lm_navsb[1]
    assert np.rad2deg(np.linalg.norm(rotvec_from_matrix(rest.rotation))) < 0.05
    assert np.linalg.norm(rest.translation) < 0.003
    assert fused.statistics["pose_turned_deg_1"] == pytest.approx(np.linalg.norm(turn_deg), abs=0.05)
    assert not fused.warnings


def test_the_poses_of_the_first_pair_and_of_pairs_that_do_not_overlap_stay(two: Any) -> None:
    mapper, maps = two
    away = Transform(np.eye(3), np.array([0.0, 300.0, 0.0]))
    fused = mapper.fuse([maps[0], posed(maps[1], away)])
    np.testing.assert_allclose(fused.T_lm_navsb[0].matrix, POSE.matrix, atol=1e-12)
    np.testing.assert_allclose(fused.T_lm_navsb[1].matrix, (POSE @ away).matrix, atol=1e-9)
    assert "pose_turned_deg_1" not in fused.statistics


def test_a_pose_beyond_the_bounds_is_left_and_named(two: Any) -> None:
    mapper, maps = two
    wrong = Transform(matrix_from_rotvec(np.deg2rad([0.0, 0.0, 2.6])), np.zeros(3))
    fused = mapper.fuse([maps[0], posed(maps[1], wrong)])
    np.testing.assert_allclose(fused.T_lm_navsb[1].matrix, (POSE @ wrong).matrix, atol=1e-9)
    assert any("left as given" in line for line in fused.warnings)
    assert any("their poses" in line for line in fused.warnings)

"""Fusing pairs: agreement, conflict, poses that are wrong."""

from typing import Any

import numpy as np
import pytest

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.mapper import Mapper, PairMap

POSE = Transform(matrix_from_rotvec([0.0, 0.4, 0.3]), np.array([0.0, 0.0, 2.0]))


@pytest.fixture(scope="module")
def two(world: Any, hills_field: Any) -> tuple[Mapper, list[PairMap], np.ndarray]:
    """Two pairs of the same ground from the same place with other noise."""
    first, second = (world(hills_field, width=384, height=320, noise=5.0, noise_seed=n) for n in (1, 2))
    mapper = Mapper(first.rig, MappingConfig())
    return mapper, [mapper.process(first.pair, POSE, 0), mapper.process(second.pair, POSE, 1)], first.disparity


def depth_errors(mapper_maps: Any, cloud: Any) -> np.ndarray:
    mapper, _, disparity = mapper_maps
    rig = mapper._rig
    depth = (POSE @ rig.T_sb_left).inverse().apply(cloud.xyz)[:, 2]
    return depth - (rig.fx * rig.baseline_m / disparity)[cloud.v, cloud.u]


def test_fused_points_are_nearer_to_the_truth_than_either_pair(two: Any) -> None:
    mapper, maps, _ = two
    fused = mapper.fuse(maps)
    assert len(fused.cloud) < 1.05 * max(len(item.cloud) for item in maps)
    assert fused.statistics["merged"] > 1.8 * len(maps[0].cloud) * 0.9
    singles = [np.abs(depth_errors(two, item.cloud)).mean() for item in maps]
    assert np.abs(depth_errors(two, fused.cloud)).mean() < min(singles)
    assert not fused.warnings


def test_no_sample_of_the_ground_is_lost_where_pairs_overlap(two: Any) -> None:
    """Seen from slightly aside, both pairs' points stay, on one surface."""
    mapper, maps, _ = two
    aside = Transform(POSE.rotation, POSE.translation + POSE.rotation @ np.array([0.0, 0.004, 0.0]))
    moved = mapper_map_at(maps[1], aside, mapper)
    fused = mapper.fuse([maps[0], moved])
    assert len(fused.cloud) > 0.999 * (len(maps[0].cloud) + len(moved.cloud))
    assert fused.statistics["merged"] > 0.9 * len(fused.cloud)


def test_fused_points_keep_to_their_pixels_rays(two: Any) -> None:
    mapper, maps, _ = two
    cloud, rig = mapper.fuse(maps).cloud, mapper._rig
    local = (POSE @ rig.T_sb_left).inverse().apply(cloud.xyz)
    np.testing.assert_allclose(rig.fx * local[:, 0] / local[:, 2] + rig.cx, cloud.u, atol=5e-3)
    np.testing.assert_allclose(rig.fy * local[:, 1] / local[:, 2] + rig.cy, cloud.v, atol=5e-3)


def test_one_pair_stays_as_it_is(two: Any) -> None:
    mapper, maps, _ = two
    fused = mapper.fuse(maps[:1])
    np.testing.assert_allclose(fused.cloud.xyz, maps[0].cloud.xyz, atol=1e-6)
    np.testing.assert_array_equal(fused.cloud.sigma, maps[0].cloud.sigma)


def test_pairs_that_do_not_overlap_are_kept_whole(two: Any) -> None:
    mapper, maps, _ = two
    away = Transform(POSE.rotation, POSE.translation + np.array([0.0, 500.0, 0.0]))
    moved = mapper_map_at(maps[1], away, mapper)
    fused = mapper.fuse([maps[0], moved])
    assert len(fused.cloud) == len(maps[0].cloud) + len(moved.cloud)
    assert fused.statistics["overlap_0_1"] == 0.0


def mapper_map_at(item: PairMap, pose: Transform, mapper: Mapper) -> PairMap:
    """Return a pair's map as if it had been made with another pose."""
    cloud = item.cloud
    xyz = (pose @ item.T_lm_navsb.inverse()).apply(cloud.xyz).astype(np.float32)
    turned = type(cloud)(xyz, cloud.sigma, cloud.intensity, cloud.u, cloud.v, cloud.pair)
    return PairMap(item.stamp_ns, pose, item.disparity_px, turned, item.statistics)


@pytest.mark.parametrize("degrees", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_pose_one_degree_off_is_named(two: Any, axis: int, degrees: float) -> None:
    mapper, maps, _ = two
    turn = np.zeros(3)
    turn[axis] = np.deg2rad(degrees)
    wrong = Transform(POSE.rotation @ matrix_from_rotvec(turn), POSE.translation)
    fused = mapper.fuse([maps[0], mapper_map_at(maps[1], wrong, mapper)])
    assert any("their poses" in line for line in fused.warnings)


def test_a_surface_that_another_pair_sees_through_goes_if_it_is_less_sure(two: Any) -> None:
    mapper, maps, _ = two
    rig = mapper._rig
    ghost = np.full(maps[1].disparity_px.shape, np.nan, np.float32)
    ghost[100:140, 150:190] = maps[1].disparity_px[100:140, 150:190] + 6.0
    T_left_lm = (POSE @ rig.T_sb_left).inverse()
    cloud = maps[1].cloud.select(np.isfinite(ghost[maps[1].cloud.v, maps[1].cloud.u]))
    local = T_left_lm.apply(cloud.xyz)
    local *= (rig.fx * rig.baseline_m / ghost[cloud.v, cloud.u] / local[:, 2])[:, None]
    xyz = T_left_lm.inverse().apply(local).astype(np.float32)
    poor = type(cloud)(xyz, cloud.sigma * 3, cloud.intensity, cloud.u, cloud.v, cloud.pair)
    fused = mapper.fuse([maps[0], PairMap(1, POSE, ghost, poor, maps[1].statistics)])
    assert fused.statistics["dropped_conflict"] > 0.8 * len(poor)
    assert len(fused.cloud) < len(maps[0].cloud) + 0.2 * len(poor)


def test_none_and_more_than_three_pairs_are_refused(two: Any) -> None:
    mapper, maps, _ = two
    for number in (0, 4):
        with pytest.raises(MappingError, match="1 to 3 pairs"):
            mapper.fuse([maps[0]] * number)

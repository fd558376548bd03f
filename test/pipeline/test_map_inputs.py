"""What map scores are made of, whatever the order in which it comes."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.pipeline.call_stats import CallRecord
from sfr_loc_map.pipeline.monitor_score import MAX_KEPT, MapInputs, PairSet, PairSets

RIG = StereoRig(4, 3, 10.0, 10.0, 1.5, 1.0, 0.1)
CLOUD = PointCloud.from_structured(np.zeros(2, PointCloud.dtype()))
POINTS = np.zeros((3, 4, 3), np.float32)


def mapped(stamp_ns: int) -> CallRecord:
    return CallRecord(stamp_ns, 0.1, "mapped", None, None)


def fused(stamp_ns: int, pairs: int) -> CallRecord:
    return CallRecord(stamp_ns, 0.1, "fused", None, None, {"pairs": float(pairs), "fused": float(pairs > 1)})


def pose(x: float) -> Transform:
    return Transform(np.eye(3), np.array([x, 0.0, 0.0]))


def calls(inputs: MapInputs) -> None:
    for record in (mapped(1), mapped(2), fused(2, 2)):
        inputs.add_call(record)


def set_rig(inputs: MapInputs) -> None:
    inputs.rig = RIG


PARTS: tuple[Callable[[MapInputs], object], ...] = (
    calls,
    set_rig,
    lambda inputs: [inputs.add_true_points(stamp, POINTS) for stamp in (1, 2)],
    lambda inputs: [inputs.add_pose(stamp, pose(stamp)) for stamp in (1, 2)],
    lambda inputs: inputs.add_cloud(2, CLOUD),
)


@pytest.mark.parametrize("order", list(itertools.permutations(range(5)))[::7])
def test_a_cloud_is_complete_with_the_last_part_in_any_order(order: tuple[int, ...]) -> None:
    inputs = MapInputs()
    for part in order[:-1]:
        PARTS[part](inputs)
        assert list(inputs.take_complete()) == []
    PARTS[order[-1]](inputs)
    ((cloud, truths),) = inputs.take_complete()
    assert cloud.xyz is CLOUD.xyz
    assert cloud.fused is True
    assert len(truths) == 2
    assert list(inputs.take_complete()) == []


def test_pairs_mapped_after_a_fusion_belong_to_the_next_cloud() -> None:
    inputs = MapInputs()
    set_rig(inputs)
    calls(inputs)
    inputs.add_call(mapped(3))
    inputs.add_call(fused(3, 1))
    inputs.add_true_points(3, POINTS)
    inputs.add_pose(3, pose(3))
    inputs.add_cloud(3, CLOUD)
    ((cloud, truths),) = inputs.take_complete()
    assert len(truths) == 1
    assert cloud.fused is False


def test_pairs_of_a_map_that_was_given_up_are_not_taken_for_the_next_ones() -> None:
    """The mapper was reset after pair 1: its next cloud is of pairs 2 and 3."""
    sets = PairSets()
    assert [sets.add(record) for record in (mapped(1), mapped(2), mapped(3))] == [None] * 3
    assert sets.add(fused(3, 2)) == PairSet((2, 3), True)
    assert sets.add(mapped(4)) is None
    assert sets.add(fused(5, 2)) is None  # the call of one pair is missing: better no score than one of other pairs
    for record in (mapped(6), mapped(7)):
        sets.add(record)
    foreign = CallRecord(7, 0.1, "fused", None, None)
    assert sets.add(foreign) == PairSet((6, 7), True)


def test_what_is_kept_is_bounded() -> None:
    inputs = MapInputs()
    set_rig(inputs)
    calls(inputs)
    for stamp in range(1, MAX_KEPT + 2):  # one too many: the first falls out
        inputs.add_pose(stamp, pose(stamp))
    for stamp in (1, 2):
        inputs.add_true_points(stamp, POINTS)
    inputs.add_cloud(2, CLOUD)
    assert list(inputs.take_complete()) == []

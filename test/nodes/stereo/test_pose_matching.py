"""Pairs that wait for the poses of their stamps."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.stereo.pose_matching import MAX_POSES, MAX_WAITING, PoseMatching


class Matching(PoseMatching[int]):
    """Pairs are their stamps, poses have their stamp as x."""

    def __init__(self, tolerance_ns: int = 0) -> None:
        self.drops: list[int] = []
        super().__init__(tolerance_ns, 1.0, self.drops.append)

    def pose(self, stamp: int) -> list[tuple[int, float]]:
        found = self.add_pose(stamp, Transform(np.eye(3), np.array([stamp, 0.0, 0.0])))
        return [(pair, pose.translation[0]) for pair, pose in found]

    def pair(self, stamp: int) -> list[tuple[int, float]]:
        return [(pair, pose.translation[0]) for pair, pose in self.add_pair(stamp, stamp)]


@given(st.permutations([("pose", 1), ("pose", 2), ("pose", 3), ("pair", 1), ("pair", 2), ("pair", 3)]))
def test_every_pair_meets_its_pose_in_whatever_order_they_come(order: list[tuple[str, int]]) -> None:
    matching = Matching()
    found = [match for kind, stamp in order for match in getattr(matching, kind)(stamp)]
    assert sorted(found) == [(1, 1.0), (2, 2.0), (3, 3.0)]


def test_the_pose_of_a_neighbouring_stamp_is_not_used() -> None:
    matching = Matching(tolerance_ns=10)
    for stamp in (82, 91):
        matching.pose(stamp)
    assert matching.pair(100) == []
    assert matching.pose(100) == [(100, 100.0)]


def test_a_pose_belongs_to_one_pair() -> None:
    matching = Matching(tolerance_ns=10)
    matching.pose(100)
    assert matching.pair(104) == [(104, 100.0)]
    assert matching.pair(105) == []


def test_what_waits_is_bounded() -> None:
    matching = Matching()
    for stamp in range(MAX_WAITING + 2):
        matching.pair(stamp)
    assert matching.drops == [0, 1]
    matching.clear()
    for stamp in range(MAX_POSES + 1):
        matching.pose(stamp)
    assert (matching.pair(0), matching.pair(1)) == ([], [(1, 1.0)])


def test_a_repeated_pose_is_kept_as_the_newest() -> None:
    matching = Matching()
    for stamp in (*range(MAX_POSES), 0, MAX_POSES):
        matching.pose(stamp)
    assert (matching.pair(0), matching.pair(1)) == ([(0, 0.0)], [])

"""A path stays bounded, and keeps its ends and its shape."""

import numpy as np
import pytest

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.pipeline.reception import ThinnedPath


def along(x: float, turn: float = 0.0) -> Transform:
    return Transform(matrix_from_rotvec([0.0, 0.0, turn]) if turn else np.eye(3), np.array([x, 0.0, 0.0]))


def test_a_long_drive_stays_bounded_and_even() -> None:
    path: ThinnedPath[float] = ThinnedPath(100)
    for index in range(1500):
        path.add(index, along(0.05 * index), 0.05 * index)
        assert len(path.poses) <= 100
    assert path.poses[0] == 0.0
    assert path.poses[-1] == pytest.approx(0.05 * 1499)
    gaps = np.diff(path.poses[:-1])
    assert len(path.poses) >= 40
    assert gaps.max() <= 2.5 * gaps.min()


def test_a_rover_that_stands_leaves_one_pose_and_one_that_turns_leaves_more() -> None:
    path: ThinnedPath[int] = ThinnedPath()
    for index in range(500):
        path.add(index, along(1.0), index)
    assert path.poses == [0, 499]
    for index in range(500, 600):
        path.add(index, along(1.0, np.radians(index - 500.0)), index)
    assert 30 <= len(path.poses) <= 52


def test_stamps_that_go_back_start_a_new_path() -> None:
    path: ThinnedPath[int] = ThinnedPath()
    for index in (5, 6, 7, 3, 4):
        path.add(index, along(float(index)), index)
    assert path.poses == [3, 4]
    path.clear()
    assert path.poses == []

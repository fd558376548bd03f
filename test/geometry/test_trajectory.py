"""Stamped poses: accepted and rejected values."""

from math import cos, radians, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.strategies import transforms
from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.rotation import matrix_from_quat
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform


@given(st.lists(st.tuples(st.integers(-(2**63), 2**63 - 1), transforms), max_size=5))
def test_poses_come_back(stamped: list[tuple[int, Transform]]) -> None:
    trajectory = Trajectory.from_poses(stamped)
    assert trajectory.stamps_ns.tolist() == [stamp for stamp, _ in stamped]
    for index, (_, pose) in enumerate(stamped):
        np.testing.assert_allclose(trajectory.pose(index).matrix, pose.matrix, atol=1e-13)


@pytest.mark.clause("3.1.1", "3.1.2")
def test_golden_attitude_is_the_conjugate() -> None:
    # Heading 90 deg to the left: ROS orientation (0, 0, sin 45, cos 45), att_q_DsToRb (0, 0, -sin 45, cos 45).
    s, c = sin(radians(45)), cos(radians(45))
    trajectory = Trajectory(np.array([5]), np.zeros((1, 3)), np.array([[0, 0, s, c]]))
    assert trajectory.att_q_ds_to_rb.tolist() == [[0, 0, -s, c]]
    # It turns the components (0, 1, 0) in DS of the rover's forward direction into (1, 0, 0) in RB.
    np.testing.assert_allclose(matrix_from_quat(trajectory.att_q_ds_to_rb[0]) @ [0, 1, 0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(trajectory.pose(0).rotation @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize(("part", "index", "value"), [(1, (1, 2), np.nan), (2, (1, 0), -np.inf), (2, 1, 0.0)])
def test_first_bad_pose_is_named(part: int, index: tuple[int, int] | int, value: float) -> None:
    arrays = np.array([0, 10, 20]), np.ones((3, 3)), np.tile([0.0, 0.6, 0.0, 0.8], (3, 1))
    arrays[part][index] = value
    with pytest.raises(GeometryError, match=r"pose 1 \(stamp 10\).*1 of 3"):
        Trajectory(*arrays)


def test_a_pose_without_attitude_is_named() -> None:
    poses = Trajectory(np.array([3, 7], np.int64), np.zeros((2, 3)), np.zeros((2, 4)))
    with pytest.raises(GeometryError, match="the pose at stamp 7 has no attitude"):
        poses.pose(1)

# ruff: noqa: E402 - ROS may be absent
import math
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, Quaternion
from made_scene import LOC_RIG, loc_pair, true_pose
from nav_msgs.msg import Odometry
from scenes import sent

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StepEstimate, TrackingState
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.pose import (
    covariance_of,
    odometry_msg,
    odometry_row,
    pose_msg,
    start_pose_of,
    transform_from_pose,
)

STAMP_NS = 1_700_000_000_123_456_789


def test_odometry_holds_the_estimate_to_the_last_bit_and_the_orientation_of_ros() -> None:
    half = math.sqrt(0.5)
    T_ds_rb = Transform.from_quat([1 / 3, -2e-17, 1e9 / 7], [0.0, 0.0, half, half])
    covariance = np.arange(36.0).reshape(6, 6) / 7
    message = sent(odometry_msg(PoseEstimate(STAMP_NS, T_ds_rb, covariance, TrackingState.TRACKING), "world", "rover"))
    assert (message.header.frame_id, message.child_frame_id) == ("world", "rover")
    stamp, position, quat = odometry_row(message)
    assert stamp == STAMP_NS
    assert position == tuple(T_ds_rb.translation)
    assert quat == tuple(T_ds_rb.quat_xyzw)
    # A turn to the left by 90 degrees: RB's x axis points along y of DS, so z and w agree in sign.
    assert quat[2] == pytest.approx(half)
    assert Transform.from_quat(position, quat).rotation @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert np.array_equal(covariance_of(message), covariance)
    assert np.array(message.twist.covariance)[0] == 9999.0  # no step is known


def test_velocity_is_that_since_the_pose_before() -> None:
    motion, covariance = np.array([0.1, -0.02, 0.03, 0.01, 0.0, -0.2]), np.diag(np.arange(1.0, 7.0))
    for step, velocity, variance in (
        (StepEstimate(0.5, motion, covariance, np.zeros(6)), 2.0 * motion, 4.0),
        (StepEstimate(0.5, np.zeros(6), covariance, np.zeros(6)), np.zeros(6), 4.0),
        (StepEstimate(0.0, np.zeros(6), covariance, np.zeros(6)), np.zeros(6), 1.0),
    ):
        estimate = PoseEstimate(STAMP_NS, Transform.identity(), covariance, TrackingState.TRACKING, step=step)
        twist = sent(odometry_msg(estimate, "ds", "rb")).twist
        linear, angular = twist.twist.linear, twist.twist.angular
        found = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
        np.testing.assert_array_equal(found, velocity)
        assert np.array(twist.covariance)[0] == variance


def integrated(found: Transform, before: Odometry | None, message: Odometry) -> Transform:
    """Return a pose moved on by the velocity of a message, as a consumer does that has the messages alone."""
    if before is None:
        return found
    seconds = (odometry_row(message)[0] - odometry_row(before)[0]) / 1e9
    twist = message.twist.twist
    turned = [seconds * rate for rate in (twist.angular.x, twist.angular.y, twist.angular.z)]
    moved = seconds * np.array([twist.linear.x, twist.linear.y, twist.linear.z])
    return found @ Transform(matrix_from_rotvec(turned), moved)


def farthest(pairs: Iterable[StereoPair], localiser: Localiser, start: Transform) -> tuple[float, float]:
    """Return how far the integrated poses are from the published ones at most, metres and entries of the rotation."""
    found, before, away, turned = start, None, 0.0, 0.0
    for pair in pairs:
        message = sent(odometry_msg(localiser.process(pair), "ds", "rb"))
        published = transform_from_pose(message.pose.pose, "odometry")
        found = published if before is None else integrated(found, before, message)
        away = max(away, float(np.abs(found.translation - published.translation).max()))
        turned = max(turned, float(np.abs(found.rotation - published.rotation).max()))
        before = message
    return away, turned


def test_the_velocity_integrates_to_the_path() -> None:
    pairs = [loc_pair(index) for index in (0, 1, 2, 3, 5, 6)]  # unequal intervals
    away, turned = farthest(pairs, Localiser(LOC_RIG, LocalisationConfig(), true_pose(0)), true_pose(0))
    assert (away < 1e-9, turned < 1e-9) == (True, True)


def test_every_field_is_of_its_own_type_whatever_numpy_gives() -> None:
    pose = Transform(np.eye(3), np.array([1, 2, 3]))
    message = pose_msg(pose, np.array([0, 0, 0, 1], np.float32))
    assert type(message.position.x) is float
    assert sent(message) == Pose(position=Point(x=1.0, y=2.0, z=3.0), orientation=Quaternion(w=1.0))


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (Pose(position=Point(x=math.nan)), "not finite"),
        (Pose(position=Point(y=-1e25)), "up to 1e"),
        (Pose(orientation=Quaternion(x=math.inf, w=1.0)), "is not a rotation"),
        (Pose(orientation=Quaternion(w=0.0)), "is not a rotation"),
        (Pose(orientation=Quaternion(w=2.0)), "is not a rotation"),
    ],
)
def test_poses_that_are_none_are_refused(pose: Pose, words: str) -> None:
    with pytest.raises(InputError, match=f"initialpose: .*{words}"):
        transform_from_pose(pose, "initialpose")


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.dot(q, q) > 0.01))
def test_poses_come_out_as_they_went_in(quat: list[float]) -> None:
    unit = np.array(quat) / np.linalg.norm(quat)
    pose = Transform.from_quat([0.1, 0.2, 0.3], unit)
    out = transform_from_pose(sent(pose_msg(pose, pose.file_quat_xyzw)), "pose")
    assert np.array_equal(out.rotation, pose.rotation)
    assert np.array_equal(out.translation, pose.translation)


def initial_pose(stamp_ns: int, covariance: np.ndarray) -> PoseWithCovarianceStamped:
    message = PoseWithCovarianceStamped(header=header_msg(stamp_ns, ""))
    message.pose.pose = pose_msg(Transform.identity(), Transform.identity().quat_xyzw)
    message.pose.covariance = covariance.reshape(36)
    return sent(message)


def test_a_start_pose_has_the_stamp_and_the_covariance_of_its_message() -> None:
    covariance = np.diag(np.arange(6.0))
    found = start_pose_of(initial_pose(STAMP_NS, covariance))
    assert found.stamp_ns == STAMP_NS
    np.testing.assert_array_equal(found.covariance, covariance)
    assert start_pose_of(initial_pose(0, covariance)).stamp_ns is None


@pytest.mark.parametrize("broken", [-np.eye(6), np.full((6, 6), np.nan), np.triu(np.ones((6, 6)))])
def test_a_start_pose_without_a_true_covariance_is_refused(broken: np.ndarray) -> None:
    with pytest.raises(InputError, match="zeros say exact"):
        start_pose_of(initial_pose(STAMP_NS, broken))

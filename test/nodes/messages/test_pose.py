import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, Quaternion
from hypothesis import given
from hypothesis import strategies as st
from made_scene import LOC_RIG, loc_pair, true_pose
from nav_msgs.msg import Odometry
from scenes import sent

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import stamp_of
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
    assert (stamp, position, quat) == (STAMP_NS, tuple(T_ds_rb.translation), tuple(T_ds_rb.quat_xyzw))
    # A turn to the left by 90 degrees: RB's x axis points along y of DS, so z and w agree in sign.
    assert quat[2] == pytest.approx(half)
    assert Transform.from_quat(position, quat).rotation @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert np.array_equal(covariance_of(message), covariance)
    assert np.array(message.twist.covariance)[0] == 9999.0  # no step is known


def test_velocity_is_that_since_the_pose_before() -> None:
    motion, covariance = np.array([0.1, -0.02, 0.03, 0.01, 0.0, -0.2]), np.diag(np.arange(1.0, 7.0))
    for seconds, moved, velocity, variance in ((0.5, motion, 2.0 * motion, 4.0), (0.0, 0 * motion, 0 * motion, 1.0)):
        step = StepEstimate(seconds, moved, covariance, np.zeros(6))
        estimate = PoseEstimate(STAMP_NS, Transform.identity(), covariance, TrackingState.TRACKING, step=step)
        twist = sent(odometry_msg(estimate, "ds", "rb")).twist
        linear, angular = twist.twist.linear, twist.twist.angular
        found = (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
        np.testing.assert_array_equal(found, velocity)
        assert np.array(twist.covariance)[0] == variance


def integrated(found: Transform, before: Odometry, message: Odometry) -> Transform:
    """Return a pose moved on by the velocity of a message, as a consumer does that has the messages alone."""
    seconds = (stamp_of(message) - stamp_of(before)) / 1e9
    linear, angular = message.twist.twist.linear, message.twist.twist.angular
    turned = seconds * np.array([angular.x, angular.y, angular.z])
    return found @ Transform(matrix_from_rotvec(turned), seconds * np.array([linear.x, linear.y, linear.z]))


def test_the_velocity_integrates_to_the_path() -> None:
    localiser = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
    estimates = [localiser.process(loc_pair(index)) for index in (0, 1, 2, 3, 5, 6)]  # unequal intervals
    messages = [sent(odometry_msg(estimate, "ds", "rb")) for estimate in estimates]
    found = estimates[0].T_ds_rb
    for before, message, estimate in zip(messages, messages[1:], estimates[1:], strict=False):
        found = integrated(found, before, message)
        np.testing.assert_allclose(found.matrix, estimate.T_ds_rb.matrix, atol=1e-9)


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


@given(
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.dot(q, q) > 0.01),
    st.integers(0, 2**31 * 10**9 - 1),
)
def test_poses_and_stamps_come_out_as_they_went_in(quat: list[float], stamp_ns: int) -> None:
    pose = Transform.from_quat([0.1, 0.2, 0.3], np.array(quat) / np.linalg.norm(quat))
    message = Odometry(header=header_msg(stamp_ns, "ds"))
    message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
    out = transform_from_pose(sent(message).pose.pose, "pose")
    assert np.array_equal(out.matrix, pose.matrix)
    assert stamp_of(sent(message)) == stamp_ns


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
    for broken in (-np.eye(6), np.full((6, 6), np.nan), np.triu(np.ones((6, 6)))):
        with pytest.raises(InputError, match="zeros say exact"):
            start_pose_of(initial_pose(STAMP_NS, broken))

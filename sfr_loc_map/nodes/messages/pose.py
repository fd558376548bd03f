"""Poses, odometry and transforms as messages.

The ROS orientation of RB in DS takes components in RB to DS, so it is `Transform.quat_xyzw`, the conjugate of the
source document's `att_q_DsToRb`. Nothing else knows of that.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from nav_msgs.msg import Odometry

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import MAX_VARIANCE, is_plausible_covariance
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import LOST_VARIANCE
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose, StepEstimate
from sfr_loc_map.nodes.messages.fields import header_msg

FIRST_VELOCITY_VARIANCE = 1.0  #: Of the velocity at the first pose, (m/s)^2 and (rad/s)^2: it has no pose before.


def pose_msg(pose: Transform, quat_xyzw: FloatArray) -> Pose:
    """Return a pose of the child frame in the parent frame; the quaternion is sent as given."""
    x, y, z = (float(v) for v in pose.translation)
    qx, qy, qz, qw = (float(v) for v in quat_xyzw)
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def transform_from_pose(pose: Pose, name: str) -> Transform:
    """Return `T_parent_child` of a pose message; `name` says what it is where it is none.

    Raises InputError if a number is not finite, the position is absurd or the quaternion is not of unit length (an
    empty message has none).
    """
    p, q = pose.position, pose.orientation
    try:
        return Transform.from_quat((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    except GeometryError as error:
        raise InputError(f"{name}: {error}") from error


def start_pose_of(message: PoseWithCovarianceStamped) -> StartPose:
    """Return a pose from outside, which holds at its stamp; a stamp of zero is none.

    Raises InputError if it is no pose, or its covariance none: not finite, absurd, not symmetric, a variance negative.
    """
    pose = transform_from_pose(message.pose.pose, "initialpose")
    covariance = np.array(message.pose.covariance, np.float64).reshape(6, 6)
    if not is_plausible_covariance(covariance):
        raise InputError(
            f"initialpose has a covariance that is none: it is symmetric, with variances from 0 to {MAX_VARIANCE:g}; "
            f"zeros say exact"
        )
    return StartPose(pose, covariance, stamp_of(message) or None)


def odometry_msg(estimate: PoseEstimate, parent: str, child: str) -> Odometry:
    """Return an estimate as odometry; the velocity is the mean one since the pose before, in RB there."""
    message = Odometry(header=header_msg(estimate.stamp_ns, parent), child_frame_id=child)
    message.pose.pose = pose_msg(estimate.T_ds_rb, estimate.T_ds_rb.quat_xyzw)
    message.pose.covariance = np.array(estimate.covariance, dtype=np.float64).reshape(36)
    message.twist = _twist_msg(estimate.step)
    return message


def _twist_msg(step: StepEstimate | None) -> TwistWithCovariance:
    """Return the mean velocity of a step, with 9999 on the diagonal of its covariance where there is none."""
    if step is None:
        return TwistWithCovariance(covariance=(np.eye(6) * LOST_VARIANCE).reshape(36))
    velocity, covariance = np.zeros(6), np.eye(6) * FIRST_VELOCITY_VARIANCE
    if step.seconds > 0.0:
        velocity, covariance = step.motion / step.seconds, step.covariance / step.seconds**2
    x, y, z, roll, pitch, yaw = velocity.tolist()
    twist = Twist(linear=Vector3(x=x, y=y, z=z), angular=Vector3(x=roll, y=pitch, z=yaw))
    return TwistWithCovariance(twist=twist, covariance=covariance.reshape(36))


def odometry_row(message: Odometry) -> tuple[int, tuple[float, float, float], tuple[float, float, float, float]]:
    """Return stamp (ns), position (m) and quaternion (x, y, z, w) of odometry, numbers as sent.

    Raises InputError if they are not a pose.
    """
    stamp = stamp_of(message)
    transform_from_pose(message.pose.pose, f"odometry of stamp {stamp}")
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return stamp, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


def covariance_of(message: Odometry) -> FloatArray:
    """Return the covariance `(6, 6)` of the pose of odometry, in ROS order."""
    return np.array(message.pose.covariance, np.float64).reshape(6, 6)


def transform_of_odometry(message: Odometry) -> TransformStamped:
    """Return the pose of odometry as a transform of its frames."""
    transform = TransformStamped(header=message.header, child_frame_id=message.child_frame_id)
    position = message.pose.pose.position
    transform.transform.translation = Vector3(x=position.x, y=position.y, z=position.z)
    transform.transform.rotation = message.pose.pose.orientation
    return transform


def tf_message_type() -> type[Any] | None:
    """Return tf2_msgs/TFMessage, None where it is not installed (it is not part of the ROS wheels)."""
    try:
        return importlib.import_module("tf2_msgs.msg").TFMessage
    except ImportError:
        return None

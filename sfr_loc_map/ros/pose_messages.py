"""Convert poses and odometry to messages and back.

The ROS orientation of RB in DS rotates components from RB to DS. This orientation is therefore `Transform.quat_xyzw`,
the conjugate of the source document's `att_q_DsToRb`.
"""

from __future__ import annotations

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
from std_msgs.msg import Header

from sfr_loc_map.errors import GeometryError, InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE, MAX_VARIANCE, is_plausible_covariance
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose, StepEstimate
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.ros.messages import header_msg

FIRST_VELOCITY_VARIANCE = 1.0
"""Variance of the unknown velocity at the first pose, (m/s)^2 and (rad/s)^2. Its square root exceeds the velocities of
a rover."""


def pose_msg(pose: Transform, quat_xyzw: FloatArray) -> Pose:
    """Return the pose of the child frame in the parent frame; the quaternion is sent as given."""
    x, y, z = (float(v) for v in pose.translation)
    qx, qy, qz, qw = (float(v) for v in quat_xyzw)
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def transform_from_pose(pose: Pose, name: str) -> Transform:
    """Return `T_parent_child` of a pose message; `name` describes the pose in the error message."""
    p, q = pose.position, pose.orientation
    try:
        return Transform.from_quat((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    except GeometryError as error:
        raise InputError(f"{name}: {error}") from error


def start_pose_of(message: PoseWithCovarianceStamped) -> StartPose:
    """Return an external pose, which applies at its stamp; a stamp of 0 means that the time is unknown."""
    pose = transform_from_pose(message.pose.pose, "initialpose")
    covariance = np.array(message.pose.covariance, np.float64).reshape(6, 6)
    if not is_plausible_covariance(covariance):
        raise InputError(
            "initialpose: invalid covariance: a symmetric and positive semi-definite matrix is required, with "
            f"variances from 0 to {MAX_VARIANCE:g}; zeros mean an exact pose"
        )
    return StartPose(pose, covariance, stamp_of(message) or None)


def odometry_msg(estimate: PoseEstimate, parent: str, child: str) -> Odometry:
    """Return an estimate as odometry; the velocity is the mean since the previous pose, in RB of the previous pose."""
    message = Odometry(header=header_msg(estimate.stamp_ns, parent), child_frame_id=child)
    message.pose.pose = pose_msg(estimate.T_ds_rb, estimate.T_ds_rb.quat_xyzw)
    message.pose.covariance = np.array(estimate.covariance, dtype=np.float64).reshape(36)
    message.twist = _twist_msg(estimate.step)
    return message


def _twist_msg(step: StepEstimate | None) -> TwistWithCovariance:
    """Return the mean velocity of a step; without a step, zero with a covariance of 9999 on the diagonal."""
    if step is None:
        return TwistWithCovariance(covariance=(np.eye(6) * LOST_VARIANCE).reshape(36))
    velocity, covariance = np.zeros(6), np.eye(6) * FIRST_VELOCITY_VARIANCE
    if step.seconds > 0.0:
        velocity, covariance = step.motion / step.seconds, step.motion_covariance / step.seconds**2
    x, y, z, roll, pitch, yaw = velocity.tolist()
    twist = Twist(linear=Vector3(x=x, y=y, z=z), angular=Vector3(x=roll, y=pitch, z=yaw))
    return TwistWithCovariance(twist=twist, covariance=covariance.reshape(36))


OdometryRow = tuple[int, tuple[float, float, float], tuple[float, float, float, float]]
"""Stamp (ns), position (m) and quaternion (x, y, z, w) of odometry, as sent."""


def odometry_row(message: Odometry) -> OdometryRow:
    """Return stamp and pose of odometry; raise an InputError if the pose is invalid."""
    stamp = stamp_of(message)
    p, q = message.pose.pose.position, message.pose.pose.orientation
    place, quat = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
    with refusing(f"odometry of stamp {stamp}", "correct the publisher"):
        Transform.from_quat(place, quat)
    return stamp, place, quat


def covariance_of(message: Odometry) -> FloatArray:
    """Return the covariance `(6, 6)` of the pose of odometry, in ROS order."""
    return np.array(message.pose.covariance, np.float64).reshape(6, 6)


def transform_msg(header: Header, child: str, pose: Pose) -> TransformStamped:
    """Return the pose of a frame as a transform."""
    transform = TransformStamped(header=header, child_frame_id=child)
    transform.transform.translation = Vector3(x=pose.position.x, y=pose.position.y, z=pose.position.z)
    transform.transform.rotation = pose.orientation
    return transform

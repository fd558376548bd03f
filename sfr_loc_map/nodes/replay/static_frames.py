"""The extrinsics of a source on /tf_static during its replay, so that a recording of it is complete."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from sfr_loc_map.geometry.transform import Transform as RigidTransform
from sfr_loc_map.io.bag import LOCSB_FRAME, RB_FRAME
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.pose import tf_message_type


def publish_extrinsics(node: Node, T_rb_sb: RigidTransform) -> Any:  # noqa: ANN401 - rclpy has no types
    """Publish `rb` to `locsb`, latched, where tf2_msgs is installed; return the publisher, None elsewhere."""
    kind = tf_message_type()
    if kind is None:
        return None
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(kind, "/tf_static", latched)
    publisher.publish(kind(transforms=[transform_msg(T_rb_sb)]))
    return publisher


def transform_msg(T_rb_sb: RigidTransform) -> TransformStamped:
    """Return the extrinsics as a message."""
    message = TransformStamped(header=header_msg(0, RB_FRAME), child_frame_id=LOCSB_FRAME)
    x, y, z = (float(v) for v in T_rb_sb.translation)
    qx, qy, qz, qw = (float(v) for v in T_rb_sb.file_quat_xyzw)
    message.transform = Transform(translation=Vector3(x=x, y=y, z=z), rotation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    return message

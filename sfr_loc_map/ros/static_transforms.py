"""Static transforms of /tf_static: read from messages, and published."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from rclpy.node import Node

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.extrinsics import LOCSB_FRAME, RB_FRAME
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.frames import add_transform
from sfr_loc_map.ros.messages import header_msg, tf_message_type
from sfr_loc_map.ros.pose_messages import pose_msg, transform_msg
from sfr_loc_map.ros.qos import TF_STATIC_QOS
from sfr_loc_map.topics import TF_STATIC


def add_static_transforms(message: Any, tree: FrameTree) -> None:  # noqa: ANN401 - tf2_msgs need not be there
    """Add the transforms of a tf2_msgs/TFMessage to a tree; transforms that are not rigid motions are ignored."""
    for item in message.transforms:
        with suppress(GeometryError):
            add_transform(tree, item)


def publish_extrinsics(node: Node, T_rb_sb: Transform) -> None:
    """Publish the transform from `rb` to `locsb`, latched, if tf2_msgs is installed."""
    kind = tf_message_type()
    if kind is not None:
        pose = pose_msg(T_rb_sb, T_rb_sb.file_quat_xyzw)
        transform = transform_msg(header_msg(0, RB_FRAME), LOCSB_FRAME, pose)
        node.create_publisher(kind, TF_STATIC, TF_STATIC_QOS).publish(kind(transforms=[transform]))

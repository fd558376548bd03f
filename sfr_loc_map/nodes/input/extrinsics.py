"""The extrinsics of the localisation cameras, from parameters or /tf_static, and their publisher."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from rclpy.node import Node

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.extrinsics import LOCSB_FRAME, RB_FRAME, rig_in_body
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.source_config import ExtrinsicsConfig
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.ros.messages import header_msg, pose_msg, tf_message_type, transform_msg
from sfr_loc_map.ros.qos import TF_STATIC_QOS
from sfr_loc_map.topics import TF_STATIC


def add_static_transforms(message: Any, tree: FrameTree) -> None:  # noqa: ANN401 - tf2_msgs need not be there
    """Add the transforms of a tf2_msgs/TFMessage to a tree; transforms that are not rigid motions are ignored."""
    for item in message.transforms:
        p, q = item.transform.translation, item.transform.rotation
        with suppress(GeometryError):
            pose = Transform.from_quat((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
            tree.add(item.header.frame_id, item.child_frame_id, pose)


class Extrinsics:
    """The extrinsics, from the parameters, otherwise from /tf_static once it connects the frames.

    All methods are called in one thread. The worker reads `T_rb_sb`, which changes once.
    """

    def __init__(self, config: ExtrinsicsConfig, base_frame: str, sb_frame: str) -> None:
        """Use the parameters and the frame names in /tf_static. An empty base frame means any of `BASE_FRAMES`."""
        self.T_rb_sb = config.transform("T_rb_locsb")
        self._base_frame, self._sb_frame, self._tree = base_frame, sb_frame, FrameTree()

    def subscribe(self, endpoints: Endpoints, say: Callable[[str], object]) -> None:
        """Subscribe to /tf_static if the parameters have no extrinsics; report this through `say`."""
        if self.T_rb_sb is not None:
            return
        kind = tf_message_type()
        if kind is not None:
            endpoints.add_subscription(kind, TF_STATIC, partial(add_static_transforms, tree=self._tree), TF_STATIC_QOS)
        source = "/tf_static is awaited" if kind else "tf2_msgs for /tf_static is not installed"
        say(f"the extrinsics of the stereo rig (parameters T_rb_locsb) are not given: {source}")

    def search(self, camera_frame: str, baseline_m: float, say: Callable[[str], object]) -> None:
        """Search the received transforms for the frame of the left camera; report found extrinsics through `say`."""
        if self.T_rb_sb is None:
            found = rig_in_body(self._tree, camera_frame, baseline_m, self._base_frame, self._sb_frame)
            if found is not None:
                self.T_rb_sb = found.T_rb_sb
                say(f"extrinsics of the stereo rig from /tf_static: {found.text}")


def publish_extrinsics(node: Node, T_rb_sb: Transform) -> None:
    """Publish the transform from `rb` to `locsb`, latched, if tf2_msgs is installed."""
    kind = tf_message_type()
    if kind is not None:
        pose = pose_msg(T_rb_sb, T_rb_sb.file_quat_xyzw)
        transform = transform_msg(header_msg(0, RB_FRAME), LOCSB_FRAME, pose)
        node.create_publisher(kind, TF_STATIC, TF_STATIC_QOS).publish(kind(transforms=[transform]))

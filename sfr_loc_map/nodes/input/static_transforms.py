"""Frames that do not move against each other, as `/tf_static` gives them, where tf2_msgs is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.messages.pose import tf_message_type


class StaticTransforms:
    """The tree of frames heard so far."""

    def __init__(self) -> None:
        """Start empty."""
        self._frames = FrameTree()

    def subscribe(self, node: ManagedNode, on_change: Callable[[], None]) -> None:
        """Listen to `/tf_static`, where tf2_msgs is installed."""
        kind = tf_message_type()
        if kind is None:
            return

        def received(message: Any) -> None:  # noqa: ANN401 - tf2_msgs need not be there
            self.add(message)
            on_change()

        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.listen_to(kind, "/tf_static", received, qos)

    def add(self, message: Any) -> None:  # noqa: ANN401 - a tf2_msgs/TFMessage
        """Take the transforms of a message; one that is no rigid motion is left out."""
        for item in message.transforms:
            move, turn = item.transform.translation, item.transform.rotation
            try:
                T_parent_child = Transform.from_quat((move.x, move.y, move.z), (turn.x, turn.y, turn.z, turn.w))
            except GeometryError:
                continue
            self._frames.add(item.header.frame_id, item.child_frame_id, T_parent_child)

    def find(self, ancestor: str, frame: str) -> Transform | None:
        """Return `T_ancestor_frame`, None where the frames are not joined (yet)."""
        return self._frames.find(ancestor, frame)

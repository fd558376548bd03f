"""Fixed transforms between frames from `/tf_static`, where tf2_msgs is installed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.messages.pose import tf_message_type


class StaticTransforms:
    """The tree of the frames received so far."""

    def __init__(self) -> None:
        """Start empty."""
        self._frames = FrameTree()

    def subscribe(self, endpoints: Endpoints, on_change: Callable[[], None]) -> None:
        """Subscribe to `/tf_static`, where tf2_msgs is installed."""
        kind = tf_message_type()
        if kind is None:
            return

        def received(message: Any) -> None:  # noqa: ANN401 - tf2_msgs need not be there
            self.add(message)
            on_change()

        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        endpoints.add_subscription(kind, "/tf_static", received, qos)

    def add(self, message: Any) -> None:  # noqa: ANN401 - a tf2_msgs/TFMessage
        """Take the transforms of a message; one that is no rigid motion is left out."""
        for item in message.transforms:
            p, q = item.transform.translation, item.transform.rotation
            try:
                T_parent_child = Transform.from_quat((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
            except GeometryError:
                continue
            self._frames.add(item.header.frame_id, item.child_frame_id, T_parent_child)

    def find(self, ancestor: str, frame: str) -> Transform | None:
        """Return `T_ancestor_frame`, None where the frames are not connected (yet)."""
        return self._frames.find(ancestor, frame)

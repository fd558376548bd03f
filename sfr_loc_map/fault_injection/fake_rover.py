"""The publishers of a rover: images, camera_info, poses and truth of a synthetic scene."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image

from sfr_loc_map.fault_injection.message_recorder import KEPT
from sfr_loc_map.fault_injection.scene import Scene
from sfr_loc_map.fault_injection.waiting import wait_until
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.pose import pose_msg

IMAGE_DEPTH, SMALL_DEPTH = 50, 1000
"""Images, and small messages, that a publisher keeps for a subscriber that is held up."""
MATCH_S = 0.5
"""The subscriber may discover a match a little later than the publisher."""


def serialised(message: Any) -> bytes:  # noqa: ANN401 - any message of the bag's library
    """Return a message serialised (CDR), ready to be published."""
    return bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__))


class FakeRover:
    """Publishes what the cameras and the truth of a rover would publish.

    Attributes:
        scene: Scene that the cameras see.
        sent: Index of each pair of the drive by its stamp.
    """

    def __init__(self, node: Node, scene: Scene, timeout_s: float) -> None:
        """Publish nothing yet.

        Args:
            node: Node of this process.
            scene: Scene that the cameras see.
            timeout_s: How long a subscriber is awaited, seconds.
        """
        self.scene = scene
        self.sent: dict[int, int] = {}
        self._node, self._timeout_s = node, timeout_s
        self._publishers: dict[str, Any] = {}
        self._index = 0
        self._last_stamp = 0

    def publisher(self, kind: type[Any], topic: str) -> Any:  # noqa: ANN401 - rclpy has no types
        """Return the publisher of a topic, with transient-local durability where the nodes request it."""
        if topic not in self._publishers:
            qos = QoSProfile(depth=IMAGE_DEPTH if kind is Image else SMALL_DEPTH)
            if topic.endswith("/configuration"):
                qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
            self._publishers[topic] = self._node.create_publisher(kind, topic, qos)
        return self._publishers[topic]

    def publish(self, kind: type[Any], topic: str, message: Any) -> None:  # noqa: ANN401 - a message or its bytes
        """Publish a message or its serialised form, once there is a subscriber."""
        is_new = topic not in self._publishers
        publisher = self.publisher(kind, topic)
        wait_until(lambda: publisher.get_subscription_count() > 0, f"subscriber of {topic}", self._timeout_s)
        if is_new:
            time.sleep(MATCH_S)
        publisher.publish(message)

    def next_stamp(self) -> int:
        """Return the present system time, later than any stamp before."""
        self._last_stamp = max(time.time_ns(), self._last_stamp + 1000)
        return self._last_stamp

    def rig(self, task: str) -> StereoRig:
        """Return the stereo rig of a task, `loc` or `nav`."""
        return self.scene.loc if task == "loc" else self.scene.nav

    def pair(self, task: str) -> StereoPair:
        """Return the first pair of a task with the present stamp, without publishing it."""
        stamp_ns = self.next_stamp()
        return self.scene.loc_pair(0, stamp_ns) if task == "loc" else self.scene.nav_pair(0, stamp_ns)

    def send_camera_info(self, task: str) -> None:
        """Publish camera_info of both cameras of a task, once there are subscribers."""
        stamp_ns = self.next_stamp()
        for side in SIDES:
            message = serialised(bag_messages.camera_info(stamp_ns, self.rig(task), task, side))
            self.publish(CameraInfo, f"{task}/{side}/camera_info", message)

    def send_loc(self, stamp_ns: int | None = None) -> int:
        """Publish the next pair of the drive with its truth; return its stamp."""
        stamp_ns = self.next_stamp() if stamp_ns is None else stamp_ns
        pair, pose = self.scene.loc_pair(self._index, stamp_ns), self.scene.true_pose(self._index)
        self.sent[stamp_ns] = self._index
        self._index += 1
        truth = bag_messages.odometry(stamp_ns, pose.translation, pose.quat_xyzw)
        self.publisher(Odometry, "ground_truth/odometry").publish(serialised(truth))
        self._send_images("loc", pair)
        return stamp_ns

    def send_nav(self, index: int) -> int:
        """Publish one of the three pairs of a map with its pose; return its stamp."""
        stamp_ns = self.next_stamp()
        pose = serialised(bag_messages.pose(stamp_ns, self.scene.nav_pose(index)))
        self.publisher(PoseStamped, "nav/pose").publish(pose)
        self._send_images("nav", self.scene.nav_pair(index, stamp_ns))
        return stamp_ns

    def start_at_truth(self) -> None:
        """Let the next estimate start at the true pose of the next pair."""
        pose = self.scene.true_pose(self._index)
        message = PoseWithCovarianceStamped(header=header_msg(0, "ds"))
        message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
        self.publish(PoseWithCovarianceStamped, "initialpose", message)
        self.publisher(PoseWithCovarianceStamped, "initialpose").wait_for_all_acked(Duration(seconds=5))

    @contextmanager
    def driving(self, rate_hz: float) -> Iterator[None]:
        """Publish pairs, each with camera_info as camera drivers do, while the block runs."""
        stop = threading.Event()

        def drive() -> None:
            due = time.monotonic()
            while not stop.is_set():
                for side in SIDES:
                    message = bag_messages.camera_info(self.next_stamp(), self.scene.loc, "loc", side)
                    self.publisher(CameraInfo, f"loc/{side}/camera_info").publish(serialised(message))
                self.send_loc()
                due += 1.0 / rate_hz
                stop.wait(max(due - time.monotonic(), 0.0))

        thread = threading.Thread(target=drive, name="camera", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def forget(self) -> None:
        """Keep only the latest stamps, so that this process does not grow in a long run."""
        for stamp_ns in list(self.sent)[:-KEPT]:
            del self.sent[stamp_ns]

    def _send_images(self, task: str, pair: StereoPair) -> None:
        for side, pixels in zip(SIDES, (pair.left, pair.right), strict=True):
            message = bag_messages.image(pair.stamp_ns, pixels, task, side)
            self.publisher(Image, f"{task}/{side}/image_rect").publish(serialised(message))

"""Passes the messages of the nodes to a `LiveState`, in its own thread.

Small messages are always received. Images, feature tracks and clouds are received only while a viewer shows them.
Images above the displayed rate are dropped before decoding.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from threading import Event, Thread
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from sfr_loc_map.calls.call_message import decode_call
from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.image_codec import SampleDepth, samples_of
from sfr_loc_map.io.truth.messages import TruthReader
from sfr_loc_map.live import updates
from sfr_loc_map.live.map_feed import MapFeed
from sfr_loc_map.live.operator import NodeOperator
from sfr_loc_map.live.page_process import connected_nodes_topic, page_node_name
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.tracked_images import TrackedImages, are_of_pair
from sfr_loc_map.message_stamps import NS_PER_S, serialised_stamp
from sfr_loc_map.message_types import StatusKind
from sfr_loc_map.ros.messages import message_type
from sfr_loc_map.ros.peer import Peer
from sfr_loc_map.ros.point_messages import tracks_from_msg
from sfr_loc_map.ros.pose_messages import covariance_of, odometry_row
from sfr_loc_map.ros.publishers import name_to_subscribe, resolved_name
from sfr_loc_map.ros.qos import LATCHED
from sfr_loc_map.ros.statuses import level_of, values_of
from sfr_loc_map.ros.truth_subscription import TruthSubscription
from sfr_loc_map.suite_names import SUITE_NODES, Task
from sfr_loc_map.topics import (
    CAMERAS,
    CLOUD,
    DIAGNOSTICS,
    ELEVATION,
    ESTIMATE,
    HAZARD,
    IMAGES,
    RECTIFIED,
    REPORT,
    TRACKS,
    TRUE_POINTS,
    TRUE_POSES,
    call_topic,
)
from sfr_loc_map.worker import Overload, Worker

DEPTH = 200  #: Queue depth of poses, calls and diagnostics.
GRAPH_PERIOD_S = 0.5  #: Period, s, at which the graph is examined and subscriptions follow the viewers.
SPIN_S = 0.1  #: Maximum wait of the executor, s, which bounds the time to end the thread.
IMAGE_PERIOD_S = 0.15  #: Minimum interval between displayed image pairs, s.
MAX_MAPS = 8  #: Maximum number of waiting clouds, elevation and hazard grids; the oldest are dropped.
SHOWN_KINDS = (StatusKind.HEALTH, StatusKind.INPUT, StatusKind.FAULT)
"""Kinds of status that are displayed. Statuses of calls are not among them, because calls are received as records."""
BEST_EFFORT = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
IMAGE_QOS = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
TRUTH_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class RosFeed(Peer):
    """Receives messages for the viewers of a state, in its own thread; a context manager."""

    def __init__(self, state: LiveState, namespace: str = "", remaps: Sequence[str] = ()) -> None:
        """Join the graph; `remaps` are those of the nodes, `FROM:=TO`."""
        super().__init__(page_node_name(os.getpid()), f"/{namespace.strip('/')}", remaps=remaps)
        self._state = state
        self._space = namespace.strip("/")
        self._media: list[Subscription] = []  # subscriptions to tracks and maps while a viewer shows them
        self._images_of: dict[str, Subscription] = {}  # subscription to the images of each camera
        self._depths: dict[str, SampleDepth] = {}
        self._next_images: dict[str, float] = {}  # time of the next pair of each rig
        self._shown: dict[str, tuple[str, int]] = {}  # by rig: camera and stamp of the image that began the last pair
        self._images = TrackedImages(self._show_image)
        self._maps = MapFeed(state, lambda: self._has_publisher(ELEVATION))
        self._map_worker = Worker("sfr-live-maps", Overload.ALL, MAX_MAPS, self._log_fault)
        self._heard_nodes = set[str]()  # nodes of the suite of which a status was received
        self._connected_nodes = set[str]()
        topic = connected_nodes_topic(self.ros_node.get_name())
        self._connected_publisher = self.ros_node.create_publisher(String, topic, LATCHED)
        self._closed = Event()
        self._thread = Thread(target=self._spin, name="sfr-live-ros", daemon=True)
        self.operator = NodeOperator(self.ros_node)
        self._subscribe_to_figures()
        self.ros_node.create_timer(GRAPH_PERIOD_S, self._examine_graph)

    def __enter__(self) -> RosFeed:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.operator.close()
        self._closed.set()
        self._thread.join(5.0)
        self._map_worker.stop()
        super().__exit__()

    def _spin(self) -> None:
        while not self._closed.is_set():
            try:
                self.executor.spin_once(timeout_sec=SPIN_S)
            except Exception as error:  # an invalid message must not stop the page
                self._log_fault(error)

    def _log_fault(self, error: Exception, _: bool = False) -> None:
        """Log an exception. An invalid message is not logged, because the node that receives it reports it."""
        if not isinstance(error, SfrError) and not self._closed.is_set():
            self.ros_node.get_logger().error(f"live: {error!r}", throttle_duration_sec=5.0)

    # ---- subscriptions

    def _subscribe_to_figures(self) -> None:
        """Subscribe to the small messages, and to the true points because they are published only once.

        The diagnostics are last, because `_publish_connected_nodes` relies on this order.
        """
        self._receive(Odometry, ESTIMATE, self._on_odometry, BEST_EFFORT)
        self._truth = TruthSubscription(self._receive_truth)
        self._receive_map(TRUE_POINTS, PointCloud2, self._maps.add_true_points, TRUTH_QOS)
        for task in Task:
            self.subscribe(String, call_topic(task), partial(self._on_call, task), BEST_EFFORT)
        self.subscribe(String, REPORT, self._on_score, LATCHED)
        self.subscribe(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, BEST_EFFORT)

    def _receive_truth(self, msgtype: str) -> Callable[[], object]:
        """Subscribe to true poses of a type; return the function that unsubscribes."""
        kind = message_type(msgtype)
        subscription = self._receive(kind, TRUE_POSES, partial(self._on_truth, TruthReader(msgtype), kind), BEST_EFFORT)
        return partial(self.ros_node.destroy_subscription, subscription)

    def _follow_viewers(self) -> None:
        """Subscribe to images, tracks and maps only while a viewer shows them."""
        if not self._state.is_watched:
            for subscription in (*self._media, *self._images_of.values()):
                self.ros_node.destroy_subscription(subscription)
            self._media.clear()
            self._images_of.clear()
            return
        if not self._media:
            self._media = [
                self._receive(PointCloud2, TRACKS, self._on_tracks, IMAGE_QOS),
                # the cloud gives the errors, and a grid if none is published
                self._receive_map(CLOUD, PointCloud2, self._maps.add_cloud, LATCHED),
                self._receive_map(ELEVATION, PointCloud2, self._maps.add_elevation, LATCHED),
                self._receive_map(HAZARD, OccupancyGrid, self._maps.add_hazard, LATCHED),
            ]
        for name in CAMERAS:  # image topics are subscribed to once they have a publisher
            self._find_image_topic(name)

    def _find_image_topic(self, name: str) -> None:
        """Subscribe to the first topic of a camera's images that has a publisher; report if no topic has one.

        A subscription whose topic has lost its publisher is replaced once another topic of the camera has a publisher.
        """
        former = self._images_of.get(name)
        if former is not None and self.ros_node.count_publishers(former.topic_name) > 0:
            return
        for ending, msgtype in IMAGES.items():
            topic = f"{name}/{ending}"
            if self._has_publisher(topic):
                kind = message_type(msgtype)
                subscribed = name_to_subscribe(self.ros_node, topic)
                received = partial(self._on_image, name, kind)
                if former is not None:
                    self.ros_node.destroy_subscription(former)
                self._images_of[name] = self._receive(kind, subscribed, received, IMAGE_QOS)
                reason = f"{self._images_of[name].topic_name} has a publisher; no image has arrived yet"
                self._state.put(updates.ImageProblem(name, reason))
                return
        if former is not None:
            return
        topics = ", ".join(resolved_name(self.ros_node, f"{name}/{ending}") for ending in IMAGES)
        reason = f"no publisher of {topics}; set another name by sfr live -r {name}/{RECTIFIED}:=TOPIC"
        self._state.put(updates.ImageProblem(name, reason))

    def _has_publisher(self, topic: str) -> bool:
        return self.ros_node.count_publishers(resolved_name(self.ros_node, topic)) > 0

    def _receive(
        self, kind: type[Any], topic: str, callback: Callable[[bytes, float], None], qos: QoSProfile
    ) -> Subscription:
        """Subscribe with a callback that receives serialised messages and their publication times, s."""
        gaps = self.count_messages(topic)

        def received(raw: bytes, info: dict[str, Any]) -> None:
            gaps.add(info)
            callback(raw, (info.get("source_timestamp") or time.time_ns()) / NS_PER_S)

        return self.subscribe(kind, topic, received, qos, raw=True)

    def _receive_map(
        self, topic: str, kind: type[Any], add: Callable[[Any, float], None], qos: QoSProfile
    ) -> Subscription:
        """Subscribe to maps, which are processed in another thread so that they do not delay the figures."""

        def received(raw: bytes, published_s: float) -> None:
            self._map_worker.enqueue_droppable(lambda: add(deserialize_message(raw, kind), published_s))

        return self._receive(kind, topic, received, qos)

    # ---- messages

    def _on_score(self, message: String, _: dict[str, Any]) -> None:
        self._state.put(updates.PublishedScore(message.data, time.time()))

    def _on_odometry(self, raw: bytes, _: float) -> None:
        message = deserialize_message(raw, Odometry)
        stamp_ns, position, quat = odometry_row(message)
        covariance = covariance_of(message)
        self._state.put(updates.PoseSample(updates.Track.ESTIMATE, stamp_ns, position, quat, time.time(), covariance))

    def _on_truth(self, reader: TruthReader, kind: type[Any], raw: bytes, _: float) -> None:
        for stamp_ns, pose, _variances in reader.rows(deserialize_message(raw, kind)):
            x, y, z, *rotation = pose
            position, quat = (x, y, z), (rotation[0], rotation[1], rotation[2], rotation[3])
            with refusing(f"true pose of stamp {stamp_ns}", "correct the publisher"):
                Transform.from_quat(position, quat if any(quat) else (0.0, 0.0, 0.0, 1.0))
            self._state.put(updates.PoseSample(updates.Track.TRUTH, stamp_ns, position, quat, time.time()))

    def _on_diagnostics(self, message: DiagnosticArray, _: dict[str, Any]) -> None:
        for status in message.status:
            full_name, _, kind = status.name.partition(": ")
            space, _, name = full_name.strip("/").rpartition("/")
            if space != self._space or name not in SUITE_NODES or kind not in SHOWN_KINDS:
                continue
            self._heard_nodes.add(name)
            found = updates.Status(
                name, StatusKind(kind), level_of(status), status.message, values_of(status), time.time()
            )
            self._state.put(found)

    def _on_call(self, task: Task, message: String, _: dict[str, Any]) -> None:
        call = decode_call(message.data, task)
        self._state.put(updates.NodeCall(task.node, call, time.time()))
        if call.pair_stamps_ns:
            self._map_worker.enqueue(partial(self._maps.add_call, call))

    def _on_image(self, name: str, kind: type[Any], raw: bytes, published_s: float) -> None:
        stamp_ns, rig = serialised_stamp(raw), name.partition("/")[0]
        self._state.put(updates.ImageStamp(name, stamp_ns, published_s))
        if not self._is_shown(rig, name, stamp_ns):
            return
        try:
            depth = self._depths.setdefault(rig, SampleDepth(lambda _: None, rig))
            (image,) = depth.grey(samples_of(deserialize_message(raw, kind)))
        except SfrError as error:
            reason = f"{self._images_of[name].topic_name} cannot be shown: {error}"
            self._state.put(updates.ImageProblem(name, reason))
            return
        self._images.add_image(name, stamp_ns, image, published_s)

    def _is_shown(self, rig: str, name: str, stamp_ns: int) -> bool:
        """Return whether an image is displayed: at most one pair per `IMAGE_PERIOD_S`, and both images of the pair."""
        now_s = time.monotonic()
        if now_s < self._next_images.get(rig, 0.0):
            first, first_ns = self._shown[rig]
            return name != first and are_of_pair(first_ns, stamp_ns)
        self._next_images[rig] = now_s + IMAGE_PERIOD_S
        self._shown[rig] = name, stamp_ns
        return True

    def _show_image(self, sample: updates.ImageSample) -> None:
        self._state.put(updates.ImageProblem(sample.topic, ""))
        self._state.put(sample)

    def _on_tracks(self, raw: bytes, _: float) -> None:
        stamp_ns = serialised_stamp(raw)
        if self._images.is_waiting(stamp_ns):
            tracks = tracks_from_msg(deserialize_message(raw, PointCloud2))
            self._images.add_tracks(stamp_ns, tracks)

    # ---- the graph

    def _examine_graph(self) -> None:
        """Detect the nodes, and subscribe to what the viewers display."""
        self._follow_viewers()
        published = self.ros_node.get_publishers_info_by_topic(self.ros_node.resolve_topic_name(TRUE_POSES))
        self._truth.follow([str(info.topic_type) for info in published])
        names = self.ros_node.get_node_names_and_namespaces()
        nodes = frozenset(name for name, space in names if space.strip("/") == self._space) & frozenset(SUITE_NODES)
        self._state.put(updates.GraphNodes(nodes, time.time(), lost_by_topic(self.count_losses())))
        self._publish_connected_nodes()

    def _publish_connected_nodes(self) -> None:
        """Publish which nodes of the suite are connected, if the set has grown.

        A node of which a status was received has discovered the subscriptions of this node: endpoints are announced in
        the order of their creation, and the subscription to the statuses is created last. Conversely, this node has
        discovered the publishers of an active node once it has discovered the service `reset`, which is created last.
        """
        waiting = self._heard_nodes - self._connected_nodes
        if not waiting:
            return
        services = {name for name, _ in self.ros_node.get_service_names_and_types()}
        found = {name for name in waiting if self.ros_node.resolve_service_name(f"{name}/reset") in services}
        if found:
            self._connected_nodes |= found
            self._connected_publisher.publish(String(data=" ".join(sorted(self._connected_nodes))))


def lost_by_topic(losses: Mapping[str, int]) -> dict[str, int]:
    """Return the number of lost messages of each topic of the state, which has one topic for all images of a camera.

    `losses` has the numbers by the names of the subscribed topics, such as `loc/left/image_rect/compressed`.
    """
    found = Counter[str]()
    for topic, count in losses.items():
        camera, _, _ = topic.rpartition("/image_")
        found[camera or topic] += count
    return found

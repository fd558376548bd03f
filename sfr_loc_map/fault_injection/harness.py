"""The nodes as processes, and one node in this process that talks to them and remembers what they said."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import NodeError
from sfr_loc_map.fault_injection.node_process import MB, NodeProcess
from sfr_loc_map.fault_injection.outcome import CampaignSettings
from sfr_loc_map.fault_injection.scene import MOUNT, Scene
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.diagnostics.key_values import TOPIC, Level, level_of, values_of
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.pose import odometry_row, pose_msg

LOCALISATION, MAPPING, MONITOR = "localisation_node", "mapping_node", "monitor_node"
NODES = (LOCALISATION, MAPPING, MONITOR)
SIDES: tuple[bag_messages.Side, ...] = ("left", "right")
SENT_DEPTH, KEPT_DEPTH = 50, 1000
"""Pictures, and small messages, that a publisher keeps for a subscriber that is held up."""
MOUNT_ARGUMENTS = (
    "-p",
    f"T_rb_locsb.translation_m:={MOUNT.translation.tolist()}",
    "-p",
    f"T_rb_locsb.quat_xyzw:={MOUNT.file_quat_xyzw.tolist()}",
)
POLL_S = 0.005
MATCH_S = 0.5
"""The other side may know of a match a little later."""
STAMP_DIGITS = 19
START_S = 300.0
"""Starting compiles machine code where that was never done before."""


def raw(message: Any) -> bytes:  # noqa: ANN401 - any message of the bag's library
    """Return a message serialised (CDR), ready to be published."""
    return bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__))


class Bench:
    """Node processes and the node that tests them; a context manager."""

    def __init__(
        self,
        folder: Path,
        settings: CampaignSettings,
        arguments: Mapping[str, Sequence[str]] | None = None,
        scene: Scene | None = None,
        nodes: Sequence[str] = NODES,
    ) -> None:
        """Start the nodes and join the graph; `wait_ready` waits for them.

        Args:
            folder: For logs and what the nodes save; made if need be.
            settings: Settings of the campaign.
            arguments: ROS arguments of nodes beside the usual ones, by node.
            scene: What the cameras see.
            nodes: Which nodes.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.settings, self.scene = folder, settings, scene or Scene()
        self.saved_pose, self.saved_report = folder / "pose.json", folder / "report.json"
        self.nodes = {name: self._process(name, (arguments or {}).get(name, ())) for name in nodes}
        self.odometry: dict[int, tuple[float, Odometry]] = {}
        self.calls: dict[tuple[str, str, int], tuple[float, dict[str, str]]] = {}
        self.health: dict[str, tuple[float, Level, str, dict[str, str]]] = {}
        self.problems: list[tuple[str, str]] = []
        self.clouds: dict[int, float] = {}
        self.report: dict[str, Any] = {}
        self.sent: dict[int, int] = {}
        self.index = 0
        for node in self.nodes.values():
            node.start()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("sfr_campaign")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        self._last_stamp = 0
        self._listen()
        self._thread = threading.Thread(target=self._executor.spin, name="campaign", daemon=True)
        self._thread.start()

    def __enter__(self) -> Bench:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End everything that was started."""
        for node in self.nodes.values():
            node.end()
        self._executor.shutdown()
        try_shutdown()
        self._thread.join(10.0)
        self.node.destroy_node()

    def _process(self, name: str, more: Sequence[str]) -> NodeProcess:
        arguments = ["--ros-args", "-p", "health.period_s:=0.2"]
        if name == LOCALISATION:
            arguments += [*MOUNT_ARGUMENTS, "-p", f"resume_file:={self.saved_pose}"]
        if name == MONITOR:
            arguments += ["-p", "publish_period_s:=0.2", "-p", "save_period_s:=1.0"]
            arguments += ["-p", f"save_file:={self.saved_report}"]
        return NodeProcess(
            f"nodes.{name}", [*arguments, *more], self.folder, {"ROS_LOG_DIR": str(self.folder / "ros_log")}
        )

    # ---- what the nodes say

    def _listen(self) -> None:
        many = QoSProfile(depth=1000)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Odometry, "localisation/odometry", self._on_odometry, many)
        self.node.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, many)
        self.node.create_subscription(PointCloud2, "mapping/points", self._on_cloud, QoSProfile(depth=10))
        self.node.create_subscription(String, "metrics/report", self._on_report, latched)

    def _on_odometry(self, message: Odometry) -> None:
        self.odometry[stamp_of(message)] = (time.monotonic(), message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, kind = status.name.partition(": ")
            values, now = values_of(status), time.monotonic()
            if kind == "call" and len(values.get("stamp_ns", "")) == STAMP_DIGITS:  # not the hostile ones
                self.calls[node, values["state"], int(values["stamp_ns"])] = (now, values)
            elif kind == "health":
                self.health[node] = (now, level_of(status), status.message, values)
            elif kind == "input":
                self.problems.append((node, status.message))

    def _on_cloud(self, message: PointCloud2) -> None:
        self.clouds[stamp_of(message)] = time.monotonic()

    def _on_report(self, message: String) -> None:
        self.report = json.loads(message.data)

    @property
    def monitored(self) -> int:
        """Poses that the monitor has in its score."""
        return int(self.report.get("trajectory", {}).get("estimate_poses", 0))

    # ---- what is said to them

    def publisher(self, kind: type[Any], topic: str) -> Any:  # noqa: ANN401 - rclpy has no types
        """Return the publisher of a topic, of a latched one where the nodes take it so."""
        if topic not in self._publishers:
            qos = QoSProfile(depth=SENT_DEPTH if kind is Image else KEPT_DEPTH)
            if topic.endswith("/configuration"):
                qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
            self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
        return self._publishers[topic]

    def publish(self, kind: type[Any], topic: str, message: Any) -> None:  # noqa: ANN401 - a message or its bytes
        """Publish a message or its serialised form, once somebody listens."""
        is_new = topic not in self._publishers
        publisher = self.publisher(kind, topic)
        self.until(lambda: publisher.get_subscription_count() > 0, f"a listener on {topic}")
        if is_new:
            time.sleep(MATCH_S)
        publisher.publish(message)

    def next_stamp(self) -> int:
        """Return the present system time, later than any stamp before."""
        self._last_stamp = max(time.time_ns(), self._last_stamp + 1000)
        return self._last_stamp

    def send_infos(self, bench: str) -> None:
        """Publish camera_info of both cameras of a bench."""
        rig = self.scene.loc if bench == "loc" else self.scene.nav
        stamp_ns = self.next_stamp()
        for side in SIDES:
            self.publish(
                CameraInfo, f"{bench}/{side}/camera_info", raw(bag_messages.camera_info(stamp_ns, rig, bench, side))
            )

    def send_loc(self, stamp_ns: int | None = None) -> int:
        """Publish the next pair of the drive with its truth; return its stamp."""
        stamp_ns = self.next_stamp() if stamp_ns is None else stamp_ns
        pair, pose = self.scene.loc_pair(self.index, stamp_ns), self.scene.true_pose(self.index)
        self.sent[stamp_ns] = self.index
        self.index += 1
        truth = bag_messages.odometry(stamp_ns, pose.translation, pose.quat_xyzw)
        self.publisher(Odometry, "ground_truth/odometry").publish(raw(truth))
        for side, picture in zip(SIDES, (pair.left, pair.right), strict=True):
            message = bag_messages.image(stamp_ns, picture, "loc", side)
            self.publisher(Image, f"loc/{side}/image_rect").publish(raw(message))
        return stamp_ns

    def send_nav(self, index: int, stamp_ns: int | None = None) -> int:
        """Publish one of the three pairs of a map with its pose; return its stamp."""
        stamp_ns = self.next_stamp() if stamp_ns is None else stamp_ns
        pair = self.scene.nav_pair(index, stamp_ns)
        self.publisher(PoseStamped, "nav/pose").publish(raw(bag_messages.pose(stamp_ns, self.scene.nav_pose(index))))
        for side, picture in zip(SIDES, (pair.left, pair.right), strict=True):
            message = bag_messages.image(stamp_ns, picture, "nav", side)
            self.publisher(Image, f"nav/{side}/image_rect").publish(raw(message))
        return stamp_ns

    def call(self, service: str) -> Any:  # noqa: ANN401 - rclpy has no types
        """Call a Trigger service; return its answer."""
        client = self.node.create_client(Trigger, service)
        try:
            self.until(client.service_is_ready, f"service {service}")
            future = client.call_async(Trigger.Request())
            self.until(future.done, f"answer of {service}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    # ---- steps of a row

    def until(self, condition: Callable[[], object], what: str, patience_s: float | None = None) -> float:
        """Wait until something is so; return how long that took, seconds.

        Raises:
            NodeError: If it takes too long.
        """
        patience_s = self.settings.patience_s if patience_s is None else patience_s
        begin = time.monotonic()
        while not condition():
            if time.monotonic() - begin > patience_s:
                raise NodeError(f"{what} did not come within {patience_s:g} s")
            time.sleep(POLL_S)
        return time.monotonic() - begin

    def wait_ready(self) -> None:
        """Wait until the nodes answer: a pair is localised, a map is made, the monitor has the poses."""
        for name in self.nodes:
            self.wait_listening(name, START_S)
        if LOCALISATION in self.nodes:
            self.start_at_truth()
            self.localise()
            begin = time.monotonic()
            # that the monitor hears localisation cannot be seen from here
            while MONITOR in self.nodes and not self.monitored and time.monotonic() - begin < self.settings.patience_s:
                self.localise()
        if MAPPING in self.nodes:
            self.map()
        self.settle()

    def start_at_truth(self) -> None:
        """Let the next estimate start at the true pose of the next pair."""
        pose = self.scene.true_pose(self.index)
        message = PoseWithCovarianceStamped(header=header_msg(0, "ds"))
        message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
        self.publish(PoseWithCovarianceStamped, "initialpose", message)
        self.publisher(PoseWithCovarianceStamped, "initialpose").wait_for_all_acked(Duration(seconds=5))

    def wait_listening(self, name: str, patience_s: float | None = None) -> None:
        """Wait until a node is connected with this one in both ways."""
        topic = {LOCALISATION: "loc", MAPPING: "nav"}.get(name)
        for side in SIDES if topic is not None else ():
            for kind, last in ((CameraInfo, "camera_info"), (Image, "image_rect")):
                publisher = self.publisher(kind, f"{topic}/{side}/{last}")
                self._until_heard(publisher, name, patience_s)
        if name == MAPPING:
            self._until_heard(self.publisher(PoseStamped, "nav/pose"), name, patience_s)
        if name == MONITOR:
            self._until_heard(self.publisher(Odometry, "ground_truth/odometry"), name, patience_s)
        begin = time.monotonic()
        heard = lambda: name in self.health and self.health[name][0] >= begin  # noqa: E731
        self.until(lambda: heard() and self.health[name][3]["lifecycle"] == "active", f"health of {name}", patience_s)

    def _until_heard(self, publisher: Any, name: str, patience_s: float | None) -> None:  # noqa: ANN401
        self.until(lambda: publisher.get_subscription_count() > 0, f"{name} on {publisher.topic_name}", patience_s)

    def await_pose(self, stamp_ns: int, what: str = "odometry") -> None:
        """Wait for the odometry of a pair."""
        self.until(lambda: stamp_ns in self.odometry, what)

    def localise(self, count: int = 1) -> list[int]:
        """Localise pairs in lock step; return their stamps."""
        self.send_infos("loc")
        stamps = []
        for _ in range(count):
            stamps.append(self.send_loc())
            self.await_pose(stamps[-1])
        return stamps

    def map(self, pairs: Sequence[int] = (0, 1, 2)) -> list[int]:
        """Map pairs in lock step, and wait for the cloud if they are three; return their stamps."""
        self.send_infos("nav")
        stamps = []
        for index in pairs:
            stamps.append(self.send_nav(index))
            self.until(lambda: (MAPPING, "mapped", stamps[-1]) in self.calls, "mapped pair")
        if len(pairs) == 3:
            self.until(lambda: stamps[-1] in self.clouds, "cloud")
        return stamps

    @contextmanager
    def driving(self, rate_hz: float) -> Iterator[None]:
        """Publish pairs, each with camera_info as camera drivers do, while the block runs."""
        stop = threading.Event()

        def drive() -> None:
            due = time.monotonic()
            while not stop.is_set():
                self._send_infos_at_once()
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

    def _send_infos_at_once(self) -> None:
        for side in SIDES:
            message = bag_messages.camera_info(self.next_stamp(), self.scene.loc, "loc", side)
            self.publisher(CameraInfo, f"loc/{side}/camera_info").publish(raw(message))

    def settle(self, quiet_s: float = 0.5) -> None:
        """Wait until no odometry has come for a while and the monitor's score does not change any more."""
        state, since = (len(self.odometry), self.monitored), time.monotonic()
        deadline = since + self.settings.patience_s
        while time.monotonic() - since < quiet_s and time.monotonic() < deadline:
            time.sleep(0.05)
            now = (len(self.odometry), self.monitored)
            if now != state:
                state, since = now, time.monotonic()

    def forget(self) -> None:
        """Forget what was sent and heard, so that this process does not grow in a long run."""
        memories: tuple[dict[Any, Any], ...] = (self.odometry, self.calls, self.clouds, self.sent)
        for kept in memories:
            for stamp in list(kept)[:-10]:
                del kept[stamp]

    def memory_mb(self, name: str) -> float:
        """Return the resident memory of a node, MB."""
        return self.nodes[name].resident_bytes / MB

    def position(self, stamp_ns: int) -> FloatArray:
        """Return the position of an odometry message, `(3,)`, metres."""
        return np.array(odometry_row(self.odometry[stamp_ns][1])[1])

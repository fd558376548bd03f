"""The ROS graph of a campaign: the nodes as processes, and a rover in this process that stores their messages."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from helpers import made_scene
from helpers.node_scenes import MOUNT, params, raw
from sfr_loc_map.errors import NodeError
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.ros.environment import start_ros
from sfr_loc_map.ros.pose_messages import pose_msg
from sfr_loc_map.ros.processes import ChildProcess, end_processes, node_process
from sfr_loc_map.ros.statuses import level_of, values_of
from sfr_loc_map.suite_names import SIDES
from sfr_loc_map.topics import DIAGNOSTICS

LOCALISATION, MAPPING, MONITOR = NODES = ("localisation_node", "mapping_node", "monitor_node")
START_S = 300.0
"""Patience for a start, s, because the first start after an installation compiles the kernels."""
IMAGE_DEPTH, SMALL_DEPTH = 50, 1000
"""Queue depths of publishers for images and for small messages, for slow subscribers."""
MATCH_S = 0.3
"""Wait after discovery, s, because the subscriber may discover a match later than the publisher."""
TURN = 40
"""Number of pairs after which the rover turns back."""
STAMP_DIGITS = 19
"""Digits of a current stamp in ns; stamps of malformed messages have other lengths."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass(frozen=True)
class Health:
    received_s: float
    level: Level
    message: str
    values: dict[str, str]

    @property
    def dropped(self) -> int:
        return sum(int(value) for name, value in self.values.items() if name.startswith("dropped_"))


class Harness:
    """Context manager with node processes, the publishers of a rover, and the messages of the nodes."""

    def __init__(self, folder: Path, nodes: Sequence[str] = NODES, patience_s: float = 30.0) -> None:
        """Start the nodes and join the ROS graph."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.patience_s = folder, patience_s
        self.saved_pose, self.saved_report = folder / "pose.json", folder / "report.json"
        os.environ["ROS_LOG_DIR"] = str(folder / "ros_log")
        self.nodes = {name: self._process(name) for name in nodes}
        start_ros()
        self.node = rclpy.create_node("sfr_campaign")
        self.odometry: dict[int, Odometry] = {}
        self.calls: dict[tuple[str, str, int], dict[str, str]] = {}
        self.health: dict[str, Health] = {}
        self.problems: list[str] = []
        self.clouds: set[int] = set()
        self.report: dict[str, Any] = {}
        self.sent: list[int] = []
        self.rig = made_scene.LOC_RIG
        self._index = self._last_stamp = 0
        self._publishers: dict[str, Any] = {}
        self._images = cache(lambda step: made_scene.stereo_pair(0, self._pose(step) @ made_scene.T_RB_LOCSB, self.rig))
        self._nav_pairs = cache(made_scene.nav_pair)
        deep, subscribe = QoSProfile(depth=1000), self.node.create_subscription
        subscribe(Odometry, "localisation/odometry", lambda m: self.odometry.update({stamp_of(m): m}), deep)
        subscribe(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, deep)
        subscribe(PointCloud2, "mapping/points", lambda m: self.clouds.add(stamp_of(m)), QoSProfile(depth=10))
        subscribe(String, "metrics/report", lambda m: setattr(self, "report", json.loads(m.data)), LATCHED)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def __enter__(self) -> Harness:
        return self

    def __exit__(self, *_: object) -> None:
        end_processes(list(self.nodes.values()))
        self._executor.shutdown()
        try_shutdown()
        self._thread.join(10.0)
        self.node.destroy_node()

    def _process(self, name: str) -> ChildProcess:
        own = {
            LOCALISATION: [*MOUNT, *params(f"resume_file:={self.saved_pose}")],
            MAPPING: [],
            MONITOR: params("publish_period_s:=0.2", "save_period_s:=1.0", f"save_file:={self.saved_report}"),
        }[name]
        arguments = ["--ros-args", *params("health.period_s:=0.2", "input.reliability:=reliable"), *own]
        return node_process(f"nodes.{name}", arguments, self.folder)

    def kill(self, name: str) -> None:
        """Kill a node by SIGKILL, and wait for its end."""
        self.nodes[name].send(signal.SIGKILL)
        self.nodes[name].popen.wait()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, kind = status.name.partition(": ")
            values = values_of(status)
            if kind == "call" and len(values.get("stamp_ns", "")) == STAMP_DIGITS:
                self.calls[node, values["state"], int(values["stamp_ns"])] = values
            elif kind == "health":
                self.health[node] = Health(time.monotonic(), level_of(status), status.message, values)
            elif kind in ("input", "fault"):
                self.problems.append(status.message)

    # ---- the rover

    @staticmethod
    def _pose(index: int) -> Transform:
        """Return the true pose of a pair of the endless drive, which goes forth and back."""
        phase = index % (2 * TURN)
        return made_scene.true_pose(min(phase, 2 * TURN - phase))

    def next_stamp(self) -> int:
        self._last_stamp = max(time.time_ns(), self._last_stamp + 1000)
        return self._last_stamp

    def publisher(self, kind: type[Any], topic: str) -> Any:
        """Return the publisher of a topic, with transient-local durability for topics that require it."""
        if topic not in self._publishers:
            deep = QoSProfile(depth=IMAGE_DEPTH if kind is Image else SMALL_DEPTH)
            self._publishers[topic] = self.node.create_publisher(kind, topic, LATCHED if kind is String else deep)
        return self._publishers[topic]

    def publish(self, kind: type[Any], topic: str, message: Any) -> None:
        """Publish a message or its serialised form, once there is a subscriber."""
        is_new, publisher = topic not in self._publishers, self.publisher(kind, topic)
        self.wait(lambda: publisher.get_subscription_count() > 0, f"subscriber of {topic}")
        if is_new:
            time.sleep(MATCH_S)
        publisher.publish(message)

    def send_camera_info(self, task: str) -> None:
        rig = self.rig if task == "loc" else made_scene.NAV_RIG
        for side in SIDES:
            info = bag_messages.camera_info(self.next_stamp(), rig, task, side)
            self.publish(CameraInfo, f"{task}/{side}/camera_info", raw(info))

    def pair(self, task: str) -> StereoPair:
        """Return the first pair of a task with the current stamp, without publishing it."""
        return replace(self._images(0) if task == "loc" else self._nav_pairs(0).pair, stamp_ns=self.next_stamp())

    def send_loc(self, stamp_ns: int | None = None) -> int:
        """Publish the next pair of the drive with its true pose; return the stamp."""
        stamp_ns = self.next_stamp() if stamp_ns is None else stamp_ns
        pose, phase = self._pose(self._index), self._index % (2 * TURN)
        truth = bag_messages.odometry(stamp_ns, pose.translation, pose.quat_xyzw)
        self.publisher(Odometry, "ground_truth/odometry").publish(raw(truth))
        self.sent.append(stamp_ns)
        self._send_images("loc", stamp_ns, self._images(min(phase, 2 * TURN - phase)))
        self._index += 1
        return stamp_ns

    def send_nav(self, index: int) -> int:
        """Publish one of the three pairs of a map with its pose; return the stamp."""
        stamp_ns, item = self.next_stamp(), self._nav_pairs(index)
        self.publisher(PoseStamped, "nav/pose").publish(raw(bag_messages.pose(stamp_ns, item.T_lm_navsb)))
        self._send_images("nav", stamp_ns, item.pair)
        return stamp_ns

    def _send_images(self, task: str, stamp_ns: int, pair: StereoPair) -> None:
        for side, pixels in zip(SIDES, (pair.left, pair.right), strict=True):
            image = raw(bag_messages.image(stamp_ns, pixels, task, side))
            self.publisher(Image, f"{task}/{side}/image_rect").publish(image)

    def start_at_truth(self) -> None:
        """Set the initial pose to the true pose of the next pair."""
        message, pose = PoseWithCovarianceStamped(), self._pose(self._index)
        message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
        self.publish(PoseWithCovarianceStamped, "initialpose", message)
        self.publisher(PoseWithCovarianceStamped, "initialpose").wait_for_all_acked(Duration(seconds=5))

    @contextmanager
    def driving(self, rate_hz: float) -> Iterator[None]:
        """Publish pairs with camera_info, like camera drivers, while the block runs."""
        stop = threading.Event()

        def drive() -> None:
            due = time.monotonic()
            while not stop.is_set():
                for side in SIDES:
                    info = bag_messages.camera_info(self.next_stamp(), self.rig, "loc", side)
                    self.publisher(CameraInfo, f"loc/{side}/camera_info").publish(raw(info))
                self.send_loc()
                due += 1.0 / rate_hz
                stop.wait(max(due - time.monotonic(), 0.0))

        thread = threading.Thread(target=drive, daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    # ---- waiting for the nodes

    @property
    def scored_poses(self) -> int:
        return int((self.report.get("association") or {}).get("estimate_poses", 0))

    def wait(self, condition: Callable[[], object], what: str, patience_s: float | None = None) -> float:
        """Wait until a condition holds; return the waiting time, s."""
        begin, patience_s = time.monotonic(), patience_s or self.patience_s
        while not condition():
            if time.monotonic() - begin > patience_s:
                raise NodeError(f"no {what} within {patience_s:g} s")
            time.sleep(0.005)
        return time.monotonic() - begin

    def wait_poses(self, count: int) -> None:
        goal = len(self.odometry) + count
        self.wait(lambda: len(self.odometry) >= goal, "odometry")

    def wait_ready(self) -> None:
        """Wait until a pair is localised, a map is complete, and the monitor has received poses."""
        for name in self.nodes:
            self.wait_connected(name, START_S)
        self.start_at_truth()
        self.localise()
        deadline = time.monotonic() + self.patience_s
        # this process cannot observe whether the monitor has discovered localisation
        while MONITOR in self.nodes and not self.scored_poses and time.monotonic() < deadline:
            self.localise()
        if MAPPING in self.nodes:
            self.map()
        self.settle()

    def wait_connected(self, name: str, patience_s: float | None = None) -> None:
        """Wait until a node is active and connected with this process in both directions."""
        topics: dict[str, type[Any]] = {"ground_truth/odometry": Odometry} if name == MONITOR else {}
        for side in SIDES if name != MONITOR else ():
            task = "loc" if name == LOCALISATION else "nav"
            topics |= {f"{task}/{side}/camera_info": CameraInfo, f"{task}/{side}/image_rect": Image}
        if name == MAPPING:
            topics["nav/pose"] = PoseStamped
        publishers = [self.publisher(kind, topic) for topic, kind in topics.items()]
        self.wait(lambda: all(p.get_subscription_count() for p in publishers), f"subscription of {name}", patience_s)
        begin, health = time.monotonic(), self.health

        def active() -> bool:
            return name in health and health[name].received_s >= begin and health[name].values["lifecycle"] == "active"

        self.wait(active, f"health of {name}", patience_s)

    def settle(self, quiet_s: float = 0.5) -> None:
        """Wait until no odometry has arrived for `quiet_s` and the monitor's score is unchanged."""
        last, since = (-1, -1), time.monotonic()
        deadline = since + self.patience_s
        while time.monotonic() - since < quiet_s and time.monotonic() < deadline:
            time.sleep(0.05)
            now = len(self.odometry), self.scored_poses
            if now != last:
                last, since = now, time.monotonic()

    def localise(self, count: int = 1) -> list[int]:
        """Localise pairs in lock step; return their stamps."""
        self.send_camera_info("loc")
        stamps = []
        for _ in range(count):
            stamps.append(self.send_loc())
            self.wait(lambda: stamps[-1] in self.odometry, "odometry")
        return stamps

    def map(self, pairs: Sequence[int] = (0, 1, 2)) -> None:
        """Map pairs in lock step, and wait for the cloud after three pairs."""
        self.send_camera_info("nav")
        for index in pairs:
            stamp = self.send_nav(index)
            self.wait(lambda stamp=stamp: (MAPPING, "mapped", stamp) in self.calls, "mapped pair")
        if len(pairs) == 3:
            self.wait(lambda: stamp in self.clouds, "cloud")

    def pairs_since(self, first_ns: int) -> tuple[int, int]:
        """Return the number of pairs sent after a stamp, and the number of these pairs without odometry."""
        sent = [stamp for stamp in self.sent if stamp > first_ns]
        return len(sent), sum(stamp not in self.odometry for stamp in sent)

    def call(self, service: str) -> Any:
        client = self.node.create_client(Trigger, service)
        self.wait(client.service_is_ready, f"service {service}")
        future = client.call_async(Trigger.Request())
        self.wait(future.done, f"answer of {service}")
        return future.result()

    def memory_mb(self, name: str) -> float:
        process = self.nodes[name]
        return psutil.Process(process.popen.pid).memory_info().rss / 1e6 if process.is_running else 0.0

    def forget(self) -> None:
        """Keep only the latest messages, to bound the memory of this process in a long run."""
        for kept in (self.odometry, self.calls):
            for key in list(kept)[:-10]:
                del kept[key]
        self.clouds.clear()
        del self.sent[:-10]

"""The nodes as processes, and one node in this process that publishes to them and records what they publish."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger

from sfr_loc_map.fault_injection.fake_rover import FakeRover
from sfr_loc_map.fault_injection.message_recorder import MessageRecorder
from sfr_loc_map.fault_injection.scene import LOCSB_EXTRINSICS, Scene
from sfr_loc_map.fault_injection.settings import CampaignSettings
from sfr_loc_map.fault_injection.waiting import wait_until
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.nodes.environment import start_ros
from sfr_loc_map.nodes.processes import ChildProcess, end_processes, node_process
from sfr_loc_map.nodes.replay.options import RELIABLE_INPUT

LOCALISATION, MAPPING, MONITOR = "localisation_node", "mapping_node", "monitor_node"
NODES = (LOCALISATION, MAPPING, MONITOR)
EXTRINSICS_ARGUMENTS = (
    "-p",
    f"T_rb_locsb.translation_m:={LOCSB_EXTRINSICS.translation.tolist()}",
    "-p",
    f"T_rb_locsb.quat_xyzw:={LOCSB_EXTRINSICS.file_quat_xyzw.tolist()}",
)
START_S = 300.0
"""The first start after an installation compiles the kernels."""
MB = 1_000_000


@dataclass(frozen=True, slots=True)
class PairCount:
    """Pairs of a drive that were sent, and those of them without odometry."""

    sent: int
    missing: int

    def __str__(self) -> str:
        """Return both as a phrase."""
        return f"{self.sent} pairs sent, {self.sent - self.missing} localised"

    @property
    def lost(self) -> str:
        """What was lost, as a phrase."""
        return f"{self.missing} pairs" if self.missing else "nothing"


class Harness:
    """Node processes, a fake rover and a recorder of what the nodes publish; a context manager.

    Attributes:
        folder: Folder for logs and files of the nodes.
        settings: Settings of the campaign.
        nodes: The node processes by name.
        node: Node of this process.
        rover: Publishes to the nodes.
        received: What the nodes have published.
    """

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
            arguments: ROS arguments of nodes beside the common ones, by node.
            scene: Scene that the cameras see.
            nodes: Which nodes.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.settings = folder, settings
        self.saved_pose, self.saved_report = folder / "pose.json", folder / "report.json"
        self.nodes = {name: self._process(name, (arguments or {}).get(name, ())) for name in nodes}
        for process in self.nodes.values():
            process.start()
        start_ros()
        self.node = rclpy.create_node("sfr_campaign")
        self.received = MessageRecorder(self.node)
        self.rover = FakeRover(self.node, scene or Scene(), settings.patience_s)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, name="campaign", daemon=True)
        self._thread.start()

    def __enter__(self) -> Harness:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End everything that was started."""
        end_processes(list(self.nodes.values()))
        self._executor.shutdown()
        try_shutdown()
        self._thread.join(10.0)
        self.node.destroy_node()

    def _process(self, name: str, more: Sequence[str]) -> ChildProcess:
        arguments = ["--ros-args", "-p", "health.period_s:=0.2", "-p", f"{RELIABLE_INPUT[name]}:=reliable"]
        if name == LOCALISATION:
            arguments += [*EXTRINSICS_ARGUMENTS, "-p", f"resume_file:={self.saved_pose}"]
        if name == MONITOR:
            arguments += ["-p", "publish_period_s:=0.2", "-p", "save_period_s:=1.0"]
            arguments += ["-p", f"save_file:={self.saved_report}"]
        variables = {"ROS_LOG_DIR": str(self.folder / "ros_log")}
        return node_process(f"nodes.{name}", [*arguments, *more], self.folder, variables)

    def wait_until(self, condition: Callable[[], object], what: str, timeout_s: float | None = None) -> float:
        """Wait until a condition holds; return how long that took, seconds.

        Raises:
            NodeError: If it takes too long.
        """
        return wait_until(condition, what, self.settings.patience_s if timeout_s is None else timeout_s)

    def wait_ready(self) -> None:
        """Wait until the nodes answer: a pair is localised, a map is made, the monitor has the poses."""
        for name in self.nodes:
            self.wait_connected(name, START_S)
        if LOCALISATION in self.nodes:
            self.rover.start_at_truth()
            self.localise()
            deadline = time.monotonic() + self.settings.patience_s
            # whether the monitor has discovered localisation cannot be seen from here
            while MONITOR in self.nodes and not self.received.scored_poses and time.monotonic() < deadline:
                self.localise()
        if MAPPING in self.nodes:
            self.map()
        self.settle()

    def wait_connected(self, name: str, timeout_s: float | None = None) -> None:
        """Wait until a node is active and connected with this one in both directions."""
        topics: dict[str, type[Any]] = {}
        if name in (LOCALISATION, MAPPING):
            task = "loc" if name == LOCALISATION else "nav"
            for side in SIDES:
                topics |= {f"{task}/{side}/camera_info": CameraInfo, f"{task}/{side}/image_rect": Image}
        if name == MAPPING:
            topics["nav/pose"] = PoseStamped
        if name == MONITOR:
            topics["ground_truth/odometry"] = Odometry
        publishers = [self.rover.publisher(kind, topic) for topic, kind in topics.items()]
        self.wait_until(
            lambda: all(publisher.get_subscription_count() > 0 for publisher in publishers),
            f"subscription of {name} to {', '.join(topics)}",
            timeout_s,
        )
        begin, health = time.monotonic(), self.received.health

        def active() -> bool:
            return name in health and health[name].received_s >= begin and health[name].values["lifecycle"] == "active"

        self.wait_until(active, f"health of {name}", timeout_s)

    def wait_pose(self, stamp_ns: int, what: str = "odometry") -> None:
        """Wait for the odometry of a pair."""
        self.wait_until(lambda: stamp_ns in self.received.odometry, what)

    def wait_poses(self, count: int) -> None:
        """Wait for so many more odometry messages."""
        goal = len(self.received.odometry) + count
        self.wait_until(lambda: len(self.received.odometry) >= goal, "odometry")

    def settle(self, quiet_s: float = 0.5) -> None:
        """Wait until no odometry has come for a while and the monitor's score does not change any more."""

        def state() -> tuple[int, int]:
            return len(self.received.odometry), self.received.scored_poses

        last, since = state(), time.monotonic()
        deadline = since + self.settings.patience_s
        while time.monotonic() - since < quiet_s and time.monotonic() < deadline:
            time.sleep(0.05)
            now = state()
            if now != last:
                last, since = now, time.monotonic()

    def localise(self, count: int = 1) -> list[int]:
        """Localise pairs in lock step; return their stamps."""
        self.rover.send_camera_info("loc")
        stamps = []
        for _ in range(count):
            stamps.append(self.rover.send_loc())
            self.wait_pose(stamps[-1])
        return stamps

    def map(self, pairs: Sequence[int] = (0, 1, 2)) -> list[int]:
        """Map pairs in lock step, and wait for the cloud if they are three; return their stamps."""
        self.rover.send_camera_info("nav")
        stamps = []
        for index in pairs:
            stamps.append(self.rover.send_nav(index))
            self.wait_until(lambda: (MAPPING, "mapped", stamps[-1]) in self.received.calls, "mapped pair")
        if len(pairs) == 3:
            self.wait_until(lambda: stamps[-1] in self.received.clouds, "cloud")
        return stamps

    def pairs_since(self, first_ns: int) -> PairCount:
        """Count the pairs that were sent after a stamp."""
        sent = [stamp for stamp in self.rover.sent if stamp > first_ns]
        return PairCount(len(sent), sum(stamp not in self.received.odometry for stamp in sent))

    def call(self, service: str) -> Any:  # noqa: ANN401 - rclpy has no types
        """Call a Trigger service; return its answer."""
        client = self.node.create_client(Trigger, service)
        try:
            self.wait_until(client.service_is_ready, f"service {service}")
            future = client.call_async(Trigger.Request())
            self.wait_until(future.done, f"answer of {service}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def memory_mb(self, name: str) -> float:
        """Return the resident memory of a node, MB; 0 where it does not run."""
        process = self.nodes[name]
        return float(psutil.Process(process.popen.pid).memory_info().rss) / MB if process.is_running else 0.0

    def cpu_s(self, name: str) -> float:
        """Return the CPU time that a node has used, its own and the system's for it, seconds."""
        times = psutil.Process(self.nodes[name].popen.pid).cpu_times()
        return float(times.user + times.system)

"""Plays a source over topics to the running nodes and records what they answer."""

from __future__ import annotations

import importlib
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.calls import task_record
from sfr_loc_map.nodes.conversions import cloud_from_msg, header_msg, odometry_row, pose_msg
from sfr_loc_map.nodes.diagnostics import TOPIC as DIAGNOSTICS
from sfr_loc_map.nodes.diagnostics import Level, level_of
from sfr_loc_map.nodes.playback import POSE_TOPIC, Message
from sfr_loc_map.nodes.supervisor import Supervisor
from sfr_loc_map.pipeline.call_record import CallRecord

START_TIMEOUT_S = 300.0
"""Starting compiles machine code where that was never done before."""
ANSWER_TIMEOUT_S = 120.0
QUIET_S = 5.0
"""At a rate, answers are awaited for so long after the last one."""
REPORT_TIMEOUT_S = 20.0
SETTLE_S = 0.3
QUEUE_DEPTH = 1000
SOURCE_DEPTH = 20
COLLECT_S = 0.05


@dataclass(slots=True)
class Recording:
    """What the nodes have answered.

    Attributes:
        rows: Stamp, position (m) and quaternion (x, y, z, w) of each odometry message, numbers as received.
        covariances: Covariance `(6, 6)` of the pose by stamp.
        localisation: Calls of the localiser by stamp.
        mapping: Calls of the mapper by stamp, and of the fusion by stamp.
        clouds: Fused clouds.
        report: Last report of the monitor (JSON), empty where there is none.
    """

    rows: list[tuple[int, tuple[float, ...], tuple[float, ...]]] = field(default_factory=list)
    covariances: dict[int, FloatArray] = field(default_factory=dict)
    localisation: dict[int, CallRecord] = field(default_factory=dict)
    mapping: dict[tuple[str, int], CallRecord] = field(default_factory=dict)
    clouds: list[PointCloud] = field(default_factory=list)
    report: str = ""

    @property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory."""
        if not self.rows:
            return Trajectory.empty()
        stamps, positions, quats = zip(*self.rows, strict=True)
        return Trajectory(np.array(stamps, np.int64), np.array(positions), np.array(quats))

    @property
    def records(self) -> list[CallRecord]:
        """All calls: those of the localiser, with the covariances of the odometry, then those of the mapper."""
        localised = [replace(r, covariance=self.covariances.get(s)) for s, r in self.localisation.items()]
        return [*localised, *self.mapping.values()]


class Player:
    """Publishes messages of a source and records the answers; a context manager."""

    def __init__(self, supervisor: Supervisor, topics: Mapping[str, str]) -> None:
        """Join the graph; signals stay with the program.

        Args:
            supervisor: The nodes.
            topics: Types of the topics to be published, by name.
        """
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.recording = Recording()
        self._supervisor = supervisor
        self._node: Node = rclpy.create_node(f"sfr_player_{os.getpid()}")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        depth = QoSProfile(depth=SOURCE_DEPTH)
        self._publishers = {
            name: self._node.create_publisher(_type(kind), name, depth) for name, kind in topics.items()
        }
        self._initial_pose = self._node.create_publisher(PoseWithCovarianceStamped, "initialpose", depth)
        self._problem = ""
        self._subscribe()
        self._resets = {name: self._node.create_client(Trigger, f"{name}/reset") for name in supervisor.pids}

    def __enter__(self) -> Player:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        try_shutdown()

    def wait_until_ready(self) -> None:
        """Wait until all nodes listen and are connected.

        Raises:
            NodeError: If a node ends, or it takes too long.
        """

        def ready() -> bool:
            if not all(client.service_is_ready() for client in self._resets.values()):
                return False
            publishers = self._publishers.values()
            return all(p.get_subscription_count() == self._node.count_subscribers(p.topic_name) for p in publishers)

        self._wait_for(ready, START_TIMEOUT_S, lambda: f"the nodes {', '.join(self._resets)} did not start")
        self._spin_for(SETTLE_S)

    def set_pose(self, pose: Transform) -> None:
        """Publish the pose at which localisation shall start, in its own world frame, and wait until it has arrived."""
        message = PoseWithCovarianceStamped(header=header_msg(0, ""))
        message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
        self._initial_pose.publish(message)
        self._wait_for(self._delivered, ANSWER_TIMEOUT_S, lambda: "initialpose was not taken by localisation_node")

    def play(self, messages: Iterable[Message], rate: float, progress: Callable[[str], None]) -> set[tuple[str, int]]:
        """Publish messages.

        Args:
            messages: In the order in which they are to be published.
            rate: 0: after each stereo pair its result is awaited; otherwise multiple of the speed of the stamps.
            progress: Called with `loc` or `nav` for each stereo pair published.

        Returns:
            Bench and stamp of each pair published.

        Raises:
            NodeError: If a node ends or does not answer.
            InputError: If a node refuses what it was given (rate 0).
        """
        pairs = _Pairs()
        clock = _Clock(rate)
        for message in messages:
            if rate > 0:
                self._spin_until(clock.due(message))
            self._publishers[message.topic].publish(message.raw)
            pair = pairs.add(message)
            if pair is None:
                continue
            if rate > 0:
                self._supervisor.check()
            else:
                self._await_result(*pair)
            progress(pair[0])
        return pairs.complete

    def finish(self, published: set[tuple[str, int]], pairs_per_map: int) -> None:
        """Wait for what is still to come: results, cloud, the monitor's report.

        Args:
            published: What `play` returned.
            pairs_per_map: Pairs after which the mapper makes a cloud.
        """
        mapped = sum(bench == "nav" for bench, _ in published)
        clouds = mapped // pairs_per_map if pairs_per_map else 0

        def complete() -> bool:
            return all(self._answered(*pair) for pair in published) and len(self.recording.clouds) >= clouds

        count, deadline = -1, 0.0
        while not complete() and (count != self._answers() or time.monotonic() < deadline):
            if count != self._answers():
                count, deadline = self._answers(), time.monotonic() + QUIET_S
            self._spin_for(COLLECT_S)
        self._await_report(clouds > 0)

    def _await_report(self, with_map: bool) -> None:
        """Wait for the report that has everything; without it the score is made of the recording all the same."""
        deadline = time.monotonic() + REPORT_TIMEOUT_S
        while time.monotonic() < deadline:
            report = json.loads(self.recording.report or "{}")
            poses = report.get("trajectory", {}).get("estimate_poses", len(self.recording.rows))
            calls = sum(report.get("timing", {}).get(f"{n}_s", {}).get("count", 0) for n in ("localisation", "mapping"))
            done = len(self.recording.localisation) + sum(kind == "mapped" for kind, _ in self.recording.mapping)
            has_truth = "ground_truth/points" in self._publishers
            if (
                poses >= len(self.recording.rows)
                and calls >= done
                and ("map" in report or not (with_map and has_truth))
            ):
                return
            self._spin_for(COLLECT_S)

    def _subscribe(self) -> None:
        depth = QoSProfile(depth=QUEUE_DEPTH)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(Odometry, "localisation/odometry", self._on_odometry, depth)
        self._node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, depth)
        self._node.create_subscription(PointCloud2, "mapping/points", self._on_cloud, QoSProfile(depth=10))
        self._node.create_subscription(String, "metrics/report", self._on_report, latched)

    def _on_odometry(self, message: Odometry) -> None:
        self.recording.rows.append(odometry_row(message))
        self.recording.covariances[stamp_of(message)] = np.array(message.pose.covariance).reshape(6, 6)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            found = task_record(status)
            if found is None:
                if level_of(status) is Level.ERROR and status.name.endswith(": input"):
                    self._problem = f"{status.name.split(':')[0]}: {status.message}"
            elif found.task == "localisation":
                self.recording.localisation[found.record.stamp_ns] = found.record
            else:
                self.recording.mapping[found.record.state, found.record.stamp_ns] = found.record

    def _on_cloud(self, message: PointCloud2) -> None:
        self.recording.clouds.append(cloud_from_msg(message))

    def _on_report(self, message: String) -> None:
        self.recording.report = message.data

    def _answered(self, bench: str, stamp_ns: int) -> bool:
        if bench == "loc":
            return stamp_ns in self.recording.localisation and stamp_ns in self.recording.covariances
        return ("mapped", stamp_ns) in self.recording.mapping

    def _answers(self) -> int:
        recording = self.recording
        return len(recording.rows) + len(recording.localisation) + len(recording.mapping) + len(recording.clouds)

    def _await_result(self, bench: str, stamp_ns: int) -> None:
        name = {"loc": "localisation_node", "nav": "mapping_node"}[bench]

        def answered() -> bool:
            if self._problem:
                raise InputError(self._problem)
            return self._answered(bench, stamp_ns)

        def problem() -> str:
            words = self._supervisor.last_words(name)
            return f"{name} gave no result for the pair of stamp {stamp_ns} (its last words: {words})"

        self._wait_for(answered, ANSWER_TIMEOUT_S, problem)

    def _delivered(self) -> bool:
        publisher = self._initial_pose
        return bool(publisher.get_subscription_count()) and bool(publisher.wait_for_all_acked(_duration(0.05)))

    def _wait_for(self, condition: Callable[[], bool], timeout_s: float, problem: Callable[[], str]) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            self._supervisor.check()
            if time.monotonic() > deadline:
                raise NodeError(f"{problem()} within {timeout_s:g} s: look at the load of this host and start again")
            self._executor.spin_once(timeout_sec=COLLECT_S)

    def _spin_for(self, seconds: float) -> None:
        self._spin_until(time.monotonic() + seconds)
        self._supervisor.check()

    def _spin_until(self, moment: float) -> None:
        while (left := moment - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, COLLECT_S))


class _Pairs:
    """Tells when a stereo pair, with its pose where it needs one, has been published."""

    def __init__(self) -> None:
        self.complete: set[tuple[str, int]] = set()
        self._parts: dict[tuple[str, int], set[str]] = {}

    def add(self, message: Message) -> tuple[str, int] | None:
        """Take a message; return bench and stamp of the pair that it completes."""
        part = message.topic.removesuffix("/compressed")
        if not part.endswith("image_rect") and part != POSE_TOPIC:
            return None
        key = (message.bench, message.stamp_ns)
        parts = self._parts.setdefault(key, set())
        parts.add(part)
        if len(parts) < (2 if message.bench == "loc" else 3):
            return None
        del self._parts[key]
        self.complete.add(key)
        return key


class _Clock:
    """Says when a message is due; each bench begins with its first message."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._begins: dict[str, tuple[float, int]] = {}

    def due(self, message: Message) -> float:
        begin, first_ns = self._begins.setdefault(message.bench, (time.monotonic(), message.stamp_ns))
        return begin + (message.stamp_ns - first_ns) * 1e-9 / self._rate


def _type(msgtype: str) -> type[Any]:
    package, _, name = msgtype.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _duration(seconds: float) -> Any:  # noqa: ANN401 - rclpy has no types for it
    from rclpy.duration import Duration

    return Duration(seconds=seconds)

"""Records what the nodes publish while faults are injected."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.diagnostics import TOPIC, Level, level_of, values_of
from sfr_loc_map.nodes.messages.pose import odometry_row

STAMP_DIGITS = 19
"""Digits of a stamp of our time in nanoseconds; those of malformed messages differ."""
KEPT = 10


@dataclass(frozen=True, slots=True)
class NodeHealth:
    """Last health status of a node.

    Attributes:
        received_s: When it was received, monotonic seconds.
        level: Its level.
        message: Its text.
        values: Its key values.
    """

    received_s: float
    level: Level
    message: str
    values: dict[str, str]

    @property
    def dropped(self) -> dict[str, int]:
        """Messages that the node counted as dropped, by kind."""
        return {name: int(value) for name, value in self.values.items() if name.startswith("dropped_")}


class MessageRecorder:
    """Subscribes to the outputs of the nodes and keeps what it receives.

    Attributes:
        odometry: Odometry messages by stamp.
        calls: Key values of calls by node, state and stamp.
        health: Last health status by node.
        problems: Node and text of each problem with the input.
        clouds: When each cloud was received (monotonic seconds), by stamp.
        report: Last report of the monitor (JSON).
    """

    def __init__(self, node: Node) -> None:
        """Subscribe.

        Args:
            node: Node of this process.
        """
        self.odometry: dict[int, Odometry] = {}
        self.calls: dict[tuple[str, str, int], dict[str, str]] = {}
        self.health: dict[str, NodeHealth] = {}
        self.problems: list[tuple[str, str]] = []
        self.clouds: dict[int, float] = {}
        self.report: dict[str, Any] = {}
        deep = QoSProfile(depth=1000)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(Odometry, "localisation/odometry", self._on_odometry, deep)
        node.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, deep)
        node.create_subscription(PointCloud2, "mapping/points", self._on_cloud, QoSProfile(depth=10))
        node.create_subscription(String, "metrics/report", self._on_report, latched)

    @property
    def scored_poses(self) -> int:
        """Poses that the monitor has in its score."""
        return int(self.report.get("trajectory", {}).get("estimate_poses", 0))

    @property
    def last_stamp(self) -> int:
        """The latest stamp of the odometry."""
        return max(self.odometry)

    def dropped(self, node: str) -> int:
        """Return how many messages a node counted as dropped, of all kinds."""
        return sum(self.health[node].dropped.values())

    def position(self, stamp_ns: int) -> FloatArray:
        """Return the position of an odometry message, `(3,)`, metres."""
        return np.array(odometry_row(self.odometry[stamp_ns])[1])

    def forget(self) -> None:
        """Keep only the latest messages, so that this process does not grow in a long run."""
        kept: tuple[dict[Any, Any], ...] = (self.odometry, self.calls, self.clouds)
        for messages in kept:
            for key in list(messages)[:-KEPT]:
                del messages[key]

    def _on_odometry(self, message: Odometry) -> None:
        self.odometry[stamp_of(message)] = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node, _, kind = status.name.partition(": ")
            values = values_of(status)
            if kind == "call" and len(values.get("stamp_ns", "")) == STAMP_DIGITS:
                self.calls[node, values["state"], int(values["stamp_ns"])] = values
            elif kind == "health":
                self.health[node] = NodeHealth(time.monotonic(), level_of(status), status.message, values)
            elif kind == "input":
                self.problems.append((node, status.message))

    def _on_cloud(self, message: PointCloud2) -> None:
        self.clouds[stamp_of(message)] = time.monotonic()

    def _on_report(self, message: String) -> None:
        self.report = json.loads(message.data)

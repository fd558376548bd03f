"""What the nodes answer during a replay."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.diagnostics.call_reporter import task_record
from sfr_loc_map.nodes.diagnostics.key_values import TOPIC as DIAGNOSTICS
from sfr_loc_map.nodes.diagnostics.key_values import Level, level_of
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg
from sfr_loc_map.nodes.messages.pose import odometry_row
from sfr_loc_map.pipeline.call_record import CallRecord

QUEUE_DEPTH = 1000


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
        problem: What a node said of input that it cannot use, empty if none did.
        published: Bench and stamp of each pair that was published.
    """

    rows: list[tuple[int, tuple[float, ...], tuple[float, ...]]] = field(default_factory=list)
    covariances: dict[int, FloatArray] = field(default_factory=dict)
    localisation: dict[int, CallRecord] = field(default_factory=dict)
    mapping: dict[tuple[str, int], CallRecord] = field(default_factory=dict)
    clouds: list[PointCloud] = field(default_factory=list)
    report: str = ""
    problem: str = ""
    published: set[tuple[str, int]] = field(default_factory=set)

    def forget(self) -> None:
        """Begin anew: what was answered before belongs to another run."""
        for part in (self.rows, self.covariances, self.localisation, self.mapping, self.clouds, self.published):
            part.clear()
        self.report = ""

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

    def answered(self, bench: str, stamp_ns: int) -> bool:
        """Tell whether all that a pair leads to has come."""
        if bench == "loc":
            return stamp_ns in self.localisation and stamp_ns in self.covariances
        return ("mapped", stamp_ns) in self.mapping

    @property
    def answers(self) -> int:
        """How much has come."""
        return len(self.rows) + len(self.localisation) + len(self.mapping) + len(self.clouds)

    def listen(self, node: Node) -> None:
        """Subscribe."""
        depth = QoSProfile(depth=QUEUE_DEPTH)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(Odometry, "localisation/odometry", self._on_odometry, depth)
        node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, depth)
        node.create_subscription(PointCloud2, "mapping/points", self._on_cloud, QoSProfile(depth=10))
        node.create_subscription(String, "metrics/report", self._on_report, latched)

    def _on_odometry(self, message: Odometry) -> None:
        self.rows.append(odometry_row(message))
        self.covariances[stamp_of(message)] = np.array(message.pose.covariance).reshape(6, 6)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            found = task_record(status)
            if found is None:
                if level_of(status) is Level.ERROR and status.name.endswith(": input"):
                    self.problem = f"{status.name.split(':')[0]}: {status.message}"
            elif found.task == "localisation":
                self.localisation[found.record.stamp_ns] = found.record
            else:
                self.mapping[found.record.state, found.record.stamp_ns] = found.record

    def _on_cloud(self, message: PointCloud2) -> None:
        self.clouds.append(cloud_from_msg(message))

    def _on_report(self, message: String) -> None:
        self.report = message.data

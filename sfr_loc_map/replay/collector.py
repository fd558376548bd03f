"""Collect the results that the nodes of the suite publish during a replay."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from sfr_loc_map.calls.call_message import decode_call
from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import StatusKind
from sfr_loc_map.replay.message_store import Received, ReceivedCloud
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.ros.peer import Unchanged
from sfr_loc_map.ros.point_messages import cloud_from_msg
from sfr_loc_map.ros.pose_messages import covariance_of, odometry_row
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import CLOUD, DIAGNOSTICS, ESTIMATE, call_topic

QUEUE_DEPTH = 1000
"""Queue depth of poses and calls. Nodes publish one of each per pair, and no message may be lost while the replay is
busy for seconds."""
CLOUD_DEPTH = 10  #: Queue depth of clouds, of which a map has one.


class ResultCollector:
    """Subscribes to the results of the nodes and to the errors that they report.

    The poses or clouds of an external node are received by `external.external_node`. This class receives all other
    results, and all calls. `peer` is the ROS node of the replay, and `received` contains what was published and
    received.
    """

    def __init__(self, peer: ReplayPeer, received: Received) -> None:
        """Subscribe to the results, which are added to `received`."""
        self.peer = peer
        self.received = received
        self._fault: NodeError | None = None  # first internal fault that a node of the suite reports
        self._input_error: InputError | None = None  # last unusable input that a node of the suite reports
        subscribe = peer.ros_node.create_subscription
        deep = QoSProfile(depth=QUEUE_DEPTH)
        if received.external_task is not Task.LOCALISATION:
            subscribe(Odometry, ESTIMATE, self._on_odometry, deep)
        if received.external_task is not Task.MAPPING:
            subscribe(PointCloud2, CLOUD, self._on_cloud, QoSProfile(depth=CLOUD_DEPTH))
        for task in Task:
            subscribe(String, call_topic(task), partial(self._on_call, task), deep)
        subscribe(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, deep)

    def check_nodes(self) -> None:
        """Raise a NodeError if a node of the suite has ended or has reported an internal fault."""
        self.peer.supervisor.check()
        if self._fault is not None:
            raise self._fault

    def check_inputs(self) -> None:
        """Raise the last unusable input that a node of the suite has reported."""
        if self._input_error is not None:
            raise self._input_error

    def wait_while_results_arrive(self, is_complete: Callable[[], bool], quiet_s: float) -> None:
        """Wait until a condition holds, or until no result has arrived for `quiet_s`."""
        unchanged = Unchanged()

        def is_over() -> bool:
            self.check_nodes()
            return is_complete() or unchanged.seconds(self.received.count) >= quiet_s

        self.peer.spin(math.inf, is_over)

    def _on_odometry(self, message: Odometry) -> None:
        self.received.drive.add_pose(odometry_row(message), covariance_of(message))

    def _on_cloud(self, message: PointCloud2) -> None:
        cloud = cloud_from_msg(message)
        self.received.maps.add_cloud(ReceivedCloud(stamp_of(message), cloud.xyz, cloud))

    def _on_call(self, task: Task, message: String) -> None:
        try:
            call = decode_call(message.data, task)
        except InputError as error:
            if task is not self.received.external_task:
                raise
            self.received.refused_calls += 1  # an external node need not report its calls
            self.received.first_refusal = self.received.first_refusal or str(error)
            return
        self.received.of(task).add_call(call)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note an unusable input or an internal fault that a node of the suite reports."""
        for status in message.status:
            node, _, kind = status.name.rpartition(": ")
            if node not in self.peer.supervisor.processes:
                continue
            if kind == StatusKind.INPUT:
                self._input_error = InputError(f"{node}: {status.message}")
            elif kind == StatusKind.FAULT and self._fault is None:
                self._fault = NodeError(f"{node}: {status.message}")

"""Collect the results that the nodes of the suite publish during a replay."""

from __future__ import annotations

from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from sfr_loc_map.calls.call_record import decode_call
from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import StatusKind
from sfr_loc_map.replay.message_store import Received, ReceivedCloud
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.ros.messages import cloud_from_msg, covariance_of, odometry_row
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import CLOUD, DIAGNOSTICS, ESTIMATE, call_topic

QUEUE_DEPTH = 1000


class ResultCollector:
    """Subscribes to the results of the nodes and to the errors that they report.

    The poses or clouds of an external node are received by `external.ExternalNode`. This class receives all others, and
    all calls.
    """

    def __init__(self, peer: ReplayPeer, received: Received) -> None:
        """Subscribe to the results, which are added to `received`."""
        self._received = received
        self._supervisor = peer.supervisor
        self._fault: NodeError | None = None  # first internal fault that a node of the suite reports
        self._input_error: InputError | None = None  # last unusable input that a node of the suite reports
        subscribe = peer.ros_node.create_subscription
        deep = QoSProfile(depth=QUEUE_DEPTH)
        if received.external_task is not Task.LOCALISATION:
            subscribe(Odometry, ESTIMATE, self._on_odometry, deep)
        if received.external_task is not Task.MAPPING:
            subscribe(PointCloud2, CLOUD, self._on_cloud, QoSProfile(depth=10))
        for task in Task:
            subscribe(String, call_topic(task), partial(self._on_call, task), deep)
        subscribe(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, deep)

    def check_nodes(self) -> None:
        """Raise a NodeError if a node of the suite has ended or has reported an internal fault."""
        self._supervisor.check()
        if self._fault is not None:
            raise self._fault

    def check_inputs(self) -> None:
        """Raise the last unusable input that a node of the suite has reported."""
        if self._input_error is not None:
            raise self._input_error

    def _on_odometry(self, message: Odometry) -> None:
        self._received.drive.add_pose(odometry_row(message), covariance_of(message))

    def _on_cloud(self, message: PointCloud2) -> None:
        cloud = cloud_from_msg(message)
        self._received.maps.add_cloud(ReceivedCloud(stamp_of(message), cloud.xyz, cloud))

    def _on_call(self, task: Task, message: String) -> None:
        try:
            call = decode_call(message.data, task)
        except InputError as error:
            if task is not self._received.external_task:
                raise
            self._received.refuse_call(str(error))  # an external node need not report its calls
            return
        self._received.of(task).add_call(call)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note an unusable input or an internal fault that a node of the suite reports."""
        for status in message.status:
            node, _, kind = status.name.rpartition(": ")
            if node not in self._supervisor.processes:
                continue
            if kind == StatusKind.INPUT:
                self._input_error = InputError(f"{node}: {status.message}")
            elif kind == StatusKind.FAULT and self._fault is None:
                self._fault = NodeError(f"{node}: {status.message}")

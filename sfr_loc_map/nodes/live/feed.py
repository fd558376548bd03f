"""Receives what a run publishes and hands it to a `Hub`, in a thread of its own.

Small messages are subscribed to always; images, feature tracks and clouds only while a page looks at them. Image
messages are dropped as bytes, undecoded, beyond the rate that is shown.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import PurePosixPath
from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import try_shutdown
from std_msgs.msg import String

from sfr_loc_map.errors import SfrError
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.updates import (
    LOCALISATION,
    REPORT,
    TRUTH,
    GraphView,
    PoseSample,
    Report,
    Status,
    StatusKind,
    Track,
    Update,
)
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.diagnostics import TOPIC, level_of, values_of
from sfr_loc_map.nodes.environment import start_ros
from sfr_loc_map.nodes.live.media_feed import NO_EVENTS, MediaFeed
from sfr_loc_map.nodes.live.operator import RosOperator
from sfr_loc_map.nodes.messages.pose import covariance_of, odometry_row
from sfr_loc_map.nodes.processes import page_node_name
from sfr_loc_map.pipeline.reception import TransportGaps

SUITE_NODES = frozenset({"localisation_node", "mapping_node", "monitor_node"})
KINDS = frozenset(kind.value for kind in StatusKind)
DEPTH = 200
GRAPH_PERIOD_S = 0.5
SPIN_S = 0.1


class RosFeed:
    """A ROS node that receives for a page; a context manager that runs its thread."""

    def __init__(self, hub: Hub, namespace: str = "") -> None:
        """Join the graph; signals stay with the program.

        Args:
            hub: Takes what is received.
            namespace: Of the rover.
        """
        environment.prepare()
        start_ros()
        self._hub = hub
        self._space = namespace.strip("/")
        self._node: Node = rclpy.create_node(
            page_node_name(os.getpid()), namespace=f"/{self._space}", start_parameter_services=False
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._gaps: dict[str, TransportGaps] = {}
        self._media = MediaFeed(self._node, hub)
        hub.operator = RosOperator(self._node)
        self._subscribe()
        self._node.create_timer(GRAPH_PERIOD_S, self._look_around)
        self._running = True
        self._thread = Thread(target=self._spin, name="sfr-live-ros", daemon=True)

    def __enter__(self) -> RosFeed:
        """Start to receive."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph."""
        self._running = False
        self._thread.join(5.0)
        self._media.close()
        self._node.destroy_node()
        try_shutdown()

    def _spin(self) -> None:
        while self._running:
            try:
                self._executor.spin_once(timeout_sec=SPIN_S)
            except Exception as error:  # of one message; the page must not stop for it
                if self._running:
                    self._node.get_logger().error(f"live: {error!r}", throttle_duration_sec=5.0)

    def _subscribe(self) -> None:
        best_effort = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for track, topic in ((Track.ESTIMATE, LOCALISATION), (Track.TRUTH, TRUTH)):
            self._receive(Odometry, topic, partial(self._on_odometry, track), best_effort)
        self._receive(DiagnosticArray, TOPIC, self._on_diagnostics, best_effort)
        self._receive(String, REPORT, self._on_report, latched)

    def _receive(self, kind: type[Any], topic: str, callback: Callable[[Any, float], None], qos: QoSProfile) -> None:
        gaps = TransportGaps()
        if kind is not DiagnosticArray:  # which has many publishers
            self._gaps[topic] = gaps

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - any message
            gaps.add(info)
            try:
                callback(message, time.time())
            except (SfrError, ValueError):  # the monitor reports broken messages; the page shows what can be shown
                return

        listener: Any = received  # rclpy's types do not know of the information beside a message
        self._node.create_subscription(kind, topic, listener, qos, event_callbacks=NO_EVENTS)

    def _on_odometry(self, track: Track, message: Odometry, now_s: float) -> None:
        stamp_ns, position, quat = odometry_row(message)
        covariance = covariance_of(message) if track is Track.ESTIMATE else None
        self._put(PoseSample(track, stamp_ns, position, quat, now_s, covariance))

    def _on_diagnostics(self, message: DiagnosticArray, now_s: float) -> None:
        for status in message.status:
            full_name, _, kind = status.name.partition(": ")
            name = PurePosixPath("/" + full_name)
            if str(name.parent).strip("/") != self._space or kind not in KINDS or name.name not in SUITE_NODES:
                continue
            level, values = int(level_of(status)), values_of(status)
            self._put(Status(name.name, StatusKind(kind), level, status.message, values, now_s))

    def _on_report(self, message: String, now_s: float) -> None:
        self._put(Report(message.data, now_s))

    def _look_around(self) -> None:
        """Find out which nodes are there, and receive images and clouds as the pages want."""
        self._media.follow(self._hub.wanted)
        names = self._node.get_node_names_and_namespaces()
        nodes = frozenset(name for name, space in names if space.strip("/") == self._space) & SUITE_NODES
        lost = {topic: gaps.lost for topic, gaps in (self._gaps | self._media.gaps).items()}
        self._put(GraphView(nodes, time.time(), lost))

    def _put(self, update: Update) -> None:
        self._hub.put(update)

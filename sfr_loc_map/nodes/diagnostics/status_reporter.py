"""What a node reports of itself: health and unusable input on /diagnostics, errors and warnings in the log."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.timer import Timer

from sfr_loc_map.inputs import one_line
from sfr_loc_map.nodes.diagnostics.call_reporter import Call
from sfr_loc_map.nodes.diagnostics.health import Health, HealthConfig, NodeActivity
from sfr_loc_map.nodes.diagnostics.key_values import TOPIC, Level, Value, array_msg, status_msg
from sfr_loc_map.nodes.messages.fields import header_msg

QUEUE_DEPTH = 1000
"""Statuses that are kept for a slow subscriber."""
WARN_PERIOD_S = 5.0


class StatusReporter:
    """Reports the health and the problems of one node. All methods may be called in any thread.

    Attributes:
        health: The health.
        publisher: Of /diagnostics; it is there in every state.
    """

    def __init__(self, node: Node, task: str, config: HealthConfig, activity: Callable[[], NodeActivity]) -> None:
        """Publish the health periodically.

        Args:
            node: The node.
            task: `localisation`, `mapping` or `monitor`.
            config: What is a warning, and how often the health is published.
            activity: Returns what the node does at the moment.
        """
        self._node, self._task, self._activity = node, task, activity
        self._last_kind: tuple[str, ...] = ()
        self.health = Health(config)
        self.publisher = node.create_publisher(DiagnosticArray, TOPIC, QoSProfile(depth=QUEUE_DEPTH))
        self._timer = self._start_timer(config.period_s)

    def set_config(self, config: HealthConfig) -> None:
        """Judge the health by other limits, and publish it with another period."""
        self.health.set_config(config)
        self._node.destroy_timer(self._timer)
        self._timer = self._start_timer(config.period_s)

    def error(self, text: str) -> None:
        """Report something that keeps the node from working: log, /diagnostics, health."""
        text = one_line(text)
        self._node.get_logger().error(text, throttle_duration_sec=WARN_PERIOD_S)
        self.health.note_problem(Level.ERROR, text)
        self._publish("input", Level.ERROR, text, {"task": self._task, **self._activity().counts})
        self.publish_health(only_changes=True)

    def warn(self, text: str, kind: str = "") -> None:
        """Report something that is not as it should be, though the node works: log, health.

        Args:
            text: What it is.
            kind: Where given, health names the latest of that kind only.
        """
        text = one_line(text)
        self._node.get_logger().warning(text, throttle_duration_sec=WARN_PERIOD_S)
        self.health.note_problem(Level.WARN, text, kind)
        self.publish_health(only_changes=True)

    def note_call(self, call: Call, took: Mapping[str, Value]) -> None:
        """Note a call in the health, with its times and memory by name."""
        self.health.note_call(call.level, call.result, took, call.statistics)
        self.publish_health(only_changes=True)

    def publish_health(self, *, only_changes: bool = False) -> None:
        """Publish the health, if wanted only when more than figures has changed."""
        status = self.health.judge(self._activity())
        if only_changes and status.kind == self._last_kind:
            return
        self._last_kind = status.kind
        self._publish("health", status.level, status.message, status.values)

    def _start_timer(self, period_s: float) -> Timer:
        return self._node.create_timer(period_s, self.publish_health, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self, name: str, level: Level, message: str, values: Mapping[str, Value]) -> None:
        status = status_msg(f"{self._node.get_fully_qualified_name().lstrip('/')}: {name}", level, message, values)
        self.publisher.publish(array_msg(header_msg(self._node.get_clock().now().nanoseconds, ""), status))

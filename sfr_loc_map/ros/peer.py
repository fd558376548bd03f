"""The node of a program that observes the graph or takes part in it, beside the nodes of the suite."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, Self

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.utilities import try_shutdown

from sfr_loc_map.ros import environment
from sfr_loc_map.ros.transport import TransportGaps, begin_counting

POLL_S = 0.05  #: Period at which conditions are checked, s.
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)


class Unchanged:
    """Measures for how long a value has not changed."""

    def __init__(self) -> None:
        """Start with an unknown value."""
        self._value: object = None
        self._since_s = time.monotonic()

    def seconds(self, value: object) -> float:
        """Return the time for which the value has been the same at each call, s."""
        now_s = time.monotonic()
        if value != self._value:
            self._value, self._since_s = value, now_s
        return now_s - self._since_s


class Peer:
    """A ROS node with an executor, which the owner spins; a context manager that leaves the graph and ends ROS."""

    def __init__(self, name: str, namespace: str = "", *, parameters: bool = False, remaps: Sequence[str] = ()) -> None:
        """Join the graph, with parameter services if `parameters`. ROS installs no signal handlers.

        `remaps` are ROS rules `FROM:=TO` for the topics of this node.
        """
        environment.see_whole_graph()
        environment.start_ros()
        words = ["--ros-args", *(word for remap in remaps for word in ("-r", remap))] if remaps else None
        self.ros_node: Node = rclpy.create_node(
            name, namespace=namespace, cli_args=words, start_parameter_services=parameters
        )
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.ros_node)
        self.message_counts: dict[str, TransportGaps] = {}  # by topic, filled by `count_messages`

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.ros_node.destroy_node()
        try_shutdown()

    def spin(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Spin for a given time or until a condition holds; return whether the condition holds."""
        end = time.monotonic() + seconds
        while not until() and (left := end - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=min(left, POLL_S))
        return until()

    def count_messages(self, topic: str) -> TransportGaps:
        """Return the counter of the messages of a topic, to which a new subscription adds its message infos."""
        return begin_counting(self.message_counts, topic)

    def count_losses(self) -> dict[str, int]:
        """Return the number of lost messages of each counted topic.

        Losses are not counted while a topic has several publishers. Publishers may appear or leave at any time, so this
        method must be called repeatedly.
        """
        for topic, gaps in self.message_counts.items():
            gaps.set_several(self.ros_node.count_publishers(self.ros_node.resolve_topic_name(topic)) > 1)
        return {topic: gaps.lost for topic, gaps in self.message_counts.items()}

    def subscribe(
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[[Any, dict[str, Any]], None],
        qos: QoSProfile,
        *,
        raw: bool = False,
    ) -> Subscription:
        """Subscribe with a callback that receives each message, serialised if `raw`, and its message info.

        Incompatible peers are not reported, because the nodes of the suite report them, and because each event type
        costs the executor time.
        """
        listener: Any = callback  # rclpy's types lack the message info
        return self.ros_node.create_subscription(kind, topic, listener, qos, event_callbacks=NO_EVENTS, raw=raw)

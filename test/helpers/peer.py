"""A ROS node in the process of a test, which publishes to the nodes under test and receives their messages."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from helpers.processes import PATIENCE_S, Process

ASK_AGAIN_S = 3.0


class Peer:
    """A node in the process of a test. `until` and `spin` execute its callbacks."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.node = rclpy.create_node("peer")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.qos: Any = 50
        """Quality of service of new publishers."""
        self._publishers: dict[str, Any] = {}
        self._watched: list[Process] = []

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.node.destroy_node()

    def listen(self, kind: type[Any], topic: str, *, latched: bool = False) -> list[Any]:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        qos, taken = QoSProfile(depth=100), list[Any]()
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.node.create_subscription(kind, topic, taken.append, qos)
        return taken

    def publish(self, kind: type[Any], topic: str, message: Any, *, arrival: bool = False) -> None:
        """Publish a message or its serialised form as soon as the topic has a subscription.

        Messages on different topics arrive in any order. With `arrival`, wait until this message was received.
        """
        from rclpy.duration import Duration

        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind, topic, self.qos)
        publisher = self._publishers[topic]
        self.until(lambda: publisher.get_subscription_count() > 0, f"a listener on {topic}")
        publisher.publish(message)
        if arrival:
            publisher.wait_for_all_acked(Duration(seconds=5))

    def call(self, service: str) -> Any:
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, service)
        return self.answer(client, Trigger.Request(), again=False)

    def answer(self, client: Any, request: Any, *, again: bool) -> Any:
        """Return the response of a service; with `again`, repeat a request that was lost during discovery."""
        self.until(client.service_is_ready, f"service {client.srv_name}")
        futures = [client.call_async(request)]
        asked = time.monotonic()

        def answered() -> Any:
            if again and time.monotonic() - asked > ASK_AGAIN_S * len(futures):
                futures.append(client.call_async(request))
            return next((future for future in futures if future.done()), None)

        return self.until(answered, f"answer of {client.srv_name}").result()

    def wait_until_known_to(self, node: str) -> None:
        """Wait until a node has discovered all subscriptions of this peer, so that no message is missed.

        Subscriptions are announced in the order of their creation; that of the response is the last.
        """
        from rcl_interfaces.srv import ListParameters

        client = self.node.create_client(ListParameters, f"{node}/list_parameters")
        self.answer(client, ListParameters.Request(), again=True)

    def until(self, condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
        deadline = time.monotonic() + patience_s
        while not (found := condition()):
            said = "".join(f"\n{process.text}" for process in self._watched)
            assert time.monotonic() < deadline, f"{what} did not come within {patience_s} s{said}"
            self.executor.spin_once(timeout_sec=0.05)
        return found

    def watch(self, process: Process) -> None:
        """Add the output of a process to the error of a wait that fails."""
        self._watched.append(process)

    def spin(self, seconds: float, is_over: Callable[[], bool] = lambda: False) -> None:
        """Execute callbacks for some time, or until a condition holds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not is_over():
            self.executor.spin_once(timeout_sec=0.02)

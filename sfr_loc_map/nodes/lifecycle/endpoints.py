"""Publishers, subscriptions, timers and services of a managed node, created and destroyed with its states."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from copy import copy
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_srvs.srv import Trigger

from sfr_loc_map.errors import ConfigError

Answer = tuple[bool, str]  #: Success and message of a std_srvs/Trigger.
RELIABILITIES = ("reliable", "best_effort")
WAITING_REQUESTS = 1000
"""Requests of a service that wait behind the jobs of the worker; the 10 of ROS are gone within a long call."""


def profile(reliability: str, depth: int) -> QoSProfile:
    """Return a volatile profile of one of `RELIABILITIES` that keeps the last `depth` messages."""
    policy = ReliabilityPolicy.RELIABLE if reliability == "reliable" else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, reliability=policy)


class Endpoints:
    """Creates what a node receives and sends by; each endpoint lives as long as the state that it belongs to.

    Publishers belong to the configured node, subscriptions and timers to the active one. A service, once created,
    stays: an answer may be under way.
    """

    def __init__(self, node: LifecycleNode, reliability: str, warn: Callable[[str], None]) -> None:
        """Create none yet; `warn` is called when a peer has an incompatible quality of service."""
        self.reliability = reliability
        self._node, self._warn = node, warn
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._service_group = MutuallyExclusiveCallbackGroup()
        self._at_deactivate: list[Callable[[], object]] = []
        self._at_cleanup: list[Callable[[], object]] = []
        self._subscribed: list[str] = []
        self._published: list[str] = []
        self._served: list[str] = []

    def add_publisher(self, kind: type[Any], topic: str, depth: int, *, latched: bool = False) -> Any:  # noqa: ANN401
        """Return a publisher that sends only while the node is active."""
        full_name = self._node.resolve_topic_name(topic)

        def incompatible(event: Any) -> None:  # noqa: ANN401 - rclpy's
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self._warn(
                f"a subscriber of {full_name} requests more {policy} than this node offers, nothing is sent to it: "
                f"change the subscriber, or the parameter output_reliability of this node"
            )

        qos = profile(self.reliability, depth)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        # of another type the subscriber tells, and each event costs the executor time at every message
        events = PublisherEventCallbacks(incompatible_qos=incompatible, use_default_callbacks=False)
        publisher = self._node.create_lifecycle_publisher(kind, topic, qos, event_callbacks=events)
        self._at_cleanup.append(lambda: self._node.destroy_lifecycle_publisher(publisher))
        self._published.append(publisher.topic_name)
        return publisher

    def add_subscription(self, kind: type[Any], topic: str, callback: Callable[..., None], qos: QoSProfile) -> None:
        """Subscribe until the node is deactivated; parameters `qos_overrides.TOPIC.subscription.POLICY` override."""
        full_name = self._node.resolve_topic_name(topic)
        prefix = f"qos_overrides.{full_name}.subscription."

        def incompatible(event: Any) -> None:  # noqa: ANN401 - rclpy's
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self._warn(
                f"a publisher of {full_name} offers less {policy} than this node requests, nothing is received from "
                f"it: set the parameter {prefix}{policy.lower()} to what it offers, or change the publisher"
            )

        # only those given: a parameter, once declared, would keep the default of this activation
        given = [policy for policy in QoSPolicyKind if prefix + policy.name.lower() in self._node._parameter_overrides]
        try:
            subscription = self._node.create_subscription(
                kind,
                topic,
                callback,
                copy(qos),  # which the overrides are written into
                event_callbacks=SubscriptionEventCallbacks(incompatible_qos=incompatible),
                qos_overriding_options=QoSOverridingOptions(given),
            )
        except Exception as error:  # for a wrong value rclpy raises what it likes
            if not given:
                raise
            raise ConfigError(f"parameters {prefix}*: {error!r}") from error
        self._at_deactivate.append(lambda: self._node.destroy_subscription(subscription))
        self._subscribed.append(subscription.topic_name)

    def add_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call back periodically, by a clock that does not jump, until the node is deactivated."""
        timer = self._node.create_timer(period_s, callback, clock=self._clock)
        self._at_deactivate.append(lambda: self._node.destroy_timer(timer))

    def add_service(self, name: str, answer: Callable[[], Awaitable[Answer]]) -> None:
        """Offer a std_srvs/Trigger; other callbacks run while its answer is awaited."""
        name = self._node.resolve_service_name(name)
        self._served.append(name)
        if any(service.srv_name == name for service in self._node.services):
            return

        async def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = await answer()
            return response

        qos = QoSProfile(depth=WAITING_REQUESTS)
        self._node.create_service(Trigger, name, serve, qos_profile=qos, callback_group=self._service_group)

    def at_deactivate(self, action: Callable[[], object]) -> None:
        """Do something when the node is deactivated."""
        self._at_deactivate.append(action)

    def destroy_active(self) -> None:
        """Destroy what only an active node has."""
        for action in self._at_deactivate:
            action()
        for kept in (self._at_deactivate, self._subscribed, self._served):
            kept.clear()

    def destroy_configured(self) -> None:
        """Destroy what a configured node has."""
        for action in self._at_cleanup:
            action()
        self._at_cleanup.clear()
        self._published.clear()

    def summary(self, *always_published: str) -> str:
        """Return all names in one line."""
        published = ", ".join([*always_published, *self._published])
        return f"listens to {', '.join(self._subscribed)}; publishes {published}; offers {', '.join(self._served)}"

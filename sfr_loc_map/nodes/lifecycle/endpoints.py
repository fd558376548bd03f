"""Publishers, subscriptions, timers and services of a managed node, created and destroyed with its states.

Each subscription may be set on its own by the parameters that ROS has for it: `qos_overrides.TOPIC.subscription.POLICY`
with the policies reliability, durability, history and depth (docs.ros.org, "Quality of Service settings").
"""

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
POLICY_WORDS: dict[QoSPolicyKind, tuple[str, ...]] = {
    QoSPolicyKind.RELIABILITY: RELIABILITIES,
    QoSPolicyKind.DURABILITY: ("volatile", "transient_local"),
    QoSPolicyKind.HISTORY: ("keep_last", "keep_all"),
    QoSPolicyKind.DEPTH: (),
}
"""Policies that a parameter may set, and their words; the depth is a number."""
MAX_DEPTH = 100_000
OVERRIDES = "qos_overrides."  #: Beginning of the names of these parameters.
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

    Attributes:
        reliability: Offered by all publishers; one of `RELIABILITIES`.
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
        """Subscribe until the node is deactivated; parameters of the node may override the quality of service."""
        full_name = self._node.resolve_topic_name(topic)

        def incompatible(event: Any) -> None:  # noqa: ANN401 - rclpy's
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self._warn(
                f"a publisher of {full_name} offers less {policy} than this node requests, nothing is received from "
                f"it: set the parameter {OVERRIDES}{full_name}.subscription.{policy.lower()} to what it offers "
                f"(best_effort and volatile match all), or change the publisher"
            )

        subscription = self._node.create_subscription(
            kind,
            topic,
            callback,
            copy(qos),  # which the overrides are written into
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=incompatible),
            qos_overriding_options=QoSOverridingOptions(self._overridden(full_name)),
        )
        self._at_deactivate.append(lambda: self._node.destroy_subscription(subscription))
        self._subscribed.append(subscription.topic_name)

    def _overridden(self, topic: str) -> list[QoSPolicyKind]:
        """Return those policies of a subscription that the node has parameters for.

        Others stay undeclared: a parameter, once declared, would keep the default of this activation.
        """
        given = []
        for policy, words in POLICY_WORDS.items():
            parameter = self._node._parameter_overrides.get(_parameter_name(topic, policy))
            if parameter is None:
                continue
            given.append(policy)
            is_depth = not words and type(parameter.value) is int and 1 <= parameter.value <= MAX_DEPTH
            if parameter.value not in words and not is_depth:
                wanted = f"one of {', '.join(words)}" if words else f"a whole number of 1 .. {MAX_DEPTH}"
                raise ConfigError(f"'{parameter.name}' is {parameter.value!r}: must be {wanted}")
        return given

    def unused_overrides(self) -> list[str]:
        """Return the parameters of quality of service that belong to no subscription."""
        known = {_parameter_name(topic, policy) for topic in self._subscribed for policy in POLICY_WORDS}
        names = self._node._parameter_overrides
        return sorted(name for name in names if name.startswith(OVERRIDES) and name not in known)

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


def _parameter_name(topic: str, policy: QoSPolicyKind) -> str:
    return f"{OVERRIDES}{topic}.subscription.{policy.name.lower()}"

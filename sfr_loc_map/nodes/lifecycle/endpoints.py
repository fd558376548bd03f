"""Publishers, subscriptions and timers of a managed node, which are destroyed when their lifecycle state ends."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from copy import copy
from functools import wraps
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.issues import Issue
from sfr_loc_map.ros.publishers import name_to_subscribe, publishers_of, resolved_name
from sfr_loc_map.ros.qos import LATCHED, profile
from sfr_loc_map.transport_issues import Publisher, doubled_publishers


class Endpoints:
    """Creates the endpoints of a node, and destroys them when their lifecycle state ends.

    Publishers exist while the node is configured, subscriptions and timers while it is active.
    """

    def __init__(
        self,
        node: LifecycleNode,
        reliability: str,
        *,
        warn: Callable[[str], None],
        on_fault: Callable[[Exception], None],
    ) -> None:
        """Set the reliability of publishers.

        `warn` is called when a peer has an incompatible quality of service, `on_fault` with an exception of a callback.
        """
        self.reliability = reliability
        self._node, self._warn, self._on_fault = node, warn, on_fault
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.configured, self.active = ExitStack(), ExitStack()  # closed when the state ends
        self._of_one_publisher: dict[Any, str] = {}  # topics of the subscriptions that require one publisher

    def add_publisher(self, kind: type[Any], topic: str, depth: int, *, latched: bool = False) -> Any:  # noqa: ANN401
        """Return a publisher that sends only while the node is active."""
        incompatible = self._warning(
            f"a subscriber of {self._node.resolve_topic_name(topic)} requests stricter {{}} than this node offers, so "
            f"it receives nothing: change the subscriber{{own}}"
        )
        qos = profile(self.reliability, depth)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        # A subscriber reports a wrong type itself, and each event type costs the executor time at every message.
        events = PublisherEventCallbacks(incompatible_qos=incompatible, use_default_callbacks=False)
        publisher = self._node.create_lifecycle_publisher(kind, topic, qos, event_callbacks=events)
        self.configured.callback(self._node.destroy_lifecycle_publisher, publisher)
        return publisher

    def add_subscription(
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[..., None],
        qos: QoSProfile,
        *,
        of_one_publisher: bool = True,
    ) -> Callable[[], object]:
        """Subscribe until the node is deactivated or the returned function is called.

        `of_one_publisher` states whether the messages of several publishers must not be mixed (`doubled`).
        Parameters `qos_overrides.TOPIC.subscription.POLICY` override the quality of service.
        """
        full_name = self.full_name(topic)
        prefix = f"qos_overrides.{full_name}.subscription."
        incompatible = self._warning(
            f"a publisher of {full_name} offers weaker {{}} than this node requests, so nothing is received from "
            f"this publisher: set the parameter {prefix}{{parameter}} to the offered value, or change the publisher"
        )
        # Only the overrides that are set are passed: rclpy would declare the others and keep the default of this
        # activation.
        given = [policy for policy in QoSPolicyKind if self._node.has_parameter(prefix + policy.name.lower())]
        try:
            subscription = self._node.create_subscription(
                kind,
                name_to_subscribe(self._node, topic),
                self.guarded(callback),
                copy(qos),  # rclpy writes the overrides into the profile
                event_callbacks=SubscriptionEventCallbacks(incompatible_qos=incompatible),
                qos_overriding_options=QoSOverridingOptions(given),
            )
        except Exception as error:  # rclpy raises various types for a wrong value
            if not given:
                raise
            raise ConfigError(f"parameters {prefix}*: {error!r}") from error
        if of_one_publisher:
            self._of_one_publisher[subscription] = full_name

        def unsubscribe() -> None:
            self._of_one_publisher.pop(subscription, None)
            self._node.destroy_subscription(subscription)

        self.active.callback(unsubscribe)
        return unsubscribe

    def add_latched(self, kind: type[Any], topic: str, callback: Callable[..., None]) -> None:
        """Subscribe to latched messages of a topic that also has a volatile subscription.

        Messages that are sent later arrive twice, once by each subscription. Only the volatile subscription reports
        publishers with incompatible quality of service.
        """
        subscription = self._node.create_subscription(
            kind,
            topic,
            self.guarded(callback),
            LATCHED,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )
        self.active.callback(self._node.destroy_subscription, subscription)

    def full_name(self, topic: str) -> str:
        """Return the full name of a topic to which the node subscribes, given by its relative name."""
        return resolved_name(self._node, topic)

    def publishers(self, topic: str) -> tuple[Publisher, ...]:
        """Return the publishers of a topic, given by its relative name."""
        return publishers_of(self._node, self.full_name(topic))

    def doubled(self) -> list[Issue]:
        """Return an issue for each topic that requires one publisher, but has several now."""
        topics = dict.fromkeys(self._of_one_publisher.values())
        found = [doubled_publishers(topic, publishers_of(self._node, topic)) for topic in topics]
        return [issue for issue in found if issue is not None]

    def add_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call a function periodically, on a steady clock, until the node is deactivated."""
        timer = self._node.create_timer(period_s, self.guarded(callback), clock=self._clock)
        self.active.callback(self._node.destroy_timer, timer)

    def guarded(self, callback: Callable[..., None]) -> Callable[..., None]:
        """Return a callback whose exceptions are reported; in the executor, they would end the process."""

        @wraps(callback)  # rclpy derives from the signature whether the callback requires the info of a message
        def guarded(*arguments: Any) -> None:  # noqa: ANN401 - rclpy's
            try:
                callback(*arguments)
            except Exception as error:
                self._on_fault(error)

        return guarded

    def _warning(self, text: str) -> Callable[[Any], None]:
        """Return a callback that warns of an incompatible peer; `text` has fields for the policy and its parameter.

        The field `own` is the parameter of this node that sets a policy of its publishers, if there is one.
        """

        def warn(event: Any) -> None:  # noqa: ANN401 - rclpy's
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            own = ", or the parameter output_reliability of this node" if policy == "RELIABILITY" else ""
            self._warn(text.format(policy, parameter=policy.lower(), own=own))

        return warn

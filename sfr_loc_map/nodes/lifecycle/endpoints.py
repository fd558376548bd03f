"""Publishers, subscriptions, timers and services of a managed node, created and destroyed with its states."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from copy import copy
from functools import partial
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.ros.publishers import node_of
from sfr_loc_map.nodes.ros.qos import LATCHED, profile


class Endpoints:
    """Creates what a node receives and sends by; each endpoint lives as long as the state that it belongs to.

    Publishers belong to the configured node, subscriptions and timers to the active one.
    """

    def __init__(self, node: LifecycleNode, reliability: str, warn: Callable[[str], None]) -> None:
        """Create none yet; `warn` is called when a peer has an incompatible quality of service."""
        self.reliability = reliability
        self._node, self._warn = node, warn
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.configured, self.active = ExitStack(), ExitStack()  # what is closed when a state ends

    def add_publisher(self, kind: type[Any], topic: str, depth: int, *, latched: bool = False) -> Any:  # noqa: ANN401
        """Return a publisher that sends only while the node is active."""
        incompatible = self._warning(
            f"a subscriber of {self._node.resolve_topic_name(topic)} requests more {{}} than this node offers, nothing "
            f"is sent to it: change the subscriber, or the parameter output_reliability of this node"
        )
        qos = profile(self.reliability, depth)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        # of another type the subscriber tells, and each event costs the executor time at every message
        events = PublisherEventCallbacks(incompatible_qos=incompatible, use_default_callbacks=False)
        publisher = self._node.create_lifecycle_publisher(kind, topic, qos, event_callbacks=events)
        self.configured.callback(self._node.destroy_lifecycle_publisher, publisher)
        return publisher

    def add_subscription(
        self, kind: type[Any], topic: str, callback: Callable[..., None], qos: QoSProfile
    ) -> Callable[[], object]:
        """Subscribe until the node is deactivated or what is returned is called.

        Parameters `qos_overrides.TOPIC.subscription.POLICY` override the quality of service.
        """
        full_name = self._node.resolve_topic_name(topic)
        prefix = f"qos_overrides.{full_name}.subscription."
        incompatible = self._warning(
            f"a publisher of {full_name} offers less {{}} than this node requests, nothing is received from it: set "
            f"the parameter {prefix}{{parameter}} to what it offers, or change the publisher"
        )
        # only those that are given: one that rclpy declares would keep the default of this activation
        given = [policy for policy in QoSPolicyKind if self._node.has_parameter(prefix + policy.name.lower())]
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
        self.active.callback(self._node.destroy_subscription, subscription)
        return partial(self._node.destroy_subscription, subscription)

    def add_latched(self, kind: type[Any], topic: str, callback: Callable[..., None]) -> None:
        """Subscribe to what a publisher has latched."""
        subscription = self._node.create_subscription(
            kind, topic, callback, LATCHED, event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False)
        )
        self.active.callback(self._node.destroy_subscription, subscription)

    def is_latched(self, topic: str) -> bool:
        """Return whether a publisher of a topic keeps its last message for subscribers that come later."""
        found = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        return any(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in found)

    def publishing_nodes(self, topic: str) -> list[str]:
        """Return the names of the nodes that publish a topic, one for each publisher."""
        found = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(topic))
        return [node_of(info) for info in found]

    def add_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call back periodically, by a clock that does not jump, until the node is deactivated."""
        timer = self._node.create_timer(period_s, callback, clock=self._clock)
        self.active.callback(self._node.destroy_timer, timer)

    def _warning(self, text: str) -> Callable[[Any], None]:
        """Return what warns of an incompatible peer by a text with places for the policy and its parameter."""

        def warn(event: Any) -> None:  # noqa: ANN401 - rclpy's
            policy = qos_policy_name_from_kind(event.last_policy_kind)
            self._warn(text.format(policy, parameter=policy.lower()))

        return warn

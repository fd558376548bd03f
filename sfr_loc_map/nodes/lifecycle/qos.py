"""Quality of service: profiles from parameters, and warnings about incompatible peers.

Each subscription may be set on its own by the parameters that ROS has for it: `qos_overrides.TOPIC.subscription.POLICY`
with the policies reliability, durability, history and depth (docs.ros.org, "Quality of Service settings").
"""

from __future__ import annotations

from collections.abc import Callable, Collection

from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind
from rclpy.qos_overriding_options import QoSOverridingOptions

from sfr_loc_map.errors import ConfigError

RELIABILITIES = ("reliable", "best_effort")
POLICY_WORDS: dict[QoSPolicyKind, tuple[str, ...]] = {
    QoSPolicyKind.RELIABILITY: RELIABILITIES,
    QoSPolicyKind.DURABILITY: ("volatile", "transient_local"),
    QoSPolicyKind.HISTORY: ("keep_last", "keep_all"),
    QoSPolicyKind.DEPTH: (),
}
"""Policies that a parameter may set, and their words; the depth is a number."""
MAX_DEPTH = 100_000
OVERRIDES = "qos_overrides."
"""Beginning of the names of these parameters."""
Warn = Callable[[str], None]


def profile(reliability: str, depth: int) -> QoSProfile:
    """Return a volatile profile that keeps the last `depth` messages.

    Args:
        reliability: One of `RELIABILITIES`.
        depth: Messages.
    """
    reliable = reliability == "reliable"
    policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, reliability=policy)


def overriding_options(node: Node, topic: str) -> QoSOverridingOptions:
    """Return the options by which ROS sets those policies of a subscription that the node has parameters for.

    Other policies stay undeclared: a parameter, once declared, would keep the default of this activation.

    Args:
        node: The node.
        topic: Resolved name.

    Raises:
        ConfigError: If a value is none of its policy.
    """
    given: list[QoSPolicyKind] = []
    for policy, words in POLICY_WORDS.items():
        parameter = node._parameter_overrides.get(_parameter_name(topic, policy))
        if parameter is None:
            continue
        given.append(policy)
        is_depth = type(parameter.value) is int and 1 <= parameter.value <= MAX_DEPTH
        if parameter.value not in words and not (not words and is_depth):
            wanted = f"one of {', '.join(words)}" if words else f"a whole number of 1 .. {MAX_DEPTH}"
            raise ConfigError(f"'{parameter.name}' is {parameter.value!r}: must be {wanted}")
    return QoSOverridingOptions(given)


def unused_overrides(node: Node, topics: Collection[str]) -> list[str]:
    """Return the parameters of quality of service that belong to no subscription.

    Args:
        node: The node.
        topics: Resolved names of what it subscribes to.
    """
    known = {_parameter_name(topic, policy) for topic in topics for policy in POLICY_WORDS}
    return sorted(name for name in node._parameter_overrides if name.startswith(OVERRIDES) and name not in known)


def _parameter_name(topic: str, policy: QoSPolicyKind) -> str:
    return f"{OVERRIDES}{topic}.subscription.{policy.name.lower()}"


def subscription_events(topic: str, warn: Warn) -> SubscriptionEventCallbacks:
    """Return callbacks that warn of publishers with an incompatible profile."""

    def incompatible(event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        warn(
            f"a publisher of {topic} offers less {policy} than this node requests, nothing is received from it: set "
            f"the parameter {OVERRIDES}{topic}.subscription.{policy.lower()} to what it offers (best_effort and "
            f"volatile match all), or change the publisher"
        )

    return SubscriptionEventCallbacks(incompatible_qos=incompatible)


def publisher_events(topic: str, warn: Warn) -> PublisherEventCallbacks:
    """Return callbacks that warn of subscribers with an incompatible profile."""

    def incompatible(event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        warn(
            f"a subscriber of {topic} requests more {policy} than this node offers, nothing is sent to it: change the "
            f"subscriber, or the parameter output_reliability of this node"
        )

    # of another type the subscriber tells, and each event costs the executor time at every message
    return PublisherEventCallbacks(incompatible_qos=incompatible, use_default_callbacks=False)

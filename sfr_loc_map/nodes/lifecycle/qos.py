"""Quality of service: profiles from parameters, and warnings about incompatible peers."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind

RELIABILITIES = ("reliable", "best_effort")
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


def subscription_events(topic: str, warn: Warn) -> SubscriptionEventCallbacks:
    """Return callbacks that warn of publishers with an incompatible profile."""

    def incompatible(event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        warn(
            f"a publisher of {topic} offers less {policy} than this node requests, nothing is received from it: set "
            f"the parameter of this node to that of the publisher (best_effort matches both), or change the publisher"
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

    return PublisherEventCallbacks(incompatible_qos=incompatible)

"""Quality of service: what the parameters ask for, and a plain word where the other side offers less."""

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
    """Return callbacks that tell of publishers from which nothing can be received."""

    def incompatible(event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        warn(
            f"a publisher of {topic} offers less {policy} than this node asks for, nothing is received from it: set "
            f"this node's parameter for it to the publisher's (best_effort takes both kinds), or the publisher's"
        )

    return SubscriptionEventCallbacks(incompatible_qos=incompatible)


def publisher_events(topic: str, warn: Warn) -> PublisherEventCallbacks:
    """Return callbacks that tell of subscribers to which nothing can be sent."""

    def incompatible(event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        warn(
            f"a subscriber of {topic} asks for more {policy} than this node offers, nothing is sent to it: set the "
            f"subscriber's to this node's, or this node's parameter output_reliability"
        )

    return PublisherEventCallbacks(incompatible_qos=incompatible)

"""Quality-of-service profiles that several nodes use."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from sfr_loc_map.transport_issues import Reliability

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Profile of a topic that keeps its last message for late subscribers."""
TF_STATIC_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RELIABILITIES = tuple(kind.value for kind in Reliability)


def profile(reliability: str, depth: int) -> QoSProfile:
    """Return a volatile profile with one of `RELIABILITIES` that keeps the last `depth` messages."""
    policy = ReliabilityPolicy.RELIABLE if reliability == Reliability.RELIABLE else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, reliability=policy)

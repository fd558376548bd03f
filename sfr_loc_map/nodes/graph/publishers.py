"""The publishers of a topic as the graph shows them, and whether their shared memory is that of this process."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

from sfr_loc_map.doctor.silence import Publisher, Reliability

SHARED_MEMORY = "dev/shm"
HOST, PROCESS = slice(2, 4), slice(4, 6)
"""Bytes of the identity of a participant of Fast DDS that name its host and the lower 16 bits of its process
(`guid_prefix_create` of Fast DDS 2 and 3)."""
FIRST_PORT, PORTS_OF_DOMAIN = (7400, 250)  #: Of DDS (DDSI-RTPS 2.2, 9.6.1), also in names of shared memory.


def publishers_of(node: Node, topic: str) -> tuple[Publisher, ...]:
    """Return the publishers of a topic by its full name."""
    own = _own_identity(node, topic)
    return tuple(
        Publisher(
            node_of(info),
            str(info.topic_type),
            reliability_of(info),
            own is not None and has_own_memory(bytes(info.endpoint_gid), own),
        )
        for info in node.get_publishers_info_by_topic(topic)
    )


def node_of(info: Any) -> str:  # noqa: ANN401 - rclpy's TopicEndpointInfo
    """Return the node of a publisher or subscription with its namespace."""
    name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    return "of unknown name" if "_UNKNOWN_" in name else name  # of a participant that sends nothing to this one


def reliability_of(info: Any) -> Reliability:  # noqa: ANN401 - rclpy's TopicEndpointInfo
    """Return the reliability of a publisher or a subscription."""
    best_effort = info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    return Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE


def _own_identity(node: Node, topic: str) -> bytes | None:
    """Return the identity of a subscription of this node to the topic, None without one."""
    own = node.get_fully_qualified_name()
    found = (info for info in node.get_subscriptions_info_by_topic(topic) if node_of(info) == own)
    return next((bytes(info.endpoint_gid) for info in found), None)


def has_own_memory(identity: bytes, own: bytes) -> bool:
    """Tell whether a participant of this host has another /dev/shm than this process.

    Fast DDS uses shared memory alone between participants of one host. A process that this one cannot look at counts
    as one with the same shared memory.
    """
    if identity[HOST] != own[HOST] or identity[PROCESS] == own[PROCESS]:
        return False
    ours = _memory_of("self")
    lower = int.from_bytes(identity[PROCESS], "little")
    candidates = [name for name in os.listdir("/proc") if name.isdecimal() and int(name) & 0xFFFF == lower]
    if not candidates:  # a process of another container
        return not _has_foreign_port()
    found = {_memory_of(name) for name in candidates}
    return ours is not None and None not in found and ours not in found


def _has_foreign_port() -> bool:
    """Tell whether another process of this domain has its port of Fast DDS in the /dev/shm of this process."""
    first = FIRST_PORT + PORTS_OF_DOMAIN * int(os.environ.get("ROS_DOMAIN_ID") or 0)
    own = Path("/proc/self/maps").read_text(encoding="utf-8")
    found = (re.fullmatch(r"fastrtps_port([0-9]{1,5})", name) for name in os.listdir(f"/{SHARED_MEMORY}"))
    ports = (int(match[1]) for match in found if match)
    return any(first <= port < first + PORTS_OF_DOMAIN and f"fastrtps_port{port}\n" not in own for port in ports)


def _memory_of(process: str) -> tuple[int, int] | None:
    """Return which /dev/shm a process has, None if it cannot be looked at."""
    with suppress(OSError):
        status = (Path("/proc") / process / "root" / SHARED_MEMORY).stat()
        return status.st_dev, status.st_ino
    return None

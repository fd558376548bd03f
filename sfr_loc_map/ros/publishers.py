"""Query the publishers of a topic in the graph."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from sfr_loc_map.topics import COMPRESSED_END
from sfr_loc_map.transport_issues import UNKNOWN_NAME, Publisher, Reliability

PARTICIPANT_BYTES = 12
"""Number of first bytes of a global id that identify the DDS participant, of which a process of ROS has one (DDSI-RTPS
2.5, section 9.3.1). The last bytes identify the publisher in the participant."""
UNKNOWN_NODE = "_NODE_NAME_UNKNOWN_"  #: Name that ROS reports for a node that is not discovered yet.


def publishers_of(node: Node, topic: str) -> tuple[Publisher, ...]:
    """Return the publishers of a topic, given by its full name."""
    infos = node.get_publishers_info_by_topic(topic)
    return tuple(
        Publisher(
            node_of(info),
            str(info.topic_type),
            reliability_of(info),
            is_latched=info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        )
        for info in infos
    )


def name_to_subscribe(node: Node, name: str) -> str:
    """Return the name by which a node subscribes to a topic, given by its relative name.

    The topic of compressed images that is not remapped itself follows a remapping of the raw images.
    """
    raw = name.removesuffix(COMPRESSED_END)
    if raw == name or is_remapped(node, name) or not is_remapped(node, raw):
        return name
    return f"{node.resolve_topic_name(raw)}{COMPRESSED_END}"


def resolved_name(node: Node, name: str) -> str:
    """Return the full name of a topic to which a node subscribes, given by its relative name."""
    subscribed = name_to_subscribe(node, name)
    return str(node.resolve_topic_name(name)) if subscribed == name else subscribed


def is_remapped(node: Node, name: str) -> bool:
    """Return whether a remapping rule applies to a relative name."""
    return bool(node.resolve_topic_name(name) != node.resolve_topic_name(name, only_expand=True))


def participants_of(node: Node, topic: str) -> set[tuple[int, ...]]:
    """Return the ids of the participants of the publishers of a topic, given by its full name."""
    return {tuple(info.endpoint_gid[:PARTICIPANT_BYTES]) for info in node.get_publishers_info_by_topic(topic)}


def node_of(info: Any) -> str:  # noqa: ANN401 - rclpy's TopicEndpointInfo
    """Return the node name of a publisher or subscription, with its namespace."""
    name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
    return UNKNOWN_NAME if info.node_name == UNKNOWN_NODE else name


def reliability_of(info: Any) -> Reliability:  # noqa: ANN401 - rclpy's TopicEndpointInfo
    """Return the reliability of a publisher or a subscription."""
    best_effort = info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    return Reliability.BEST_EFFORT if best_effort else Reliability.RELIABLE

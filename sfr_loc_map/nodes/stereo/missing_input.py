"""Report in one line what a node waits for; `sfr doctor` examines the whole running graph."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rclpy.node import Node

from sfr_loc_map.issues import Cause, Issue
from sfr_loc_map.ros.publishers import is_remapped, publishers_of, resolved_name
from sfr_loc_map.topics import COMPRESSED_END, RAW, RECTIFIED
from sfr_loc_map.transport_issues import Reliability, silence_of

MORE = "sfr doctor examines the graph"
ORDER = (Cause.WRONG_TYPE, Cause.QOS, Cause.TRANSPORT, Cause.NO_PUBLISHER, Cause.SILENT)
"""Kinds of reasons in the order of their priority. Only the first kind that occurs is reported, because it may explain
the others."""


@dataclass(frozen=True, slots=True)
class Input:
    """An input that a node requires, on one of several topics."""

    topics: Mapping[str, type[Any]]  #: Message types by relative name.
    received: int  #: Messages since the last `report_periodically`; 1 once received if the input is not a stream.
    reliability: str = Reliability.BEST_EFFORT  #: Reliability that the node requests.
    is_stream: bool = True  #: Whether the input is published continuously; camera_info may be published once.


def missing_input(node: Node, inputs: Sequence[Input], *, has_received: bool) -> str:
    """Return which inputs are not received, with the reason that the graph shows; empty if all are received.

    `has_received` states whether the node has received its inputs earlier.
    """
    heard = {
        publisher.node
        for item in inputs
        if item.received or has_received
        for name in item.topics
        for publisher in publishers_of(node, resolved_name(node, name))
    }
    found = [_silence(node, item, heard) for item in inputs if not item.received]
    if not found:
        return ""
    cause = min((issue.cause for issue in found), key=ORDER.index)
    texts = dict[tuple[str, str], list[str]]()
    for issue in found:
        if issue.cause is cause:
            texts.setdefault((issue.text, issue.fix), []).append(issue.where)
    parts = [f"{_topics(names)} ({text}): {', '.join(names)}; {fix}" for (text, fix), names in texts.items()]
    return f"Waiting for {'; '.join(parts)}; {MORE}"


def _silence(node: Node, item: Input, heard: Collection[str]) -> Issue:
    """Return why an input receives no messages on any of its topics; `heard` are the nodes that are received.

    The reason belongs to the first topic that has a publisher. If no topic has a publisher, the reason belongs to the
    first remapped topic, or without remapping to the first topic.
    """
    found, remapped = [], []
    for name, kind in item.topics.items():
        topic = resolved_name(node, name)
        publishers = publishers_of(node, topic)
        requested = Reliability(item.reliability)
        issue = silence_of(topic, (type_name(kind),), publishers, requested, heard=heard)
        if not publishers:
            issue = replace(issue, fix=_fix_by_other_topic(node, name, topic) or issue.fix)
        found.append(issue)
        if is_remapped(node, name):
            remapped.append(found[-1])
    published = [issue for issue in found if issue.cause is not Cause.NO_PUBLISHER]
    return (published or remapped or found)[0]


def _fix_by_other_topic(node: Node, name: str, topic: str) -> str:
    """Return the fix of a topic without a publisher if a similar topic is published; empty if there is none.

    A similar topic has the images of the other kind (raw or rectified), or lacks the namespace of the node.
    """
    camera, _, kind = topic.removesuffix(COMPRESSED_END).rpartition("/")
    other = {RECTIFIED: RAW, RAW: RECTIFIED}.get(kind)
    if other and any(map(node.count_publishers, (f"{camera}/{other}", f"{camera}/{other}{COMPRESSED_END}"))):
        return f"set the parameter input.rectify to {str(other == RAW).lower()}: {other} is published"
    root = f"/{name}"
    if topic != root and node.count_publishers(root):
        return f"start the node without its namespace, or remap it (sfr run -r {name}:={root}): {root} is published"
    return ""


def type_name(kind: type[Any]) -> str:
    """Return the name of a message type as the graph reports it, such as `sensor_msgs/msg/Image`."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/msg/{kind.__name__}"


def _topics(names: Sequence[str]) -> str:
    return "a topic" if len(names) == 1 else f"{len(names)} topics"

"""What a node waits for, in one line; `sfr doctor` examines the running graph in full."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from sfr_loc_map.doctor.findings import Cause, Finding
from sfr_loc_map.doctor.silence import Reliability, silence_of
from sfr_loc_map.nodes.ros.publishers import publishers_of

MORE = "sfr doctor examines the graph"
ORDER = (Cause.WRONG_TYPE, Cause.QOS, Cause.TRANSPORT, Cause.NO_PUBLISHER, Cause.SILENT)
"""Reasons in the order of what is reported: one that explains the others comes first."""


@dataclass(frozen=True, slots=True)
class Input:
    """Something that a node has to receive, on one of several topics."""

    topics: Mapping[str, type[Any]]  #: Message types by relative name.
    received: int  #: Messages since the last look around.
    reliability: str = Reliability.BEST_EFFORT  #: Reliability that the node requests.


def missing_input(node: Node, inputs: Sequence[Input]) -> str:
    """Return which inputs are not received, and why as far as the graph shows it; empty if all are received."""
    found = [_silence(node, item) for item in inputs if not item.received]
    if not found:
        return ""
    cause = min((finding.cause for finding in found), key=ORDER.index)
    texts = dict[tuple[str, str], list[str]]()
    for finding in found:
        if finding.cause is cause:
            texts.setdefault((finding.text, finding.fix), []).append(finding.where)
    parts = [f"{_topics(names)} ({text}): {', '.join(names)}; {fix}" for (text, fix), names in texts.items()]
    return f"Waiting for {'; '.join(parts)}; {MORE}"


def _silence(node: Node, item: Input) -> Finding:
    """Return why no message is received on any of the topics of an input.

    The reason is given for the topic that has a publisher, otherwise for the topic that was remapped.
    """
    found, remapped = [], []
    for name, kind in item.topics.items():
        topic = node.resolve_topic_name(name)
        publishers = publishers_of(node, topic)
        found.append(silence_of(topic, (type_name(kind),), publishers, Reliability(item.reliability)))
        if topic != node.resolve_topic_name(name, only_expand=True):
            remapped.append(found[-1])
    published = [finding for finding in found if finding.cause is not Cause.NO_PUBLISHER]
    return (published or remapped or found)[0]


def type_name(kind: type[Any]) -> str:
    """Return the name of a message type as the graph reports it, such as `sensor_msgs/msg/Image`."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/msg/{kind.__name__}"


def _topics(names: Sequence[str]) -> str:
    return "a topic" if len(names) == 1 else f"{len(names)} topics"

"""What a node waits for, in one line; `sfr doctor` examines the running graph in full."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

MORE = "sfr doctor examines the graph"


@dataclass(frozen=True, slots=True)
class Input:
    """Something that a node has to receive, on one of several topics."""

    topics: Mapping[str, type[Any]]  #: Message types by relative name.
    received: int  #: Messages since the last look around.


def missing_input(node: Node, inputs: Sequence[Input]) -> str:
    """Return which inputs are not received, and why as far as the graph shows it; empty if all are received."""
    unpublished, silent, wrong = list[str](), list[str](), list[str]()
    for item in inputs:
        if item.received:
            continue
        names = {name: node.resolve_topic_name(name) for name in item.topics}
        publishers = {name: node.get_publishers_info_by_topic(full_name) for name, full_name in names.items()}
        kinds = {name: type_name(kind) for name, kind in item.topics.items()}
        found = [(name, str(info.topic_type)) for name, infos in publishers.items() for info in infos]
        others = [(name, kind) for name, kind in found if kind != kinds[name]]
        if not found:
            unpublished.append(next(iter(names.values())))
        elif len(others) == len(found):
            name, kind = others[0]
            wrong.append(f"{names[name]} has the type {kind}: {kinds[name]} is required")
        else:
            silent += [names[name] for name, infos in publishers.items() if infos]
    if wrong:
        return "; ".join(wrong)
    if unpublished:
        return f"Waiting for {_topics(unpublished)} without a publisher: {', '.join(unpublished)}; {MORE}"
    if silent:
        return f"Waiting for messages on {', '.join(silent)}: a publisher is there; {MORE}"
    return ""


def type_name(kind: type[Any]) -> str:
    """Return the name of a message type as the graph reports it, such as `sensor_msgs/msg/Image`."""
    package, _, _ = kind.__module__.partition(".")
    return f"{package}/msg/{kind.__name__}"


def _topics(names: Sequence[str]) -> str:
    return "a topic" if len(names) == 1 else f"{len(names)} topics"

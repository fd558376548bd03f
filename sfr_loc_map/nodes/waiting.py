"""What a node of stereo pairs waits for, in the words of `sfr doctor`.

A node imports this when nothing comes of its input: the doctor takes 11 MB that it does not need otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rclpy.clock import ROSClock

from sfr_loc_map.nodes.environment import EXPORT_LINE
from sfr_loc_map.nodes.graph import offers_of
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.messages import tf_message_type
from sfr_loc_map.pipeline.doctor import examine
from sfr_loc_map.pipeline.doctor_observation import EXPECTED, Observation, ObservedNode, ObservedTopic, Reliability

MOST = 3  #: Findings that are told at a time; those that differ in the place alone are one.
Seen = Mapping[str, tuple[Sequence[int], tuple[Any, ...]]]
"""Stamps (ns) and some messages that were received of each topic, by the suite's names."""


def waits_for(node: ManagedNode[Any], seen: Seen, reliability: str, *, extrinsics: bool, **this: Any) -> list[str]:  # noqa: ANN401
    """Return the doctor's blocking findings on what a node has received meanwhile, one line each.

    What is requested of its publishers, whether the extrinsics are known, and fields of `ObservedNode` are its own.
    """
    clock, name = node.get_clock(), node.get_fully_qualified_name()
    sim_time = isinstance(clock, ROSClock) and bool(clock.ros_time_is_active)
    requests = {name: Reliability(reliability)}

    def observed(topic: str, stamps_ns: Sequence[int], messages: tuple[Any, ...]) -> ObservedTopic:
        found = node.resolve_topic_name(topic)
        types = {str(info.topic_type) for info in node.get_publishers_info_by_topic(found)}
        named = tuple(sorted(types)) or EXPECTED[topic]
        return ObservedTopic(found, named, offers_of(node, found), np.array(stamps_ns, np.int64), messages, requests)

    observation = Observation(
        "the graph",
        live=True,
        prefix=f"{node.get_namespace().rstrip('/')}/",
        topics={topic: observed(topic, *received) for topic, received in seen.items()},
        others={topic: tuple(types) for topic, types in node.get_topic_names_and_types()},
        extrinsics_given=extrinsics,
        extrinsics_in_tf=None if tf_message_type() is None else False,
        nodes=(ObservedNode(name, use_sim_time=sim_time, has_worked=node.status.calls > 0, **this),),
        has_clock=bool(node.get_publishers_info_by_topic("/clock")),
        export_line=EXPORT_LINE,
    )
    places: dict[tuple[str, str], list[str]] = {}
    for finding in examine(observation):
        if finding.is_blocking:
            places.setdefault((finding.text, finding.fix), []).append(finding.where)
    return [f"{', '.join(where)}: {text}; {fix}" for (text, fix), where in [*places.items()][:MOST]]

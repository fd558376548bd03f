"""What a node of stereo pairs waits for, in the words of `sfr doctor`.

A node imports this when nothing comes of its input: the doctor takes 11 MB that it does not need otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.clock import ROSClock
from rclpy.qos import ReliabilityPolicy

from sfr_loc_map.nodes.environment import EXPORT_LINE
from sfr_loc_map.nodes.messages import tf_message_type
from sfr_loc_map.pipeline.doctor import examine
from sfr_loc_map.pipeline.doctor_observation import EXPECTED, Observation, ObservedNode, ObservedTopic, Reliability

if TYPE_CHECKING:
    from sfr_loc_map.nodes.pair_node import PairNode

MOST = 3  #: Findings that are told at a time; those that differ in the place alone are one.
Seen = Mapping[str, tuple[Sequence[int], tuple[Any, ...]]]
"""Stamps (ns) and some messages that were received of each topic, by the suite's names."""


def waits_for(node: PairNode[Any], seen: Seen) -> list[str]:
    """Return the doctor's blocking findings on what a node has received meanwhile, one line each."""
    clock, config = node.get_clock(), node.config.input
    this = ObservedNode(
        node.get_fully_qualified_name(),
        node.rig_name,
        use_sim_time=isinstance(clock, ROSClock) and bool(clock.ros_time_is_active),
        stamp_tolerance_ns=config.stamp_tolerance_ns,
        has_worked=node.status.calls > 0,
        rectifies=config.rectify,
    )
    observation = Observation(
        "the graph",
        live=True,
        prefix=f"{node.get_namespace().rstrip('/')}/",
        topics={name: _topic(node, name, *received) for name, received in seen.items()},
        others={name: tuple(types) for name, types in node.get_topic_names_and_types()},
        extrinsics_given=node.extrinsics_known,
        extrinsics_in_tf=None if tf_message_type() is None else False,
        nodes=(this,),
        has_clock=bool(node.get_publishers_info_by_topic("/clock")),
        export_line=EXPORT_LINE,
    )
    places: dict[tuple[str, str], list[str]] = {}
    for finding in examine(observation):
        if finding.is_blocking:
            places.setdefault((finding.text, finding.fix), []).append(finding.where)
    return [f"{', '.join(where)}: {text}; {fix}" for (text, fix), where in [*places.items()][:MOST]]


def _topic(node: PairNode[Any], name: str, stamps_ns: Sequence[int], messages: tuple[Any, ...]) -> ObservedTopic:
    """Return a topic with its name and its publishers in the graph."""
    found = node.resolve_topic_name(name)
    infos = node.get_publishers_info_by_topic(found)
    strict = [info.qos_profile.reliability == ReliabilityPolicy.RELIABLE for info in infos]
    return ObservedTopic(
        found,
        tuple(sorted({str(info.topic_type) for info in infos})) or EXPECTED[name],
        tuple(Reliability.RELIABLE if each else Reliability.BEST_EFFORT for each in strict),
        np.array(stamps_ns, np.int64),
        messages,
        requests={node.get_fully_qualified_name(): Reliability(node.config.input.reliability)},
    )

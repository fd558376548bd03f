"""Observe publishers, quality of service and messages of the running graph for a given time."""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from sfr_loc_map.doctor.observation import (
    EXPECTED,
    MESSAGES_KEPT,
    RIG_OF_NODE,
    Observation,
    ObservedNode,
    ObservedTopic,
    SourceKind,
)
from sfr_loc_map.errors import NodeError
from sfr_loc_map.geometry.extrinsics import LOCSB_FRAME, RB_FRAME
from sfr_loc_map.geometry.frame_tree import FrameTree
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.message_stamps import NS_PER_S, stamp_of
from sfr_loc_map.ros import environment
from sfr_loc_map.ros.messages import message_type, tf_message_type
from sfr_loc_map.ros.peer import Peer, Unchanged
from sfr_loc_map.ros.publishers import node_of, publishers_of, reliability_of
from sfr_loc_map.ros.qos import LATCHED, TF_STATIC_QOS
from sfr_loc_map.ros.services import call_service
from sfr_loc_map.ros.static_transforms import add_static_transforms
from sfr_loc_map.suite_names import PLAYER_NODE, SUITE_NODES, Task
from sfr_loc_map.topics import CLOCK, COMPRESSED_END, IMAGES, TF_STATIC, call_topic, rectified_beside

UNCHANGED_S = 1.5  #: Discovery is complete when images are published and the graph has not changed for this time.
MAX_DISCOVERY_S = 8.0  #: Maximum duration of discovery, s.
FIRST_MESSAGE_S = 4.0
"""Maximum wait for the first message of each topic that has a publisher, before the observation begins."""
ANSWER_S = 10.0  #: Timeout of a service call, s. A node answers within 1 s, on a busy host within several seconds.
DEPTH = 100  #: Queue depth of an observed topic. The observer only notes the stamps, so queues stay short.
LEFT_IMAGES = tuple(f"/{task.rig}/left/{image}" for task in Task for image in IMAGES)
PARAMETERS = ("use_sim_time", "input.stamp_tolerance_s", "input.rectify", "T_rb_locsb.quat_xyzw")


class GraphObserver(Peer):
    """Observes the graph for a given time; a context manager."""

    def __init__(self, topics: Mapping[str, str]) -> None:
        """Join the graph; `topics` has the name in the graph by the name in the suite, for topics with two names."""
        super().__init__(f"sfr_doctor_{os.getpid()}")
        self._name_in_suite = {"/" + topic.strip("/"): "/" + name.strip("/") for name, topic in topics.items()}
        self._name_in_graph = {name.strip("/"): found for found, name in self._name_in_suite.items()}
        self._namespace = ""  # of the observed nodes, found by `observe`
        self._stamps: dict[str, list[int]] = {}
        self._messages = defaultdict[str, list[Any]](list)
        self._frames = FrameTree()
        self._worked: set[str] = set()

    def observe(self, seconds: float, namespace: str, config: SourceConfig) -> Observation:
        """Collect messages and query the nodes of the suite. If the namespace is empty, that of the nodes is used."""
        self._wait_for_discovery()
        spaces = sorted({space.strip("/") for _, space in self._suite_nodes()})
        if len(spaces) > 1 and not namespace.strip("/"):
            raise NodeError(f"nodes run in the namespaces {', '.join(spaces)}: choose one by --namespace")
        self._namespace = namespace.strip("/") or "".join(spaces)
        types = dict(self.ros_node.get_topic_names_and_types())
        expected = {name: self._full_name(name) for name in EXPECTED if self._full_name(name) in types}
        topics = {name: full_name for name, full_name in expected.items() if not self._is_superseded(name, full_name)}
        for name, full_name in topics.items():
            self._subscribe(name, full_name, types[full_name])
        has_tf_type = self._subscribe_to_frames()
        self._subscribe_to_calls()

        def all_received() -> bool:
            # On a busy host the first message takes seconds.
            return all(
                self._stamps.get(name, True) or not self.ros_node.count_publishers(full_name)
                for name, full_name in topics.items()
            )

        self.spin(FIRST_MESSAGE_S, all_received)
        self.count_losses()
        self.spin(seconds)
        lost = self.count_losses()
        nodes = tuple(self._ask(name, space) for name, space in self._suite_nodes() if space == "/" + self._namespace)
        in_tf = self._frames.find(RB_FRAME, LOCSB_FRAME) is not None
        is_played = PLAYER_NODE in self.ros_node.get_node_names()
        return Observation(
            f"the graph of ROS domain {environment.domain()}",
            SourceKind.GRAPH,
            prefix=self._full_name(""),
            topics={
                name: self._topic(name, full_name, types[full_name], lost.get(full_name, 0))
                for name, full_name in topics.items()
            },
            others={name: tuple(of_topic) for name, of_topic in types.items()},
            stamp_tolerance_ns=config.sync.stamp_tolerance_ns,
            extrinsics_given=config.extrinsics.transform() is not None,
            extrinsics_in_tf=in_tf if has_tf_type or TF_STATIC not in types else None,
            nodes=nodes,
            has_clock=bool(self.ros_node.get_publishers_info_by_topic(CLOCK)),
            now_ns=None if is_played else time.time_ns(),
            export_line=environment.EXPORT_LINE,
        )

    def _subscribe_to_frames(self) -> bool:
        """Subscribe to /tf_static; return whether its message type is installed."""
        kind = tf_message_type()
        if kind is not None:
            add = partial(add_static_transforms, tree=self._frames)
            self.ros_node.create_subscription(kind, TF_STATIC, add, TF_STATIC_QOS)
        return kind is not None

    def _subscribe_to_calls(self) -> None:
        for task in Task:
            note = partial(self._note_call, self._full_name(task.node))
            self.ros_node.create_subscription(String, self._full_name(call_topic(task)), note, LATCHED)

    def _full_name(self, name: str) -> str:
        """Return the name in the graph of a topic or node of the suite. Compressed images follow raw images."""
        raw = name.removesuffix(COMPRESSED_END)
        if name not in self._name_in_graph and raw in self._name_in_graph:
            return f"{self._name_in_graph[raw]}{COMPRESSED_END}"
        return self._name_in_graph.get(name, f"/{self._namespace}/{name}" if self._namespace else f"/{name}")

    def _is_superseded(self, name: str, full_name: str) -> bool:
        """Return whether raw images are superseded: also published rectified, and used by no node of the suite."""
        takers = {info.node_name for info in self.ros_node.get_subscriptions_info_by_topic(full_name)}
        rectified = [self._full_name(beside) for beside in rectified_beside(name)]
        return not takers & set(SUITE_NODES) and any(map(self.ros_node.count_publishers, rectified))

    def _suite_nodes(self) -> list[tuple[str, str]]:
        return [(name, space) for name, space in self.ros_node.get_node_names_and_namespaces() if name in SUITE_NODES]

    def _subscribe(self, name: str, full_name: str, types: list[str]) -> None:
        """Subscribe to a topic of the expected type with best effort, which is compatible with all publishers."""
        if set(types) - set(EXPECTED[name]):
            return
        stamps, messages, gaps = self._stamps.setdefault(name, []), self._messages[name], self.count_messages(full_name)

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - any stamped message
            gaps.add(info)
            stamps.append(stamp_of(message))
            if len(messages) < MESSAGES_KEPT:
                messages.append(message)

        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.subscribe(message_type(types[0]), full_name, received, qos)

    def _note_call(self, node: str, message: String) -> None:
        """Record that a node has processed input.

        Its last call is latched, so it is also received if it was published earlier.
        """
        self._worked.add(node)

    def _topic(self, name: str, full_name: str, types: list[str], lost: int) -> ObservedTopic:
        requests = {
            node_of(info): reliability_of(info)
            for info in self.ros_node.get_subscriptions_info_by_topic(full_name)
            if info.node_name in SUITE_NODES
        }
        publishers, messages = publishers_of(self.ros_node, full_name), tuple(self._messages[name])
        stamps_ns = np.array(self._stamps.get(name, []), np.int64)
        return ObservedTopic(full_name, tuple(types), publishers, stamps_ns, messages, requests, lost)

    def _ask(self, name: str, space: str) -> ObservedNode:
        full_name = f"{space.rstrip('/')}/{name}"
        state = self._call(GetState, f"{full_name}/get_state", GetState.Request())
        request = GetParameters.Request(names=list(PARAMETERS))
        answer = self._call(GetParameters, f"{full_name}/get_parameters", request) if state is not None else None
        values = [parameter_value_to_python(value) for value in answer.values] if answer is not None else []
        sim_time, tolerance_s, rectify, quat = (*values, None, None, None, None)[:4]
        return ObservedNode(
            full_name,
            RIG_OF_NODE.get(name, ""),
            state=str(state.current_state.label) if state is not None and answer is not None else "",
            use_sim_time=bool(sim_time),
            extrinsics_given=any(quat) if quat is not None else False,
            stamp_tolerance_ns=None if tolerance_s is None else round(tolerance_s * NS_PER_S),
            has_worked=full_name in self._worked,
            rectifies=bool(rectify),
        )

    def _call(self, kind: type[Any], name: str, request: Any) -> Any:  # noqa: ANN401 - any service
        """Return the answer of a service; None after the timeout."""
        with suppress(NodeError):
            return call_service(
                *(self.ros_node, kind, name, request),
                wait=lambda condition, seconds: self.spin(seconds, condition),
                found_s=ANSWER_S,
                answer_s=ANSWER_S,
            )
        return None

    def _wait_for_discovery(self) -> None:
        """Wait until the graph does not change. Discovery takes about a second, under load several seconds."""
        unchanged = Unchanged()

        def is_discovered() -> bool:
            topics = self.ros_node.get_topic_names_and_types()
            unchanged_s = unchanged.seconds((topics, sorted(self.ros_node.get_node_names())))
            images = [name for name, _ in topics if self._name_in_suite.get(name, name).endswith(LEFT_IMAGES)]
            return unchanged_s > UNCHANGED_S and any(map(self.ros_node.count_publishers, images))

        self.spin(MAX_DISCOVERY_S, is_discovered)

"""Looks at the running graph: who publishes what, with which quality of service, and what comes in some seconds."""

from __future__ import annotations

import os
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import NodeError
from sfr_loc_map.io.bag_sequence import LOCSB_FRAME, RB_FRAME
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.nodes.input.static_transforms import StaticTransforms
from sfr_loc_map.nodes.messages.message_types import message_type
from sfr_loc_map.nodes.messages.pose import tf_message_type
from sfr_loc_map.nodes.process import environment
from sfr_loc_map.pipeline.doctor.observation import (
    EXPECTED,
    PICTURES_KEPT,
    TASK_OF_NODE,
    TASKS,
    Observation,
    Reliability,
    SeenNode,
    SeenTopic,
)

SETTLE_S = 1.5
"""The graph counts as known when it has pictures and has not changed for so long,"""
PATIENCE_S = 8.0
"""or after so long."""
LOOK_S = 0.1
ANSWER_S = 2.0
DEPTH = 100
OURS = (*TASK_OF_NODE, "monitor_node")
SHARED_MEMORY = Path("/dev/shm")
PARAMETERS = ("use_sim_time", "input.reliability", "input.stamp_tolerance_s", "T_rb_locsb.quat_xyzw")


def observe_graph(seconds: float, namespace: str, remap: Mapping[str, str], *, place_given: bool) -> Observation:
    """Look at the graph for some time.

    Args:
        seconds: How long messages are collected, after the graph has become known.
        namespace: Of the rover; empty: that of our nodes, if they run in one, else none.
        remap: New names by the names there.
        place_given: Whether a parameter file says where the stereo bench is.

    Raises:
        NodeError: If our nodes run in several namespaces and none is given.
    """
    environment.prepare()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        return _Look(namespace, remap).observe(seconds, place_given=place_given)
    finally:
        try_shutdown()


class _Look:
    """One look at the graph."""

    def __init__(self, namespace: str, remap: Mapping[str, str]) -> None:
        self._node: Node = rclpy.create_node(f"sfr_doctor_{os.getpid()}", start_parameter_services=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._renamed = {"/" + found.strip("/"): "/" + new.strip("/") for found, new in remap.items()}
        self._settle()
        self._namespace = namespace.strip("/") or self._namespace_of_nodes()
        self._remap = {new.strip("/"): found for found, new in self._renamed.items()}
        self._stamps: dict[str, list[int]] = {}
        self._messages: dict[str, list[Any]] = {}
        self._frames = StaticTransforms()

    def observe(self, seconds: float, *, place_given: bool) -> Observation:
        """Collect messages, ask our nodes."""
        others = dict(self._node.get_topic_names_and_types())
        there = {name: self._name(name) for name in EXPECTED if self._name(name) in others}
        for name, found in there.items():
            self._listen(name, found, others[found])
        kind = tf_message_type()
        if kind is not None:
            latched = QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._node.create_subscription(kind, "/tf_static", self._frames.add, latched)
        self._spin_for(seconds)
        nodes = tuple(self._ask(name, space) for name, space in self._ours() if space == "/" + self._namespace)
        place = self._frames.find(RB_FRAME, LOCSB_FRAME) is not None
        return Observation(
            f"the graph of ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}",
            live=True,
            prefix=f"/{self._namespace}/" if self._namespace else "/",
            topics={name: self._topic(name, found, others[found]) for name, found in there.items()},
            others={name: tuple(types) for name, types in others.items()},
            place_given=place_given,
            place_in_frames=None if kind is None and "/tf_static" in others else place,
            nodes=nodes,
            has_clock=bool(self._node.get_publishers_info_by_topic("/clock")),
            now_ns=time.time_ns(),
            shared_memory_bytes=shared_memory_bytes(),
            segment_bytes=segment_bytes(),
        )

    def _name(self, name: str) -> str:
        return self._remap.get(name, f"/{self._namespace}/{name}" if self._namespace else f"/{name}")

    def _ours(self) -> list[tuple[str, str]]:
        return [(name, space) for name, space in self._node.get_node_names_and_namespaces() if name in OURS]

    def _namespace_of_nodes(self) -> str:
        found = sorted({space.strip("/") for _, space in self._ours()})
        if len(found) > 1:
            raise NodeError(f"our nodes run in the namespaces {', '.join(found)}: choose one by --namespace")
        return found[0] if found else ""

    def _listen(self, name: str, found: str, types: list[str]) -> None:
        if set(types) - set(EXPECTED[name]):
            return
        stamps, messages = self._stamps.setdefault(name, []), self._messages.setdefault(name, [])

        def received(message: Any) -> None:  # noqa: ANN401 - any stamped message
            stamps.append(stamp_of(message))
            if len(messages) < PICTURES_KEPT:
                messages.append(message)

        qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(message_type(types[0]), found, received, qos)

    def _topic(self, name: str, found: str, types: list[str]) -> SeenTopic:
        infos = self._node.get_publishers_info_by_topic(found)
        stamps = np.array(self._stamps.get(name, []), np.int64)
        messages = tuple(self._messages.get(name, ()))
        return SeenTopic(found, tuple(types), tuple(_reliability(info) for info in infos), stamps, messages)

    def _ask(self, name: str, space: str) -> SeenNode:
        """Ask one of our nodes for its state and parameters."""
        full = f"{space.rstrip('/')}/{name}"
        state = self._call(GetState, f"{full}/get_state", GetState.Request())
        answer = self._call(GetParameters, f"{full}/get_parameters", GetParameters.Request(names=list(PARAMETERS)))
        values = [parameter_value_to_python(value) for value in answer.values] if answer is not None else []
        sim_time, reliability, tolerance_s, quat = (*values, None, None, None, None)[:4]
        return SeenNode(
            full,
            TASK_OF_NODE.get(name, ""),
            state=str(state.current_state.label) if state is not None else "",
            reliability="best_effort" if reliability == "best_effort" else "reliable",
            use_sim_time=bool(sim_time),
            place_given=any(quat) if quat is not None else False,
            stamp_tolerance_ns=round((tolerance_s or 0.0) * NS_PER_S),
        )

    def _call(self, kind: type[Any], name: str, request: Any) -> Any:  # noqa: ANN401 - any service
        """Return the answer of a service, None where none comes in time."""
        client = self._node.create_client(kind, name)
        if not self._wait_for(client.service_is_ready):
            return None
        future = client.call_async(request)
        return future.result() if self._wait_for(future.done) else None

    def _wait_for(self, condition: Callable[[], bool]) -> bool:
        end = time.monotonic() + ANSWER_S
        while not condition() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)
        return bool(condition())

    def _settle(self) -> None:
        """Wait until nothing new is seen: processes find each other in a second or, under load, some more."""
        begin = changed = time.monotonic()
        before: Any = None
        while (now := time.monotonic()) - begin < PATIENCE_S:
            topics = self._node.get_topic_names_and_types()
            graph = (topics, sorted(self._node.get_node_names()))
            if graph != before:
                before, changed = graph, now
            has_pictures = any(self._is_picture(name) and self._node.count_publishers(name) for name, _ in topics)
            if has_pictures and now - changed > SETTLE_S:
                return
            self._spin_for(LOOK_S)

    def _is_picture(self, name: str) -> bool:
        name = self._renamed.get(name, name)
        return any(name.endswith(f"/{task}/left/image_rect{end}") for task in TASKS for end in ("", "/compressed"))

    def _spin_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)


def _reliability(info: Any) -> Reliability:  # noqa: ANN401 - rclpy's TopicEndpointInfo
    return "best_effort" if info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable"


def shared_memory_bytes() -> int | None:
    """Return the size of the host's shared memory, None where it has no folder for it."""
    if not SHARED_MEMORY.is_dir():
        return None
    state = os.statvfs(SHARED_MEMORY)
    return state.f_blocks * state.f_frsize


def segment_bytes() -> int:
    """Return what each process reserves of the shared memory by the profile in force, 0 where it says nothing."""
    path = Path(os.environ.get(environment.PROFILE_VARIABLE) or environment.PROFILE)
    try:
        sizes = [element.text or "" for element in ET.parse(path).iter() if element.tag.endswith("segment_size")]
    except (OSError, ET.ParseError):
        return 0
    return max((int(size) for size in sizes if size.strip().isdigit()), default=0)

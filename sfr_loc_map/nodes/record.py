"""Records topics into a bag, serialised messages unchanged, until a signal ends it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import try_shutdown
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from sfr_loc_map.errors import NodeError
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io.bag_writer import BagRecorder
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.environment import start_ros
from sfr_loc_map.nodes.messages.message_types import definition_of, message_type
from sfr_loc_map.pipeline.reception import TransportGaps

INPUTS = (
    *(f"{task}/{side}/{name}" for task in ("loc", "nav") for side in SIDES for name in ("image_rect", "camera_info")),
    *(f"{task}/{side}/image_rect/compressed" for task in ("loc", "nav") for side in SIDES),
    *(f"{task}/{side}/image_raw{end}" for task in ("loc", "nav") for side in SIDES for end in ("", "/compressed")),
    *("nav/pose", "initialpose", "motion_prior", "ground_truth/odometry", "ground_truth/points"),
)
OUTPUTS = (
    *("localisation/odometry", "localisation/path", "metrics", "metrics/report", "bookmark"),
    *(f"mapping/{name}" for name in ("points", "disparity", "elevation", "hazard")),
    *(f"{task}/configuration" for task in ("localisation", "mapping", "monitor")),
)
GLOBAL = ("/diagnostics", "/tf", "/tf_static", "/clock")
DEPTH = 200
DISCOVERY_S = 0.25
FLUSH_S = 0.5
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """What to record.

    Attributes:
        topics: Their names, relative to the namespace; empty: inputs and outputs of the suite's nodes.
        everything: All topics instead, except hidden ones.
        namespace: Of the rover.
        duration_s: How long; None: until SIGINT, SIGTERM or SIGHUP.
        zstd: Whether chunks are compressed.
    """

    topics: Sequence[str] = ()
    everything: bool = False
    namespace: str = ""
    duration_s: float | None = None
    zstd: bool = False


@dataclass(slots=True)
class TopicCount:
    """What was recorded of a topic.

    Attributes:
        count: Messages recorded.
        gaps: Messages of a topic with one publisher that did not arrive.
    """

    count: int = 0
    gaps: TransportGaps = field(default_factory=TransportGaps)

    @property
    def lost(self) -> int:
        """Messages that were published and did not arrive."""
        return self.gaps.lost


def record(path: Path, options: RecordOptions, say: Callable[[str], None]) -> dict[str, TopicCount]:
    """Record topics into a bag.

    Args:
        path: Folder of the bag; must not exist.
        options: What to record.
        say: Called with a line for each topic.

    Returns:
        What was recorded, by topic.

    Raises:
        OutputError: If the bag cannot be written (any more); what was recorded before stays.
        NodeError: If no message was received; no bag is left then.
    """
    environment.prepare()
    stop = Event()

    def end(number: int, frame: FrameType | None) -> None:
        stop.set()

    before = {number: signal.signal(number, end) for number in END_SIGNALS}
    start_ros()
    try:
        with BagRecorder(path, zstd=options.zstd) as bag:
            recorder = _Recorder(bag, options, say)
            recorder.run(stop)
    finally:
        try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
    if not bag.count:
        _remove(path)
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        raise NodeError(f"no message was received in ROS domain {domain}: check by sfr doctor --graph")
    return recorder.counts


class _Recorder:
    def __init__(self, bag: BagRecorder, options: RecordOptions, say: Callable[[str], None]) -> None:
        self.counts: dict[str, TopicCount] = {}
        self._bag, self._options, self._say = bag, options, say
        self._node: Node = rclpy.create_node(f"sfr_record_{os.getpid()}", start_parameter_services=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        names = options.topics or (*INPUTS, *OUTPUTS, *GLOBAL)
        self._wanted = {self._resolved(name) for name in names}
        self._known: set[str] = set()

    def run(self, stop: Event) -> None:
        """Record until the event is set or the duration is over."""
        begin = discovered = flushed = time.monotonic()
        self._discover()
        while not stop.is_set():
            self._executor.spin_once(timeout_sec=DISCOVERY_S)
            now = time.monotonic()
            if now - discovered > DISCOVERY_S:
                self._discover()
                discovered = now
            if now - flushed > FLUSH_S:
                self._bag.flush()
                flushed = now
            if self._options.duration_s is not None and now - begin > self._options.duration_s:
                return

    def _resolved(self, name: str) -> str:
        space = self._options.namespace.strip("/")
        return name if name.startswith("/") or not space else f"/{space}/{name}"

    def _discover(self) -> None:
        """Subscribe to new topics."""
        wanted = {name if name.startswith("/") else f"/{name}" for name in self._wanted}
        for name, types in self._node.get_topic_names_and_types():
            hidden = "/_" in name
            if name in self._known or not (name in wanted or (self._options.everything and not hidden)):
                continue
            infos = self._node.get_publishers_info_by_topic(name)
            if infos and not self._is_superseded(name):
                self._known.add(name)
                self._subscribe(name, types[0], infos)

    def _is_superseded(self, name: str) -> bool:
        """Tell whether it has raw images that are also published rectified, and was not asked for."""
        stem, raw, _ = name.rpartition("/image_raw")
        if not raw or self._options.topics or self._options.everything:
            return False
        return any(self._node.count_publishers(f"{stem}/image_rect{end}") for end in ("", "/compressed"))

    def _subscribe(self, name: str, msgtype: str, infos: list[Any]) -> None:
        try:
            kind = message_type(msgtype)
        except NodeError as error:
            self._say(f"{name} is not recorded: {error}")
            return
        text, type_hash = definition_of(msgtype)
        topic = self._bag.add_topic(name, msgtype, text, type_hash, [_offered_qos(info) for info in infos])
        recorded = self.counts[name] = TopicCount()
        numbered = len(infos) == 1

        def received(raw: bytes, info: dict[str, Any]) -> None:
            self._bag.write(topic, time.time_ns(), raw)
            recorded.count += 1
            if numbered:
                recorded.gaps.add(info)

        callback: Any = received  # rclpy's types do not know of raw messages with their information
        self._node.create_subscription(kind, name, callback, _requested_qos(infos), raw=True)
        self._say(f"records {name} ({msgtype})")


def _requested_qos(infos: list[Any]) -> QoSProfile:
    """Return the strictest quality of service that all publishers offer, so that no message is missed."""
    reliable = all(info.qos_profile.reliability == ReliabilityPolicy.RELIABLE for info in infos)
    latched = all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos)
    return QoSProfile(
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _offered_qos(info: Any) -> Qos:  # noqa: ANN401 - rclpy's TopicEndpointInfo
    profile, never = info.qos_profile, QosTime(0, 0)
    reliable = profile.reliability == ReliabilityPolicy.RELIABLE
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return Qos(
        QosHistory.KEEP_LAST,
        max(int(profile.depth), 1),
        QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        False,
    )


def _remove(path: Path) -> None:
    for file in path.iterdir():
        file.unlink()
    path.rmdir()

"""Record topics into a bag until a signal arrives; serialised messages are written unchanged."""

from __future__ import annotations

import math
import os
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from sfr_loc_map.errors import NodeError
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.recorder import BagRecorder
from sfr_loc_map.message_types import COMPRESSED, IMAGE
from sfr_loc_map.ros import environment
from sfr_loc_map.ros.messages import message_type
from sfr_loc_map.ros.peer import Peer
from sfr_loc_map.ros.publishers import publishers_of
from sfr_loc_map.ros.transport import TransportGaps
from sfr_loc_map.signals import hold, stopping
from sfr_loc_map.topics import names, rectified_beside
from sfr_loc_map.transport_issues import silence_of

DEPTH = 200  #: Queue depth of a recorded topic: 2 s of a topic of 100 Hz, for example of an IMU.
DISCOVERY_PERIOD_S = 0.25  #: Period of the search for new topics, s.
OTHER_IMAGES_S = 3.0  #: Time after which topics with images are reported if none of them is recorded, s.
FLUSH_PERIOD_S = 0.5
"""Period at which messages are written to disk, s. A crash loses at most the messages of a period."""


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """What to record."""

    #: Topic names, relative to the namespace. Empty: inputs and outputs of the suite's nodes.
    topics: Sequence[str] = ()
    everything: bool = False  #: Whether all topics except hidden topics are recorded instead.
    namespace: str = ""  #: Namespace of the rover.
    duration_s: float | None = None  #: None: record until a signal arrives.
    zstd: bool = False  #: Whether chunks are compressed.


def record(path: Path, options: RecordOptions, say: Callable[[str], None]) -> dict[str, TransportGaps]:
    """Record topics into a bag at a new path; return the counter of the messages of each topic.

    `say` is called with a line for each topic. Losses are counted on topics with a single publisher.
    If no message was received, no bag is written.
    """
    with _Recorder(options, say) as recorder, stopping() as ended, BagRecorder(path, zstd=options.zstd) as bag:
        now_s = flushed_s = time.monotonic()
        end_s = math.inf if options.duration_s is None else now_s + options.duration_s
        while now_s < end_s and not ended():
            recorder.discover(bag)
            recorder.count_losses()
            recorder.spin(min(DISCOVERY_PERIOD_S, end_s - time.monotonic()), ended)
            now_s = time.monotonic()
            if now_s - flushed_s > FLUSH_PERIOD_S:
                bag.flush()
                flushed_s = now_s
        hold()
        recorder.count_losses()
        silences = recorder.silences()
    if not bag.count:
        shutil.rmtree(path)
        domain = environment.domain()
        reason = f"{silences[0]}; " if silences else "no topic to record has a publisher; "
        raise NodeError(f"no message was received in ROS domain {domain}: {reason}sfr doctor examines the graph")
    for text in silences:
        say(text)
    return recorder.message_counts


class _Recorder(Peer):
    def __init__(self, options: RecordOptions, say: Callable[[str], None]) -> None:
        super().__init__(f"sfr_record_{os.getpid()}")
        self._options, self._say = options, say
        space = options.namespace.strip("/")
        prefix = f"/{space}/" if space else "/"
        chosen = options.topics or names(recorded=True)
        self._wanted = {name if name.startswith("/") else prefix + name for name in chosen}
        self._known: set[str] = set()
        self._search_images_until_s = time.monotonic() + OTHER_IMAGES_S
        self._types: dict[str, tuple[str, ...]] = {}

    def discover(self, bag: BagRecorder) -> None:
        """Subscribe to new topics. Raw images that are also published rectified are recorded only on request."""
        chosen = bool(self._options.topics or self._options.everything)
        for name, types in self.ros_node.get_topic_names_and_types():
            wanted = name in self._wanted or (self._options.everything and "/_" not in name)
            if name in self._known or not wanted:
                continue
            rectified = [] if chosen else rectified_beside(name)
            infos = self.ros_node.get_publishers_info_by_topic(name)
            if infos and not any(map(self.ros_node.count_publishers, rectified)):
                self._known.add(name)
                self._subscribe(bag, name, types[0], infos)
        if time.monotonic() > self._search_images_until_s:
            self._search_images_until_s = math.inf
            self._report_other_images()

    def _report_other_images(self) -> None:
        """Report the topics with images if none of them is recorded, because their names are not those of the suite."""
        types = dict(self.ros_node.get_topic_names_and_types())
        images = [name for name in sorted(types) if {IMAGE, COMPRESSED} & set(types[name])]
        images = [name for name in images if self.ros_node.count_publishers(name)]
        chosen = self._options.topics or self._options.everything
        if images and not chosen and self._known.isdisjoint(images):
            self._say(f"no images are recorded: topics with images are {', '.join(images)}; name topics, or give --all")

    def silences(self) -> list[str]:
        """Return, for each recorded topic without messages, why none was received."""
        found = []
        publishers = {name: publishers_of(self.ros_node, name) for name in self.message_counts}
        heard = {item.node for name, gaps in self.message_counts.items() if gaps.count for item in publishers[name]}
        for name, gaps in self.message_counts.items():
            if not gaps.count:
                silence = silence_of(name, self._types[name], publishers[name], heard=heard)
                found.append(f"no message of {name}: {silence.text}; {silence.fix}")
        return found

    def _subscribe(self, bag: BagRecorder, name: str, msgtype: str, infos: list[Any]) -> None:
        """Subscribe with the strictest quality of service that all publishers offer, so that no message is missed."""
        try:
            kind = message_type(msgtype)
        except NodeError as error:
            self._say(f"{name} is not recorded: {error}")
            return
        definition, digest = "", "RIHS01_unknown"  # unknown to the library, so readers need the type's package
        if msgtype in TYPESTORE.fielddefs:
            definition, digest = TYPESTORE.generate_msgdef(msgtype, ros_version=2)[0], TYPESTORE.hash_rihs01(msgtype)
        topic = bag.add_topic(name, msgtype, definition, digest, [_offered_qos(info) for info in infos])
        self._types[name] = (msgtype,)
        gaps = self.count_messages(name)

        def received(raw: bytes, info: dict[str, Any]) -> None:
            bag.write(topic, time.time_ns(), raw)
            gaps.add(info)

        quality = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        if all(info.qos_profile.reliability == ReliabilityPolicy.RELIABLE for info in infos):
            quality.reliability = ReliabilityPolicy.RELIABLE
        if all(info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos):
            quality.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.subscribe(kind, name, received, quality, raw=True)
        self._say(f"recording {name} ({msgtype})")


def _offered_qos(info: Any) -> Qos:  # noqa: ANN401 - rclpy's TopicEndpointInfo
    offered, never = info.qos_profile, QosTime(0, 0)
    reliable = offered.reliability == ReliabilityPolicy.RELIABLE
    latched = offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
    reliability = QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    depth, liveliness = max(int(offered.depth), 1), QosLiveliness.AUTOMATIC
    return Qos(QosHistory.KEEP_LAST, depth, reliability, durability, never, never, liveliness, never, False)

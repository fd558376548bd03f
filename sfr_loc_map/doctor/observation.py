"""Observations of a bag, a source of files or a running graph as plain values, which `examination` checks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, auto
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.io.bag.bag import Bag, Topic
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.files import bag_files
from sfr_loc_map.io.bag.poses import read_extrinsics
from sfr_loc_map.io.layouts.head_pose import head_poses
from sfr_loc_map.io.message_stream import messages_of
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.source_config import FramesConfig, SourceConfig, SyncConfig
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.io.truth.messages import TRUTH_TYPES
from sfr_loc_map.message_types import COMPRESSED, FIX, JOINTS, POINT, TF
from sfr_loc_map.suite_names import SIDES, Task
from sfr_loc_map.topics import COMPRESSED_END, NAV_POSE, RAW, RECTIFIED, TOPICS, TRUE_POSES, Role, names
from sfr_loc_map.transport_issues import Publisher, Reliability

RIGS = tuple(task.rig for task in Task)
RIG_OF_NODE = {task.node: task.rig for task in Task}
EXPECTED: Mapping[str, tuple[str, ...]] = {
    **{name: (TOPICS[name].msgtype,) for name in names(Role.INPUT, Role.TRUTH)},
    TRUE_POSES: TRUTH_TYPES,
}
"""Accepted message types of each observed topic, by the name of the topic in the suite."""
MESSAGES_KEPT = 4  #: Number of messages that are kept for each topic.


def allowed_types(name: str) -> tuple[str, ...]:
    """Return the types that a topic may have; compressed images may also have the plain name."""
    return (*EXPECTED[name], COMPRESSED) if name.endswith((RECTIFIED, RAW)) else EXPECTED[name]


@dataclass(frozen=True, slots=True)
class ObservedTopic:
    """One topic: its name and types in the bag or graph, and its messages."""

    source_name: str  #: Name in the bag or graph.
    types: tuple[str, ...]
    publishers: tuple[Publisher, ...] | None = None  #: On the graph; None for a recording.
    stamps_ns: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))  #: `(N,)`, in the order of reception.
    messages: tuple[Any, ...] = ()  #: The first messages, with fields as attributes.
    requests: Mapping[str, Reliability] = field(default_factory=dict)  #: Requested reliability by node of the suite.
    lost: int = 0  #: Number of messages that were published between received messages, but were not received.

    @property
    def is_published(self) -> bool:
        """Whether the topic is in the recording, or has a publisher on the graph."""
        return self.publishers is None or bool(self.publishers)


@dataclass(frozen=True, slots=True)
class ObservedNode:
    """A running node of the suite; its name includes the namespace."""

    name: str
    rig: str  #: `loc`, `nav`, or empty for the monitor.
    state: str = "active"  #: Lifecycle state; empty if the node did not answer.
    use_sim_time: bool = False
    extrinsics_given: bool = False  #: Whether the parameters of the node give the extrinsics.
    stamp_tolerance_ns: int | None = None  #: Largest stamp difference of paired messages; None without an answer.
    has_worked: bool = False  #: Whether the node has processed a pair since it became active.
    rectifies: bool = False  #: Whether the node subscribes to raw images and rectifies them.


class SourceKind(Enum):
    """What is observed."""

    BAG = auto()
    FILES = auto()  #: A source of files.
    GRAPH = auto()  #: A running graph, over some time.


@dataclass(frozen=True, slots=True)
class Observation:
    """The observation of a bag, of a source of files, or of a graph over some time.

    For a source of files, and for a bag whose messages the configuration changes, the observed messages are those that
    would be played.
    """

    subject: str  #: Name of the source in messages.
    kind: SourceKind = SourceKind.BAG
    prefix: str = ""  #: Prefix of the suite's names in the graph.
    topics: Mapping[str, ObservedTopic] = field(default_factory=dict)  #: Existing topics by suite name.
    ambiguous: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  #: Possible topics by suite name.
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  #: Types of all topics by name.
    stamp_tolerance_ns: int = SyncConfig().stamp_tolerance_ns
    """Tolerance in the configuration, for rigs without a node."""
    extrinsics_given: bool = False  #: Whether a parameter file gives the extrinsics.
    extrinsics_in_tf: bool | None = False
    """Whether /tf_static, or rig.json for files, gives the extrinsics; None if unreadable."""
    nodes: tuple[ObservedNode, ...] = ()
    has_clock: bool = False  #: /clock is published.
    now_ns: int | None = None  #: Host time at the end of the observation; None for a recording.
    export_line: str = ""  #: Shell command that gives a publisher enough shared memory.
    broken: InputError | None = None  #: Error that ended the reading; None if complete.
    truth_has_attitude: bool = False
    base_frame: str = ""  #: Configured frame of the rover of a bag; empty: a frame with a known name.
    poses_from_head: bool = False
    """Whether a bag without nav/pose has frames or joints, which may give the poses of the mapping pairs."""
    head_problem: InputError | None = None  #: Why these frames or joints do not give the poses; None if they do.
    unfinished: bool = False  #: The bag was not closed; its last second may be missing.
    skipped_pairs: int = 0  #: `Source.skipped_pairs`.

    @property
    def is_live(self) -> bool:
        """Whether the observation is of a running graph."""
        return self.kind is SourceKind.GRAPH

    @property
    def rigs(self) -> list[str]:
        """The rigs to examine: those of running nodes that do not wait, else those with a topic."""
        running = {node.rig for node in self.nodes} - {node.rig for node in self.waiting}
        with_topics = {name.partition("/")[0] for name in self.topics}
        examined = running & set(RIGS) or with_topics
        return [rig for rig in RIGS if rig in examined]

    @property
    def waiting(self) -> list[ObservedNode]:
        """Nodes whose cameras publish nothing on the graph; empty unless the cameras of another node publish."""
        published = {name.partition("/")[0] for name, topic in self.topics.items() if topic.is_published}
        if not any(node.rig in published for node in self.nodes):
            return []
        return [node for node in self.nodes if node.rig and node.rig not in published]

    def node(self, rig: str) -> ObservedNode | None:
        """Return the node of a rig; None if it does not run."""
        return next((node for node in self.nodes if node.rig == rig), None)

    def tolerance_ns(self, rig: str) -> int:
        """Return the largest stamp difference within which the messages of a rig are paired."""
        node = self.node(rig)
        if node is None or node.stamp_tolerance_ns is None:
            return self.stamp_tolerance_ns
        return node.stamp_tolerance_ns

    def image_name(self, rig: str) -> str:
        """Return the last part of the topic names of a rig's images: the name to which its node subscribes.

        Without a node, return the raw name if only raw images are published, else the rectified name.
        """
        node = self.node(rig)
        if node is not None:
            return RAW if node.rectifies else RECTIFIED
        of_rig = [name for name in self.topics if name.startswith(f"{rig}/")]
        return next((kind for kind in (RECTIFIED, RAW) if any(f"/{kind}" in name for name in of_rig)), RECTIFIED)

    def both_images(self, rig: str) -> str:
        """Return the names of a rig's images, for messages."""
        return ", ".join(f"{rig}/{side}/{self.image_name(rig)}" for side in SIDES)

    def images(self, rig: str, side: str) -> ObservedTopic | None:
        """Return the topic of the images of a side, raw or compressed: the topic that has a publisher."""
        plain = f"{rig}/{side}/{self.image_name(rig)}"
        found = [self.topics[name] for name in (plain, f"{plain}{COMPRESSED_END}") if name in self.topics]
        return max(found, key=lambda topic: topic.is_published, default=None)

    def image_stamps(self, rig: str, side: str = "left") -> IntArray:
        """Return the stamps of the images of a side, `(N,)`."""
        topic = self.images(rig, side)
        return topic.stamps_ns if topic is not None else np.zeros(0, np.int64)

    def lost_share(self, rig: str) -> float:
        """Return the fraction of the images of a rig that were lost in transport."""
        topics = [topic for side in SIDES if (topic := self.images(rig, side)) is not None]
        lost = sum(topic.lost for topic in topics)
        return lost / max(lost + sum(len(topic.stamps_ns) for topic in topics), 1)

    def is_idle(self, rig: str) -> bool:
        """Return whether the topics of a rig exist without messages, and this silence is normal."""
        # maps are made occasionally: silence is normal on a graph, and a bag may be recorded between two maps
        is_normal = rig == "nav" if self.is_live else any(self.has_images(other) for other in RIGS if other != rig)
        topics = [self.images(rig, side) for side in SIDES]
        return is_normal and all(topic is not None and topic.is_published and not topic.messages for topic in topics)

    def has_images(self, rig: str) -> bool:
        """Return whether there are images of both sides."""
        return all((topic := self.images(rig, side)) is not None and topic.messages for side in SIDES)


def observe(source: Path, config: SourceConfig, progress: Callable[[], None] = lambda: None) -> Observation:
    """Return the observation of a source; `progress` is called once for each pair that is read.

    The messages of a bag are observed as they were recorded, unless the configuration changes them.
    """
    if is_bag(source) and not config.changes_messages:
        return observe_bag(source, config)
    return observe_source(source, config, progress)


def _collected(
    stream: Iterable[tuple[str, int, Callable[[], Any]]],
) -> tuple[dict[str, ObservedTopic], InputError | None]:
    """Return the topics in a stream of names, stamps and messages, and the error that ended the stream early."""
    stamps = defaultdict[str, list[int]](list)
    kept = defaultdict[str, list[Any]](list)
    broken: InputError | None = None
    try:
        for name, stamp_ns, make in stream:
            stamps[name].append(stamp_ns)
            if len(kept[name]) < MESSAGES_KEPT:
                kept[name].append(make())
    except InputError as error:
        broken = error
    return {
        name: ObservedTopic(name, EXPECTED[name], stamps_ns=np.array(found, np.int64), messages=tuple(kept[name]))
        for name, found in stamps.items()
    }, broken


def observe_bag(path: Path, config: SourceConfig) -> Observation:
    """Observe a bag: all stamps, and the first messages of each topic."""
    subject = f"bag '{path}'"
    try:
        bag = Bag(path, config.topics)
    except InputError as error:
        return Observation(subject, broken=error)
    matches = {name: tuple(bag.matches(name)) for name in EXPECTED}
    topics, broken = _topics_of(bag, {name: found[0] for name, found in matches.items() if len(found) == 1})
    in_tf = False
    if broken is None:
        try:
            in_tf = read_extrinsics(bag, _camera_frame(topics, "loc"), 0.0, config.frames.base) is not None
        except InputError as error:
            broken = error
    nav_ns = _left_nav_stamps(topics)
    poses_from_head = (
        broken is None
        and not bag.matches(NAV_POSE)
        and bool(nav_ns)
        and not {TF, JOINTS}.isdisjoint(bag.topics.values())
    )
    truth = topics.get(TRUE_POSES)
    return Observation(
        subject,
        topics=topics,
        ambiguous={name: found for name, found in matches.items() if len(found) > 1},
        others={name: (kind,) for name, kind in bag.topics.items()},
        stamp_tolerance_ns=config.sync.stamp_tolerance_ns,
        extrinsics_given=config.extrinsics.transform() is not None,
        extrinsics_in_tf=in_tf,
        truth_has_attitude=truth is not None and bool(truth.messages) and not {FIX, POINT} & set(truth.types),
        broken=broken,
        base_frame=config.frames.base,
        poses_from_head=poses_from_head,
        head_problem=_head_problem(bag, topics, nav_ns, config.frames) if poses_from_head else None,
        unfinished=bag.unfinished,
    )


def _topics_of(bag: Bag, source_names: Mapping[str, str]) -> tuple[dict[str, ObservedTopic], InputError | None]:
    """Return the topics of a bag by suite name, and the error that ended the reading early.

    `source_names` are the names in the bag by suite name. A topic of a type that is not allowed has no messages.
    """
    topics = {name: ObservedTopic(found, (bag.topics[found],)) for name, found in source_names.items()}
    readable = [
        Topic(name, topic.source_name, topic.types[0])
        for name, topic in topics.items()
        if topic.types[0] in allowed_types(name)
    ]
    stream = ((topic.name, stamp, partial(bag.deserialise, topic, raw)) for topic, stamp, raw in bag.stream(readable))
    read, broken = _collected(stream)
    for name, topic in read.items():
        topics[name] = replace(topic, source_name=topics[name].source_name, types=topics[name].types)
    return topics, broken


def _camera_frame(topics: Mapping[str, ObservedTopic], rig: str) -> str:
    """Return the frame of the left camera of a rig; empty without a camera_info."""
    infos = topics.get(f"{rig}/left/camera_info")
    return str(infos.messages[0].header.frame_id) if infos is not None and infos.messages else ""


def _left_nav_stamps(topics: Mapping[str, ObservedTopic]) -> list[int]:
    """Return the ascending stamps of the left images for mapping, ns; empty without images."""
    images = [topic for name, topic in topics.items() if name.startswith("nav/left/image_") and topic.messages]
    return np.unique(images[0].stamps_ns).tolist() if images else []


def _head_problem(
    bag: Bag, topics: Mapping[str, ObservedTopic], stamps_ns: Sequence[int], frames: FramesConfig
) -> InputError | None:
    """Return why the frames or joints of a bag do not give the poses of the mapping cameras; None if they do."""
    try:
        head_poses(bag, _camera_frame(topics, "nav"), 0.0, stamps_ns, frames)
    except InputError as error:
        return error
    return None


def observe_source(path: Path, config: SourceConfig, progress: Callable[[], None] = lambda: None) -> Observation:
    """Observe the messages that would be played from a source; every image is read."""
    kind = SourceKind.BAG if is_bag(path) else SourceKind.FILES
    try:
        source = open_source(path, config)
        truth = None if source.loc is None else source.loc.ground_truth
    except InputError as error:
        subject = f"bag '{path}'" if kind is SourceKind.BAG else f"'{path}'"
        return Observation(subject, kind, broken=error)

    def stream() -> Iterator[tuple[str, int, Callable[[], Any]]]:
        for message in messages_of(source):
            yield message.topic, message.stamp_ns, partial(TYPESTORE.deserialize_cdr, message.raw, message.msgtype)
            if message.topic.endswith("left/image_rect"):
                progress()

    topics, broken = _collected(stream())
    return Observation(
        f"'{path}' ({source.format})",
        kind,
        topics=topics,
        stamp_tolerance_ns=config.sync.stamp_tolerance_ns,
        extrinsics_in_tf=source.loc is not None and source.loc.rig.T_rb_sb is not None,
        truth_has_attitude=truth is not None and truth.has_attitude,
        broken=broken,
        base_frame=config.frames.base if kind is SourceKind.BAG else "",
        unfinished=kind is SourceKind.BAG and bag_files(path).are_unfinished,
        skipped_pairs=source.skipped_pairs,
    )

"""What was observed of a bag, a source of files or a running graph, as plain values; judged by `doctor`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.bag import CAMERA_INFO, COMPRESSED, IMAGE, ODOMETRY, POINTS, POSE, Bag, Topic, read_extrinsics
from sfr_loc_map.io.bag_sequence import RAW, RECTIFIED
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source

TASKS = ("loc", "nav")
TASK_OF_NODE = {"localisation_node": "loc", "mapping_node": "nav"}
CAMERAS = tuple(f"{task}/{side}" for task in TASKS for side in SIDES)
EXPECTED: Mapping[str, tuple[str, ...]] = {
    **{f"{camera}/{image}": (IMAGE,) for camera in CAMERAS for image in (RECTIFIED, RAW)},
    **{f"{camera}/{image}/compressed": (COMPRESSED,) for camera in CAMERAS for image in (RECTIFIED, RAW)},
    **{f"{camera}/camera_info": (CAMERA_INFO,) for camera in CAMERAS},
    "nav/pose": (POSE,),
    "ground_truth/odometry": (ODOMETRY,),
    "ground_truth/points": (POINTS,),
}
"""Types of the topics that are observed, by their names in the suite."""
MESSAGES_KEPT = 4
"""Messages of each topic that are kept."""


def allowed_types(name: str) -> tuple[str, ...]:
    """Return the types that a topic may have; compressed images may also come under the plain name."""
    return (*EXPECTED[name], COMPRESSED) if name.endswith((RECTIFIED, RAW)) else EXPECTED[name]


class Reliability(StrEnum):
    """Reliability of a publisher or subscriber."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best_effort"


@dataclass(frozen=True, slots=True)
class ObservedTopic:
    """One topic.

    Attributes:
        found: Its name in the bag or graph.
        types: Types under that name.
        offers: Reliability that each publisher offers; of a bag, one publisher.
        stamps_ns: Stamps of the headers of its messages `(N,)`, in the order of reception.
        messages: The first of them; for readers by attributes.
        requests: Reliability that each node of the suite requests of its publishers, by the node.
        lost: Messages that were published between the received ones and not received.
    """

    found: str
    types: tuple[str, ...]
    offers: tuple[Reliability, ...] = (Reliability.RELIABLE,)
    stamps_ns: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    messages: tuple[Any, ...] = ()
    requests: Mapping[str, Reliability] = field(default_factory=dict)
    lost: int = 0


@dataclass(frozen=True, slots=True)
class ObservedNode:
    """One node of the suite that runs.

    Attributes:
        name: With its namespace.
        task: `loc`, `nav`, or empty for the monitor.
        state: Of the managed node; empty where it did not answer.
        use_sim_time: Whether it follows /clock.
        extrinsics_given: Whether its parameters have the extrinsics of the stereo rig.
        stamp_tolerance_ns: Largest difference of stamps of a pair.
        has_worked: Whether it has processed something since it became active.
        rectifies: Whether it takes raw images and rectifies them itself.
    """

    name: str
    task: str
    state: str = "active"
    use_sim_time: bool = False
    extrinsics_given: bool = False
    stamp_tolerance_ns: int = 0
    has_worked: bool = False
    rectifies: bool = False


@dataclass(frozen=True, slots=True)
class HostMemory:
    """Shared memory of the host.

    Attributes:
        size_bytes: Size of /dev/shm; None where there is none.
        segment_bytes: What each process reserves of it.
        export_line: Line of a shell that gives a process so much.
    """

    size_bytes: int | None = None
    segment_bytes: int = 0
    export_line: str = ""


@dataclass(frozen=True, slots=True)
class Observation:
    """A bag, a source of files, or a graph over some time.

    Attributes:
        subject: What was observed, for messages.
        live: Whether it is a graph.
        prefix: What comes before the suite's names in the graph.
        topics: Expected topics by the suite's names; absent ones are left out.
        ambiguous: Several names found, by the suite's name that each of them could have.
        others: Types of all topics by name.
        extrinsics_given: Whether a parameter file has the extrinsics of the stereo rig.
        extrinsics_in_tf: Whether /tf_static has them; None where it cannot be read.
        nodes: Nodes of the suite that run.
        has_clock: Whether /clock is published.
        now_ns: Time of the host at the end; None where stamps are of a recording: of a bag, beside `sfr replay`.
        memory: Shared memory of the host.
        broken: Why reading ended early, empty if it did not.
        unfinished: Whether the bag was not closed, so that its last second may be missing.
        left_out: Of a source of files (data set folder, KITTI, EuRoC) the pairs that are listed but not there; its
            topics are what it would be played as. None of a bag or a graph.
    """

    subject: str
    live: bool
    prefix: str = ""
    topics: Mapping[str, ObservedTopic] = field(default_factory=dict)
    ambiguous: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    extrinsics_given: bool = False
    extrinsics_in_tf: bool | None = False
    nodes: tuple[ObservedNode, ...] = ()
    has_clock: bool = False
    now_ns: int | None = None
    memory: HostMemory = field(default_factory=HostMemory)
    broken: str = ""
    unfinished: bool = False
    left_out: int | None = None

    @property
    def files(self) -> bool:
        """Whether it is a source of files."""
        return self.left_out is not None

    @property
    def tasks(self) -> list[str]:
        """The tasks that are meant: of nodes that run, else those with a topic."""
        running = [task for task in TASKS if self.node(task) is not None]
        return running or [task for task in TASKS if any(name.startswith(f"{task}/") for name in self.topics)]

    def node(self, task: str) -> ObservedNode | None:
        """Return the node of a task, None where it does not run."""
        return next((node for node in self.nodes if node.task == task), None)

    def image_name(self, task: str) -> str:
        """Return the last part of the names of a task's images: what its node takes, else rectified before raw ones."""
        node = self.node(task)
        if node is not None:
            return RAW if node.rectifies else RECTIFIED
        names = [name for name in self.topics if name.startswith(f"{task}/")]
        return next((kind for kind in (RECTIFIED, RAW) if any(f"/{kind}" in name for name in names)), RECTIFIED)

    def both_images(self, task: str) -> str:
        """Return the names of a task's images, for messages."""
        return ", ".join(f"{task}/{side}/{self.image_name(task)}" for side in SIDES)

    def images(self, task: str, side: str) -> ObservedTopic | None:
        """Return the topic of the images of a side, raw or compressed: the one that has a publisher."""
        plain = f"{task}/{side}/{self.image_name(task)}"
        found = [self.topics[name] for name in (plain, f"{plain}/compressed") if name in self.topics]
        return max(found, key=lambda topic: bool(topic.offers), default=None)

    def image_stamps(self, task: str, side: str = "left") -> IntArray:
        """Return the stamps of the images of a side, `(N,)`."""
        topic = self.images(task, side)
        return topic.stamps_ns if topic is not None else np.zeros(0, np.int64)

    def lost_share(self, task: str) -> float:
        """Return the share of the images of a task that were lost on the way from their publishers."""
        topics = [topic for side in SIDES if (topic := self.images(task, side)) is not None]
        lost = sum(topic.lost for topic in topics)
        return lost / max(lost + sum(len(topic.stamps_ns) for topic in topics), 1)

    def is_idle(self, task: str) -> bool:
        """Tell whether a task has no pair for now, which is no fault.

        The mapping task has pairs only where a map is made, so that silence is usual on a graph; a bag may have been
        recorded while one of the tasks had none.
        """
        usual = task == "nav" if self.live else any(self.has_images(other) for other in TASKS if other != task)
        topics = [self.images(task, side) for side in SIDES]
        return usual and all(topic is not None and topic.offers and not topic.messages for topic in topics)

    def has_images(self, task: str) -> bool:
        """Tell whether there are images of both sides."""
        return all((topic := self.images(task, side)) is not None and topic.messages for side in SIDES)


class _Messages:
    """Collects the stamps and the first messages of topics; what was read before an error stays."""

    def __init__(self) -> None:
        self.stamps: dict[str, list[int]] = {}
        self.kept: dict[str, list[Any]] = {}

    def note(self, name: str, stamp_ns: int, make: Callable[..., Any], *values: object) -> None:
        """Note a stamp of a topic, and while few are kept the message that `make` makes of the values."""
        self.stamps.setdefault(name, []).append(stamp_ns)
        kept = self.kept.setdefault(name, [])
        if len(kept) < MESSAGES_KEPT:
            kept.append(make(*values))

    def of(self, name: str) -> tuple[IntArray, tuple[Any, ...]]:
        return np.array(self.stamps.get(name, []), np.int64), tuple(self.kept.get(name, []))


def observe_bag(path: Path, remap: Mapping[str, str], *, extrinsics_given: bool) -> Observation:
    """Observe a bag: all stamps, a few messages."""
    subject = f"bag '{path}'"
    try:
        bag = Bag(path, remap)
    except InputError as error:
        return Observation(subject, live=False, broken=str(error))
    names: dict[str, list[str]] = {name: bag.matches(name) for name in EXPECTED}
    topics = {n: ObservedTopic(f[0], (bag.topics[f[0]],)) for n, f in names.items() if len(f) == 1}
    readable = [Topic(n, t.found, t.types[0]) for n, t in topics.items() if t.types[0] in allowed_types(n)]
    messages, in_tf, broken = _Messages(), False, ""
    try:
        for topic, stamp_ns, raw in bag.stream(readable):
            messages.note(topic.name, stamp_ns, bag.deserialise, topic, raw)
        in_tf = read_extrinsics(bag) is not None
    except InputError as error:
        broken = str(error)
    for topic in readable:
        stamps_ns, kept = messages.of(topic.name)
        topics[topic.name] = replace(topics[topic.name], stamps_ns=stamps_ns, messages=kept)
    return Observation(
        subject,
        live=False,
        topics=topics,
        ambiguous={name: tuple(found) for name, found in names.items() if len(found) > 1},
        others={name: (kind,) for name, kind in bag.topics.items()},
        extrinsics_given=extrinsics_given,
        extrinsics_in_tf=in_tf,
        broken=broken,
        unfinished=bag.unfinished,
    )


def observe_source(path: Path, *, extrinsics_given: bool, progress: Callable[[], None] = lambda: None) -> Observation:
    """Observe a source of files as the messages that it would be played as: every image is read."""
    messages = _Messages()
    subject, broken, in_file, left_out = f"'{path}'", "", False, 0
    try:
        source = open_source(path)
        subject = f"{source.format} source '{path}'"
        in_file = source.loc is not None and source.loc.rig.T_rb_sb is not None
        left_out = source.left_out
        _read_source(source, messages, progress)
    except InputError as error:
        broken = str(error)
    topics = {name: ObservedTopic(name, EXPECTED[name]) for name in messages.stamps}
    for name, topic in topics.items():
        stamps_ns, kept = messages.of(name)
        topics[name] = replace(topic, stamps_ns=stamps_ns, messages=kept)
    return Observation(
        subject,
        live=False,
        topics=topics,
        extrinsics_given=extrinsics_given,
        extrinsics_in_tf=in_file,
        broken=broken,
        left_out=left_out,
    )


def _read_source(source: Source, messages: _Messages, progress: Callable[[], None]) -> None:
    """Note all messages of a source."""

    def note_rig(task: str, rig: StereoRig) -> None:
        for side in SIDES:
            messages.note(f"{task}/{side}/camera_info", 0, bag_messages.camera_info, 0, rig, task, side)

    def note_pair(task: str, pair: StereoPair) -> None:
        for side in SIDES:
            values = (pair.stamp_ns, getattr(pair, side), task, side)
            messages.note(f"{task}/{side}/image_rect", pair.stamp_ns, bag_messages.image, *values)
        progress()

    if source.loc is not None:
        note_rig("loc", source.loc.rig)
        truth = source.loc.ground_truth or Trajectory.empty()
        for stamp_ns, *pose in zip(truth.stamps_ns.tolist(), truth.positions, truth.quats_xyzw, strict=True):
            messages.note("ground_truth/odometry", stamp_ns, bag_messages.odometry, stamp_ns, *pose)
        for pair in source.loc.pairs():
            note_pair("loc", pair)
    if source.nav is not None:
        note_rig("nav", source.nav.rig)
        for posed in source.nav.pairs():
            stamp_ns = posed.pair.stamp_ns
            messages.note("nav/pose", stamp_ns, bag_messages.pose, stamp_ns, posed.T_lm_navsb)
            if posed.truth is not None:
                messages.note("ground_truth/points", stamp_ns, lambda: None)  # its stamps alone are judged
            note_pair("nav", posed.pair)

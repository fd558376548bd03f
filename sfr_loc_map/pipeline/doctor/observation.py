"""What was seen of a bag or of a running graph, as plain values; judged by `checks`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.constants import SIDES
from sfr_loc_map.io.bag import CAMERA_INFO, COMPRESSED, IMAGE, ODOMETRY, POINTS, POSE

TASKS = ("loc", "nav")
TASK_OF_NODE = {"localisation_node": "loc", "mapping_node": "nav"}
EXPECTED: Mapping[str, tuple[str, ...]] = {
    **{f"{task}/{side}/image_rect": (IMAGE,) for task in TASKS for side in SIDES},
    **{f"{task}/{side}/image_rect/compressed": (COMPRESSED,) for task in TASKS for side in SIDES},
    **{f"{task}/{side}/camera_info": (CAMERA_INFO,) for task in TASKS for side in SIDES},
    "nav/pose": (POSE,),
    "ground_truth/odometry": (ODOMETRY,),
    "ground_truth/points": (POINTS,),
}
"""Types of the topics that are looked at, by their names in the suite; a compressed picture may also come under the
plain name."""
PICTURES_KEPT = 4
"""Pictures of each topic that are looked at."""
Reliability = Literal["reliable", "best_effort"]


@dataclass(frozen=True, slots=True)
class SeenTopic:
    """One topic.

    Attributes:
        found: Its name there.
        types: Types under that name.
        offers: Reliability that each publisher offers; of a bag, one publisher.
        stamps_ns: Stamps of the headers of its messages, as they came.
        messages: The first of them; for readers by attributes.
    """

    found: str
    types: tuple[str, ...]
    offers: tuple[Reliability, ...] = ("reliable",)
    stamps_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    messages: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True)
class SeenNode:
    """One of our nodes that runs.

    Attributes:
        name: With its namespace.
        task: `loc`, `nav`, or empty for another.
        state: Of the managed node; empty where it did not answer.
        reliability: What it asks of the publishers of pictures.
        use_sim_time: Whether it follows /clock.
        place_given: Whether its parameters say where the stereo bench is.
        stamp_tolerance_ns: Largest difference of stamps of a pair.
    """

    name: str
    task: str
    state: str = "active"
    reliability: Reliability = "reliable"
    use_sim_time: bool = False
    place_given: bool = False
    stamp_tolerance_ns: int = 0


@dataclass(frozen=True, slots=True)
class Observation:
    """A bag, or a graph over some time.

    Attributes:
        subject: What was looked at, for messages.
        live: Whether it is a graph.
        prefix: What comes before the suite's names there.
        topics: What is looked at, by the suite's names; a topic that is not there is left out.
        ambiguous: Several names found, by the suite's name that each of them could have.
        others: Types of all topics by name, ours and others.
        place_given: Whether a parameter file says where the stereo bench is.
        place_in_frames: Whether /tf_static does; None where it cannot be read.
        nodes: Ours that run.
        has_clock: Whether somebody publishes /clock.
        now_ns: Time of the host at the end; None of a bag.
        shared_memory_bytes: Size of /dev/shm; None where there is none.
        segment_bytes: What each process reserves of it.
        broken: Why reading ended early, empty if it did not.
        unfinished: Whether the bag was not closed, so that its last second may be missing.
    """

    subject: str
    live: bool
    prefix: str = ""
    topics: Mapping[str, SeenTopic] = field(default_factory=dict)
    ambiguous: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    others: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    place_given: bool = False
    place_in_frames: bool | None = False
    nodes: tuple[SeenNode, ...] = ()
    has_clock: bool = False
    now_ns: int | None = None
    shared_memory_bytes: int | None = None
    segment_bytes: int = 0
    broken: str = ""
    unfinished: bool = False

    def node(self, task: str) -> SeenNode | None:
        """Return the node of a task, None where it does not run."""
        return next((node for node in self.nodes if node.task == task), None)

    def picture(self, task: str, side: str) -> SeenTopic | None:
        """Return the topic of the pictures of a side, raw or compressed: the one that has a publisher."""
        plain = f"{task}/{side}/image_rect"
        found = [self.topics[name] for name in (plain, f"{plain}/compressed") if name in self.topics]
        return max(found, key=lambda topic: bool(topic.offers), default=None)


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is not as it should be.

    Attributes:
        cause: Its kind in one word, for programs.
        stops: Whether something that was asked for does not work; else it is a warning.
        where: Topic, node or file.
        text: What was found.
        cure: What to do.
    """

    cause: str
    stops: bool
    where: str
    text: str
    cure: str

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)

"""The results of a replay: estimate, cloud and calls, how the replay ended, and how an external node behaved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.figures.records import ConventionRecord, ExternalScore, FindingRecord, MethodRecord
from sfr_loc_map.suite_names import Task


@dataclass(frozen=True, slots=True, eq=False)
class ExternalResult:
    """The results about an external node in a replay."""

    method: MethodRecord
    score: ExternalScore  #: Counts of answers, latency and resources.
    findings: tuple[FindingRecord, ...]  #: Errors in its answers.
    log: str = ""  #: Output of its process; empty if the replay did not start the process.
    convention: ConventionRecord | None = None  #: Conversion of its results; None if nothing was converted.
    as_published: Trajectory | None = None  #: Its poses before the conversion by `replay.external.external_poses`.

    @property
    def task(self) -> Task:
        """Task of the node."""
        return Task(self.score.task)


class ReplayedMap(NamedTuple):
    """The map of a replay: a cloud, or the points of an external mapper without pixels. Both are None without a map."""

    cloud: PointCloud | None = None
    points: FloatArray | None = None  #: `(N, 3)` in LM.
    pair_stamps_ns: tuple[int, ...] = ()  #: Stamps of the pairs of the map, in the order of the points' `pair`.

    @property
    def xyz(self) -> FloatArray | FloatArray32 | None:
        """Points `(N, 3)` of the map in LM, m; None without a map."""
        return self.points if self.cloud is None else self.cloud.xyz


class PairCounts(NamedTuple):
    """Numbers of pairs of a rig in a replay."""

    sent: int = 0  #: Pairs that were published to the nodes.
    answered: int = 0  #: Pairs among them for which a node published a result.

    @property
    def missing(self) -> int:
        """Number of pairs without a result."""
        return self.sent - self.answered


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """The results of a replay."""

    estimate: Trajectory  #: Empty without a drive.
    map: ReplayedMap  #: The last map of our mapper, or the map from all clouds of an external one.
    records: Sequence[CallRecord]  #: All calls of localiser and mapper.
    external: ExternalResult | None = None  #: Results about an external node; None without one.
    loc_pairs: PairCounts = field(default_factory=PairCounts)  #: Pairs of the localisation cameras.
    nav_pairs: PairCounts = field(default_factory=PairCounts)  #: Pairs of the navigation cameras.
    clouds: int = 0  #: Number of received clouds, complete or not.
    refused_calls: int = 0  #: Number of invalid calls of an external node, which are ignored.
    first_refusal: str = ""  #: Why the first of these calls is invalid.
    was_interrupted: bool = False  #: Whether a signal ended the replay early.
    rate: float | None = None  #: Multiple of the recorded speed at which the source was played; None in lock step.
    #: Parameters of our localiser and mapper that differ from the defaults, by name.
    settings: Mapping[Task, Mapping[str, object]] = field(default_factory=dict)

    @classmethod
    def empty(cls) -> ReplayResult:
        """Return the result of a replay before its first message."""
        return cls(Trajectory.empty(), ReplayedMap(), ())

    @property
    def methods(self) -> dict[Task, MethodRecord]:
        """The method of each task: ours, or the external node."""
        ours = {task: record_of_ours(task, self.settings.get(task, {})) for task in Task}
        return ours if self.external is None else ours | {self.external.task: self.external.method}

    @property
    def judged_method(self) -> MethodRecord:
        """The method that is judged: the external node, or else our localiser, or else our mapper."""
        if self.external is not None:
            return self.external.method
        return self.methods[Task.LOCALISATION if len(self.estimate) else Task.MAPPING]

    @property
    def has_stats(self) -> bool:
        """Whether there are calls, or findings on an external node."""
        return bool(self.records) or (self.external is not None and bool(self.external.findings))

    @property
    def is_empty(self) -> bool:
        """Whether no node has published a result."""
        return not (len(self.estimate) or self.records or self.clouds)

"""The results of a replay: estimate, cloud and calls, and how an external node behaved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.table.records import ConventionRecord, ExternalScore, FindingRecord, MethodRecord


@dataclass(frozen=True, slots=True, eq=False)
class ExternalResult:
    """The results about an external node in a replay."""

    method: MethodRecord
    score: ExternalScore  # counts of answers, latency and resources
    findings: tuple[FindingRecord, ...]  # errors in its answers
    log: str = ""  # output of its process; empty if the process was not started here
    convention: ConventionRecord | None = None  # conversion of the node's results
    as_published: Trajectory | None = None  # poses of the node before the conversion


class ReplayedMap(NamedTuple):
    """The map of a replay: a cloud, or the points of an external mapper without pixels. Both are None without a map."""

    cloud: PointCloud | None = None
    points: FloatArray | None = None  #: `(N, 3)` in LM.
    pair_stamps_ns: tuple[int, ...] = ()  #: Stamps of the pairs of the map, in the order of the points' `pair`.


class PairCounts(NamedTuple):
    """Numbers of pairs of a rig in a replay."""

    sent: int = 0  #: Pairs that were published to the nodes.
    answered: int = 0  #: Results that a node published for them.

    @property
    def missing(self) -> int:
        """Number of pairs without a result."""
        return max(self.sent - self.answered, 0)


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """The results of a replay."""

    estimate: Trajectory  # empty without a drive
    cloud: PointCloud | None  # the last cloud
    records: Sequence[CallRecord]  # all calls of localiser and mapper
    mapped_ns: tuple[int, ...]  # stamps of the pairs of the cloud, in the order of the points' `pair`
    external: ExternalResult | None = None  # `replay.external_poses` converts the poses of the node
    points: FloatArray | None = None  # `(N, 3)` in LM, of an external mapper without pixels
    posed: PairCounts = field(default_factory=PairCounts)  # pairs of the localisation cameras
    mapped: PairCounts = field(default_factory=PairCounts)  # pairs of the navigation cameras
    clouds: int = 0  # number of received clouds, complete or not

    @classmethod
    def empty(cls) -> ReplayResult:
        """Return the result of a replay before its first message."""
        return cls(Trajectory.empty(), None, (), ())

    @property
    def is_empty(self) -> bool:
        """Whether no node has published a result."""
        return not (len(self.estimate) or self.records or self.clouds)

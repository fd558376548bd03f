"""The results of a replay: estimate, cloud and calls, and how an external node behaved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """The results of a replay."""

    estimate: Trajectory  # empty without a drive
    cloud: PointCloud | None  # the last cloud
    records: Sequence[CallRecord]  # all calls of localiser and mapper
    mapped_ns: tuple[int, ...]  # stamps of the pairs of the cloud, in the order of the points' `pair`
    external: ExternalResult | None = None  # `replay.external_poses` converts the poses of the node
    points: FloatArray | None = None  # `(N, 3)` in LM, of an external mapper without pixels

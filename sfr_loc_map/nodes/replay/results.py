"""What the nodes publish during a replay, as plain values."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import Task
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.pipeline.call_stats import CallRecord
from sfr_loc_map.pipeline.external_run import AnswerBook
from sfr_loc_map.pipeline.replay import ExternalRun, ReplayResult


@dataclass(slots=True)
class ReplayResults:
    """What the nodes have published since the last reset."""

    #: Stamp, position (m) and quaternion (x, y, z, w) of each odometry message, numbers as received.
    rows: list[tuple[int, tuple[float, ...], tuple[float, ...]]] = field(default_factory=list)
    covariances: dict[int, FloatArray] = field(default_factory=dict)  #: Covariance `(6, 6)` of the pose by stamp.
    localisation: dict[int, CallRecord] = field(default_factory=dict)  #: Calls of the localiser by stamp.
    #: Calls of the mapper by state and stamp.
    mapping: dict[tuple[str, int], CallRecord] = field(default_factory=dict)
    clouds: list[tuple[int, PointCloud]] = field(default_factory=list)  #: Stamp and points of each published cloud.
    report: str = ""  #: Last report of the monitor (JSON), empty where there is none.
    input_error: str = ""  #: What a node reports of input that it cannot use, empty if none does.
    #: Task and stamp of each pair that was published to the nodes.
    published: set[tuple[str, int]] = field(default_factory=set)
    whole: bool = False  #: Whether the run was played to its end.
    interrupted: bool = False  #: Whether a signal ended the replay.
    #: Other runs of the replay with results, which a jump or a signal ended, in their order.
    cut_short: tuple[ReplayResults, ...] = ()
    #: What an external node answered, None without one; its poses are in `rows` as it published them.
    answers: AnswerBook | None = None
    #: Stamp and points `(N, 3)` in LM of each cloud of an external node.
    points: list[tuple[int, FloatArray]] = field(default_factory=list)
    external: ExternalRun | None = None  #: What is known of the external node at the end, None without one.

    @property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory."""
        if not self.rows:
            return Trajectory.empty()
        stamps, positions, quats = zip(*self.rows, strict=True)
        return Trajectory(np.array(stamps, np.int64), np.array(positions), np.array(quats))

    @property
    def records(self) -> list[CallRecord]:
        """All calls: those of the localiser, with the covariances of the odometry, then those of the mapper.

        An external localiser has one for each covariance, told or not.
        """
        calls = self.localisation
        if self.answers is not None and self.answers.task == "loc":
            untold = {s: CallRecord(s, float("nan"), TrackingState.TRACKING, None, None) for s in self.covariances}
            calls = untold | calls
        return [*(replace(r, covariance=self.covariances.get(s)) for s, r in calls.items()), *self.mapping.values()]

    @property
    def count(self) -> int:
        """How many results there are."""
        return sum(map(len, (self.rows, self.localisation, self.mapping, self.clouds, self.points)))

    def result(self) -> ReplayResult:
        """Return what came out of the replay, for its score and its files."""
        (cloud, mapped_ns), points = self.last_map(), None
        if self.external is not None and self.external.score.task == Task.MAPPING:
            cloud, points, mapped_ns = self.external_map()
        runs = tuple(run.result() for run in self.cut_short)
        return ReplayResult(self.trajectory, cloud, self.records, self.report, mapped_ns, runs, self.external, points)

    def external_map(self) -> tuple[PointCloud | None, FloatArray | None, tuple[int, ...]]:
        """Return the map of an external node: its cloud, or its points where they tell no pixels; stamps of its pairs.

        Clouds of each played pair are taken together, each with the points of its pair; otherwise the last one is
        taken for the map of all of them.
        """
        pairs = tuple(self.published_stamps("nav"))
        points, clouds = dict(self.points), dict(self.clouds)
        if not points:
            return None, None, ()
        each = len(pairs) > 1 and all(stamp_ns in points for stamp_ns in pairs)
        chosen = pairs if each else (self.points[-1][0],)
        if not all(stamp_ns in clouds for stamp_ns in chosen):
            return None, np.concatenate([points[stamp_ns] for stamp_ns in chosen]), pairs
        parts = [clouds[stamp_ns] for stamp_ns in chosen]
        if each:
            parts = [replace(part, pair=np.full(len(part), k, np.uint8)) for k, part in enumerate(parts)]
        whole = PointCloud.concatenate(parts)
        return replace(whole, fused=not each and len(pairs) > 1, pair_stamps_ns=pairs), None, pairs

    def last_map(self) -> tuple[PointCloud | None, tuple[int, ...]]:
        """Return the last published cloud and the stamps of its pairs, in the order of the points' `pair`.

        Of a mapper that publishes no calls all played pairs are taken to be in it, fused as the topic's contract says.
        """
        if not self.clouds:
            return None, ()
        stamp_ns, cloud = self.clouds[-1]
        call = self.mapping.get((MappingState.FUSED, stamp_ns))
        pairs = () if call is None else call.pair_stamps_ns
        if call is None or not pairs:
            pairs = tuple(self.published_stamps("nav"))
            return replace(cloud, fused=len(pairs) > 1, pair_stamps_ns=pairs), pairs
        return replace(cloud, fused=call.is_fused, pair_stamps_ns=pairs), pairs

    def published_stamps(self, task: str) -> list[int]:
        """Return the stamps of the pairs of a task (`loc` or `nav`) that were published."""
        return sorted(stamp_ns for each, stamp_ns in self.published if each == task)

    def has_pair(self, task: str, stamp_ns: int) -> bool:
        """Tell whether the results of a pair are complete; those of an external node are once nothing is waited for."""
        if self.answers is not None and task == self.answers.task:
            return self.answers.is_settled(stamp_ns)
        if task == "loc":
            return stamp_ns in self.localisation and stamp_ns in self.covariances
        return (MappingState.MAPPED, stamp_ns) in self.mapping

"""What the nodes publish during a replay, as plain values."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.modes import MappingState
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.online.pair_sets import PairSet, PairSets


@dataclass(slots=True)
class ReplayResults:
    """What the nodes have published since the last reset.

    Attributes:
        rows: Stamp, position (m) and quaternion (x, y, z, w) of each odometry message, numbers as received.
        covariances: Covariance `(6, 6)` of the pose by stamp.
        localisation: Calls of the localiser by stamp.
        mapping: Calls of the mapper by state and stamp.
        clouds: Stamp and points of each published cloud.
        report: Last report of the monitor (JSON), empty where there is none.
        input_error: What a node reports of input that it cannot use, empty if none does.
        published: Task and stamp of each pair that was published to the nodes.
        whole: Whether the run was played to its end.
        interrupted: Whether a signal ended the replay.
        cut_short: Other runs of the replay with results, which a jump or a signal ended, in their order.
    """

    rows: list[tuple[int, tuple[float, ...], tuple[float, ...]]] = field(default_factory=list)
    covariances: dict[int, FloatArray] = field(default_factory=dict)
    localisation: dict[int, CallRecord] = field(default_factory=dict)
    mapping: dict[tuple[str, int], CallRecord] = field(default_factory=dict)
    clouds: list[tuple[int, PointCloud]] = field(default_factory=list)
    report: str = ""
    input_error: str = ""
    published: set[tuple[str, int]] = field(default_factory=set)
    whole: bool = False
    interrupted: bool = False
    cut_short: tuple[ReplayResults, ...] = ()

    @property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory."""
        if not self.rows:
            return Trajectory.empty()
        stamps, positions, quats = zip(*self.rows, strict=True)
        return Trajectory(np.array(stamps, np.int64), np.array(positions), np.array(quats))

    @property
    def records(self) -> list[CallRecord]:
        """All calls: those of the localiser, with the covariances of the odometry, then those of the mapper."""
        localised = [replace(r, covariance=self.covariances.get(s)) for s, r in self.localisation.items()]
        return [*localised, *self.mapping.values()]

    @property
    def count(self) -> int:
        """How many results there are."""
        return len(self.rows) + len(self.localisation) + len(self.mapping) + len(self.clouds)

    def last_map(self) -> tuple[PointCloud | None, tuple[int, ...]]:
        """Return the last published cloud and the stamps of its pairs, in the order of the points' `pair`.

        Of a mapper that publishes no calls all played pairs are taken to be in it, fused as the topic's contract says.
        """
        if not self.clouds:
            return None, ()
        stamp_ns, cloud = self.clouds[-1]
        sets = PairSets()
        known = {record.stamp_ns: sets.add(record) for record in self.mapping.values()}
        pairs = known.get(stamp_ns)
        if pairs is None:
            stamps = tuple(self.published_stamps("nav"))
            pairs = PairSet(stamps, len(stamps) > 1)
        return replace(cloud, fused=pairs.fused, pair_stamps_ns=pairs.stamps_ns), pairs.stamps_ns

    def published_stamps(self, task: str) -> list[int]:
        """Return the stamps of the pairs of a task (`loc` or `nav`) that were published."""
        return sorted(stamp_ns for each, stamp_ns in self.published if each == task)

    def has_pair(self, task: str, stamp_ns: int) -> bool:
        """Tell whether the results of a pair are complete."""
        if task == "loc":
            return stamp_ns in self.localisation and stamp_ns in self.covariances
        return (MappingState.MAPPED, stamp_ns) in self.mapping

    def are_complete(self, clouds: int) -> bool:
        """Tell whether each published pair has its results, and so many clouds have been received."""
        return all(self.has_pair(*pair) for pair in self.published) and len(self.clouds) >= clouds

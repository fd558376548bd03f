"""What was published to the nodes and received from them during a replay, as plain values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord, first_reported
from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.frames.covariance import UPPER, symmetric
from sfr_loc_map.replay.result import ExternalResult, PairCounts, ReplayedMap, ReplayResult
from sfr_loc_map.suite_names import Task

StampedPose = tuple[int, tuple[float, ...], tuple[float, ...]]
"""Stamp (ns), position (m) and quaternion (x, y, z, w)."""


@dataclass(slots=True)
class ReceivedDrive:
    """The published pairs of a drive, and the poses and calls that its localiser has published.

    The first call of a stamp counts, as the first answer of an external node does.
    """

    sent_ns: set[int] = field(default_factory=set)  #: Stamps of the published pairs.
    poses: list[StampedPose] = field(default_factory=list)  #: Poses as received, those of an external node unconverted.
    covariances: dict[int, FloatArray] = field(default_factory=dict)  #: Covariance `(6, 6)` of each pose by stamp.
    calls: dict[int, CallRecord] = field(default_factory=dict)  #: Calls by stamp.

    def add_pose(self, pose: StampedPose, covariance: FloatArray) -> None:
        """Add a pose with its covariance `(6, 6)`."""
        self.poses.append(pose)
        self.covariances[pose[0]] = covariance

    def add_call(self, call: CallRecord) -> None:
        """Add a call unless there is one of its stamp."""
        self.calls.setdefault(call.stamp_ns, call)

    def has_pair(self, stamp_ns: int) -> bool:
        """Return whether the pose and the call of a pair were received."""
        return stamp_ns in self.covariances and stamp_ns in self.calls

    @property
    def count(self) -> int:
        """Number of received messages."""
        return len(self.poses) + len(self.calls)

    @property
    def posed_ns(self) -> set[int]:
        """Stamps of the published pairs whose poses were received."""
        return self.sent_ns & self.covariances.keys()

    @property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory."""
        if not self.poses:
            return Trajectory.empty()
        stamps, positions, quats = zip(*self.poses, strict=True)
        return Trajectory(np.array(stamps, np.int64), np.array(positions), np.array(quats))

    @property
    def version(self) -> str | None:
        """Version that the calls of the localiser report; None without one."""
        return _last_version(self.calls.values())

    @property
    def records(self) -> list[CallRecord]:
        """All calls with the covariances of their poses. A pose without a call has a call of unknown time and state."""
        calls = {stamp_ns: CallRecord(stamp_ns, None) for stamp_ns in self.covariances} | self.calls
        return [_with_covariance(call, self.covariances.get(stamp_ns)) for stamp_ns, call in calls.items()]


class ReceivedCloud(NamedTuple):
    """A cloud of a mapper."""

    stamp_ns: int  #: Stamp of its pair; for several pairs, of the last pair.
    points: FloatArray | FloatArray32  #: `(N, 3)` in LM, m.
    cloud: PointCloud | None  #: The points with all fields; None if an external node publishes no pixels.


@dataclass(slots=True)
class ReceivedMaps:
    """The published pairs of maps, and the clouds and calls that their mapper has published.

    The first call of a state and stamp counts, as the first answer of an external node does.
    """

    sent_ns: set[int] = field(default_factory=set)  #: Stamps of the published pairs.
    clouds: list[ReceivedCloud] = field(default_factory=list)  #: Clouds as received, those of an external node in LM.
    calls: dict[tuple[str, int], CallRecord] = field(default_factory=dict)  #: Calls by state and stamp.

    def add_cloud(self, cloud: ReceivedCloud) -> None:
        """Add a cloud."""
        self.clouds.append(cloud)

    def add_call(self, call: CallRecord) -> None:
        """Add a call unless there is one of its state and stamp."""
        self.calls.setdefault((call.state, call.stamp_ns), call)

    def has_pair(self, stamp_ns: int) -> bool:
        """Return whether the call of a pair was received."""
        return (MappingState.MAPPED, stamp_ns) in self.calls

    @property
    def count(self) -> int:
        """Number of received messages."""
        return len(self.clouds) + len(self.calls)

    @property
    def version(self) -> str | None:
        """Version that the calls of the mapper report; None without one."""
        return _last_version(self.calls.values())

    @property
    def records(self) -> list[CallRecord]:
        """All calls."""
        return [*self.calls.values()]

    @property
    def mapped_ns(self) -> list[int]:
        """Stamps of the published pairs whose calls were received, sorted."""
        return [stamp_ns for stamp_ns in sorted(self.sent_ns) if self.has_pair(stamp_ns)]

    @property
    def map_count(self) -> int:
        """Number of complete maps of our mapper, for which the cloud and its call were received."""
        return sum((MappingState.MAPPED_SET, item.stamp_ns) in self.calls for item in self.clouds)

    @property
    def map(self) -> ReplayedMap:
        """The last cloud whose call was received, with the pairs that the call names."""
        for item in reversed(self.clouds):
            call = self.calls.get((MappingState.FUSED, item.stamp_ns))
            if call is not None and item.cloud is not None:
                cloud = replace(item.cloud, fused=call.is_fused, pair_stamps_ns=call.pair_stamps_ns)
                return ReplayedMap(cloud, None, call.pair_stamps_ns)
        return ReplayedMap()


@dataclass(slots=True)
class ExternalMaps(ReceivedMaps):
    """Maps whose mapper is an external node."""

    @property
    def mapped_ns(self) -> list[int]:
        """Stamps of the published pairs that have a cloud, sorted.

        If the only cloud is the map of all pairs, every pair has a cloud.
        """
        mapped = self._clouds_of_pairs
        if self._is_of_all_pairs(mapped):
            return sorted(self.sent_ns)
        return [item.stamp_ns for item in mapped]

    @property
    def map(self) -> ReplayedMap:
        """The map from all clouds, which have the stamps of their pairs.

        A cloud is the map of all pairs if it is the only cloud, has the stamp of the last pair, and its points name
        several pairs in their field `pair`. Otherwise all points of a cloud belong to the pair with its stamp. If a
        cloud has no pixels, the map has only points.
        """
        pairs_ns = tuple(sorted(self.sent_ns))
        mapped = self._clouds_of_pairs
        if not mapped:
            return ReplayedMap()
        with_pixels = [(item.stamp_ns, item.cloud) for item in mapped if item.cloud is not None]
        if len(with_pixels) < len(mapped):
            points = np.concatenate([item.points for item in mapped], dtype=np.float64)
            return ReplayedMap(None, points, pairs_ns)
        is_of_all_pairs = self._is_of_all_pairs(mapped)
        if is_of_all_pairs:
            _, cloud = with_pixels[0]
        else:
            parts = [_of_pair(cloud, pairs_ns.index(stamp_ns)) for stamp_ns, cloud in with_pixels]
            cloud = PointCloud.concatenate(parts)
        cloud = replace(cloud, fused=is_of_all_pairs, pair_stamps_ns=pairs_ns)
        return ReplayedMap(cloud, None, pairs_ns)

    @property
    def _clouds_of_pairs(self) -> list[ReceivedCloud]:
        """The clouds that have the stamp of a published pair, in the order of the stamps."""
        by_stamp = {item.stamp_ns: item for item in self.clouds}
        return [by_stamp[stamp_ns] for stamp_ns in sorted(self.sent_ns) if stamp_ns in by_stamp]

    def _is_of_all_pairs(self, mapped: list[ReceivedCloud]) -> bool:
        """Return whether the clouds of pairs are one cloud of all pairs."""
        if len(mapped) != 1 or mapped[0].cloud is None or mapped[0].stamp_ns != max(self.sent_ns):
            return False
        cloud = mapped[0].cloud
        numbers = np.unique(cloud.pair[np.isfinite(cloud.xyz).all(axis=1)])
        return len(numbers) > 1 and int(numbers[-1]) < len(self.sent_ns)


@dataclass(slots=True)
class Received:
    """What was published and received during a replay.

    `session` adds the published pairs, `collector.ResultCollector` all calls and the results of the suite's nodes, and
    the converter of an external node the results of this node.
    """

    drive: ReceivedDrive = field(default_factory=ReceivedDrive)
    maps: ReceivedMaps = field(default_factory=ReceivedMaps)
    external_task: Task | None = None  #: Task of the external node; None without one.
    refused_calls: int = 0  #: Number of invalid calls of an external node.
    first_refusal: str = ""  #: Why the first of these calls is invalid.

    @classmethod
    def without_messages(cls, external_task: Task | None) -> Received:
        """Return the empty store of a replay; `external_task` is the task of an external node, None without one."""
        maps = ExternalMaps() if external_task is Task.MAPPING else ReceivedMaps()
        return cls(maps=maps, external_task=external_task)

    def add_pair(self, task: Task, stamp_ns: int) -> None:
        """Add a pair that was published."""
        self.of(task).sent_ns.add(stamp_ns)

    def of(self, task: Task) -> ReceivedDrive | ReceivedMaps:
        """Return the pairs and results of a task."""
        return self.drive if task is Task.LOCALISATION else self.maps

    @property
    def count(self) -> int:
        """Number of received messages."""
        return self.drive.count + self.maps.count

    def result(
        self,
        external: ExternalResult | None,
        rate: float | None = None,
        settings: Mapping[Task, Mapping[str, object]] = MappingProxyType({}),
    ) -> ReplayResult:
        """Return the results of a replay at a rate and with changed settings, for its score and its files."""
        drive, maps = self.drive, self.maps
        return ReplayResult(
            drive.trajectory,
            maps.map,
            [*drive.records, *maps.records],
            external,
            loc_pairs=PairCounts(len(drive.sent_ns), len(drive.posed_ns)),
            nav_pairs=PairCounts(len(maps.sent_ns), len(maps.mapped_ns)),
            clouds=len(maps.clouds),
            refused_calls=self.refused_calls,
            first_refusal=self.first_refusal,
            rate=rate,
            settings=settings,
        )


def _of_pair(cloud: PointCloud, number: int) -> PointCloud:
    """Return a cloud in which every point has the given number of its pair."""
    return replace(cloud, pair=np.full(len(cloud), number, np.uint8))


def _last_version(calls: Iterable[CallRecord]) -> str | None:
    """Return the last version that calls of a node report; None without one."""
    versions = [call.version for call in calls if call.version]
    return versions[-1] if versions else None


def _with_covariance(call: CallRecord, published: FloatArray | None) -> CallRecord:
    """Return a call with the covariance `(6, 6)` that `first_reported` chooses from that of its pose and its own."""
    candidates = (None if matrix is None else matrix[None, *UPPER] for matrix in (published, call.covariance))
    found = first_reported(*candidates)
    return replace(call, covariance=None if found is None else symmetric(found[0]))

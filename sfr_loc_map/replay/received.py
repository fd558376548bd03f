"""What was published to the nodes and received from them during a replay, as plain values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
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

    A later call of our localiser replaces an earlier one of the same stamp. Of an external localiser the first call
    counts, as its first answer does.
    """

    is_external: bool = False  #: Whether the localiser is an external node.
    sent_ns: set[int] = field(default_factory=set)  #: Stamps of the published pairs.
    poses: list[StampedPose] = field(default_factory=list)  #: Poses as received, those of an external node unconverted.
    covariances: dict[int, FloatArray] = field(default_factory=dict)  #: Covariance `(6, 6)` of each pose by stamp.
    calls: dict[int, CallRecord] = field(default_factory=dict)  #: Calls by stamp.

    def add_pose(self, pose: StampedPose, covariance: FloatArray) -> None:
        """Add a pose with its covariance `(6, 6)`."""
        self.poses.append(pose)
        self.covariances[pose[0]] = covariance

    def add_call(self, call: CallRecord) -> None:
        """Add a call."""
        if not self.is_external or call.stamp_ns not in self.calls:
            self.calls[call.stamp_ns] = call

    def has_pair(self, stamp_ns: int) -> bool:
        """Return whether the pose and the call of a pair were received."""
        return stamp_ns in self.covariances and stamp_ns in self.calls

    @property
    def count(self) -> int:
        """Number of received messages."""
        return len(self.poses) + len(self.calls)

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
        """All calls with the covariances of their poses.

        An external localiser has one call for each pose, even if it reports no calls.
        """
        calls = self.calls
        if self.is_external:
            calls = {stamp_ns: CallRecord(stamp_ns, float("nan")) for stamp_ns in self.covariances} | calls
        return [
            replace(call, covariance=_reported_covariance(self.covariances.get(stamp_ns), call.covariance))
            for stamp_ns, call in calls.items()
        ]


class ReceivedCloud(NamedTuple):
    """A cloud of a mapper."""

    stamp_ns: int  #: Stamp of its pair; for several pairs, of the last pair.
    points: FloatArray | FloatArray32  #: `(N, 3)` in LM, m.
    cloud: PointCloud | None  #: The points with all fields; None if an external node publishes no pixels.


@dataclass(slots=True)
class ReceivedMaps:
    """The published pairs of maps, and the clouds and calls that their mapper has published.

    Calls of one state and stamp count as in `ReceivedDrive`.
    """

    is_external: bool = False  #: Whether the mapper is an external node.
    sent_ns: set[int] = field(default_factory=set)  #: Stamps of the published pairs.
    clouds: list[ReceivedCloud] = field(default_factory=list)  #: Clouds as received, those of an external node in LM.
    calls: dict[tuple[str, int], CallRecord] = field(default_factory=dict)  #: Calls by state and stamp.

    def add_cloud(self, stamp_ns: int, cloud: PointCloud) -> None:
        """Add a cloud with all fields."""
        self.clouds.append(ReceivedCloud(stamp_ns, cloud.xyz, cloud))

    def add_external_cloud(self, stamp_ns: int, points: FloatArray, cloud: PointCloud | None) -> None:
        """Add the points `(N, 3)` in LM of a cloud of an external node, with all fields if it has pixels."""
        self.clouds.append(ReceivedCloud(stamp_ns, points, cloud))

    def add_call(self, call: CallRecord) -> None:
        """Add a call."""
        key = call.state, call.stamp_ns
        if not self.is_external or key not in self.calls:
            self.calls[key] = call

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
        """The last complete map of our mapper, or the map of an external node."""
        return self._external_map() if self.is_external else self._last_map()

    def _last_map(self) -> ReplayedMap:
        """Return the last cloud of our mapper whose call was received. The call names the pairs of the cloud."""
        for item in reversed(self.clouds):
            call = self.calls.get((MappingState.FUSED, item.stamp_ns))
            if call is not None and item.cloud is not None:
                whole = replace(item.cloud, fused=call.is_fused, pair_stamps_ns=call.pair_stamps_ns)
                return ReplayedMap(whole, None, call.pair_stamps_ns)
        return ReplayedMap()

    def _external_map(self) -> ReplayedMap:
        """Return the map of an external node from all its clouds, which have the stamps of their pairs.

        The map is a cloud if the pixel of each point is known, and points otherwise. A single cloud with the stamp of
        the last of several pairs is the map of all pairs. Otherwise each cloud belongs to the pair with its stamp, and
        the clouds are concatenated.
        """
        pairs_ns = tuple(sorted(self.sent_ns))
        by_stamp = {item.stamp_ns: item for item in self.clouds if item.stamp_ns in self.sent_ns}
        mapped = [by_stamp[stamp_ns] for stamp_ns in sorted(by_stamp)]
        clouds = [item.cloud for item in mapped if item.cloud is not None]
        if not mapped:
            return ReplayedMap()
        if len(clouds) < len(mapped):
            return ReplayedMap(None, np.concatenate([item.points for item in mapped], dtype=np.float64), pairs_ns)
        is_of_all_pairs = len(pairs_ns) > 1 and [*by_stamp] == [pairs_ns[-1]]
        if is_of_all_pairs:
            (whole,) = clouds
        else:
            numbers = [pairs_ns.index(item.stamp_ns) for item in mapped]
            whole = PointCloud.concatenate(
                [_as_pair(cloud, number) for cloud, number in zip(clouds, numbers, strict=True)]
            )
        return ReplayedMap(replace(whole, fused=is_of_all_pairs, pair_stamps_ns=pairs_ns), None, pairs_ns)


@dataclass(frozen=True, slots=True)
class Received:
    """What was published and received during a replay. Only the receiver of a task adds the results of this task."""

    drive: ReceivedDrive = field(default_factory=ReceivedDrive)
    maps: ReceivedMaps = field(default_factory=ReceivedMaps)

    @classmethod
    def without_messages(cls, external_task: Task | None) -> Received:
        """Return the start of a replay in which an external node has a task; None without one."""
        return cls(
            ReceivedDrive(is_external=external_task is Task.LOCALISATION),
            ReceivedMaps(is_external=external_task is Task.MAPPING),
        )

    def of(self, task: Task) -> ReceivedDrive | ReceivedMaps:
        """Return the pairs and results of a task."""
        return self.drive if task is Task.LOCALISATION else self.maps

    @property
    def count(self) -> int:
        """Number of received messages."""
        return self.drive.count + self.maps.count

    def result(self, external: ExternalResult | None) -> ReplayResult:
        """Return the results of the replay, for its score and its files."""
        drive, maps = self.drive, self.maps
        return ReplayResult(
            drive.trajectory,
            maps.map,
            [*drive.records, *maps.records],
            external,
            loc_pairs=PairCounts(len(drive.sent_ns), len(drive.sent_ns & drive.covariances.keys())),
            nav_pairs=PairCounts(len(maps.sent_ns), len(maps.mapped_ns)),
            clouds=len(maps.clouds),
        )


def _as_pair(cloud: PointCloud, number: int) -> PointCloud:
    """Return a cloud whose points are all of the pair with a number."""
    return replace(cloud, pair=np.full(len(cloud), number, np.uint8))


def _last_version(calls: Iterable[CallRecord]) -> str | None:
    """Return the last version that calls of a node report; None without one."""
    versions = [call.version for call in calls if call.version]
    return versions[-1] if versions else None


def _reported_covariance(published: FloatArray | None, of_call: FloatArray | None) -> FloatArray | None:
    """Return the covariance `(6, 6)` of a pose that `first_reported` chooses; None if neither is reported."""
    found = first_reported(*(None if matrix is None else matrix[None, *UPPER] for matrix in (published, of_call)))
    return None if found is None else symmetric(found[0])

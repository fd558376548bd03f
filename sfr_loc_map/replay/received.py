"""Results that the nodes publish during a replay, as plain values."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord, first_reported
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.frames.association import UPPER, symmetric
from sfr_loc_map.replay.result import ExternalResult, ReplayResult
from sfr_loc_map.suite_names import Task

StampedPose = tuple[int, tuple[float, ...], tuple[float, ...]]
"""Stamp (ns), position (m) and quaternion (x, y, z, w)."""


@dataclass(slots=True)
class ReceivedResults:
    """Pairs that were published to the nodes, and results that the nodes have published.

    The collector adds the pairs and the results of the suite's nodes, an external node the results that it published.
    """

    external_task: Task | None = None  #: Task of the external node, None without one.
    #: Pose of each odometry message, as received. The poses of an external node are not converted.
    poses: list[StampedPose] = field(default_factory=list)
    covariances: dict[int, FloatArray] = field(default_factory=dict)  #: Covariance `(6, 6)` of each pose by stamp.
    #: Calls of each task by state (empty for localisation) and stamp.
    calls: dict[Task, dict[tuple[str, int], CallRecord]] = field(default_factory=lambda: {task: {} for task in Task})
    clouds: list[tuple[int, PointCloud]] = field(default_factory=list)  #: Stamp and content of each cloud with pixels.
    #: Rig (`loc`, `nav`) and stamp of each pair that was published to the nodes.
    sent_pairs: set[tuple[str, int]] = field(default_factory=set)
    #: Stamp and points `(N, 3)` in LM of each cloud of an external node, whose clouds may lack pixels.
    points: list[tuple[int, FloatArray]] = field(default_factory=list)
    external: ExternalResult | None = None  #: Answers and process of the external node; set at the end of the replay.

    def add_pose(self, pose: StampedPose, covariance: FloatArray) -> None:
        """Add a pose with its covariance `(6, 6)`."""
        self.poses.append(pose)
        self.covariances[pose[0]] = covariance

    def add_cloud(self, stamp_ns: int, cloud: PointCloud) -> None:
        """Add a cloud."""
        self.clouds.append((stamp_ns, cloud))

    def add_points(self, stamp_ns: int, points: FloatArray) -> None:
        """Add the points `(N, 3)` in LM of a cloud of an external node."""
        self.points.append((stamp_ns, points))

    def add_call(self, task: Task, call: CallRecord) -> None:
        """Add a call; a later call of the same state and stamp replaces it.

        Of an external node the first call counts, as its first answer does.
        """
        place = call.state if task is Task.MAPPING else "", call.stamp_ns
        if task is self.external_task:
            self.calls[task].setdefault(place, call)
        else:
            self.calls[task][place] = call

    def add_sent(self, rig: str, stamp_ns: int) -> None:
        """Add a pair that was published."""
        self.sent_pairs.add((rig, stamp_ns))

    @property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory."""
        if not self.poses:
            return Trajectory.empty()
        stamps, positions, quats = zip(*self.poses, strict=True)
        return Trajectory(np.array(stamps, np.int64), np.array(positions), np.array(quats))

    @property
    def records(self) -> list[CallRecord]:
        """All calls: first those of the localiser, with the covariances of their poses, then those of the mapper.

        An external localiser has one call for each pose, even if it reports no calls.
        """
        calls = {stamp_ns: call for (_, stamp_ns), call in self.calls[Task.LOCALISATION].items()}
        if self.external_task is Task.LOCALISATION:
            unreported = {stamp_ns: CallRecord(stamp_ns, float("nan")) for stamp_ns in self.covariances}
            calls = unreported | calls
        localised = [
            replace(call, covariance=_reported_covariance(self.covariances.get(stamp_ns), call.covariance))
            for stamp_ns, call in calls.items()
        ]
        return [*localised, *self.calls[Task.MAPPING].values()]

    @property
    def count(self) -> int:
        """Number of results."""
        calls = sum(map(len, self.calls.values()))
        return calls + len(self.poses) + len(self.clouds) + len(self.points)

    @property
    def map_count(self) -> int:
        """Number of complete maps of our mapper, for which the cloud and its call were received."""
        mapped = self.calls[Task.MAPPING]
        return sum((MappingState.MAPPED_SET, stamp_ns) in mapped for stamp_ns, _ in self.clouds)

    @property
    def mapped_stamps(self) -> list[int]:
        """Stamps of the published pairs whose results our mapper has published."""
        rig = Task.MAPPING.rig
        return [stamp_ns for stamp_ns in self.sent_stamps(rig) if self.has_pair(rig, stamp_ns)]

    def replay_result(self) -> ReplayResult:
        """Return the results of the replay, for its score and its files."""
        points: FloatArray | None = None
        if self.external_task is Task.MAPPING:
            cloud, points, mapped_ns = self.external_map()
        else:
            cloud, mapped_ns = self.last_map()
        return ReplayResult(self.trajectory, cloud, self.records, mapped_ns, self.external, points)

    def external_map(self) -> tuple[PointCloud | None, FloatArray | None, tuple[int, ...]]:
        """Return the map of an external node as a cloud or as points, and the stamps of its pairs.

        The map is a cloud if the pixel of each point is known. Otherwise the cloud is None and the points are
        returned. A single cloud with the stamp of the last of several pairs is the map of all pairs. Otherwise each
        cloud is that of the pair of its stamp, and the clouds are concatenated.
        """
        pairs = tuple(self.sent_stamps(Task.MAPPING.rig))
        points, clouds = dict(self.points), dict(self.clouds)
        mapped = [stamp_ns for stamp_ns in pairs if stamp_ns in points]
        if not mapped:
            return None, None, ()
        if any(stamp_ns not in clouds for stamp_ns in mapped):
            return None, np.concatenate([points[stamp_ns] for stamp_ns in mapped]), pairs
        is_of_all_pairs = len(pairs) > 1 and mapped == [pairs[-1]]
        if is_of_all_pairs:
            whole = clouds[pairs[-1]]
        else:
            numbers = [pairs.index(stamp_ns) for stamp_ns in mapped]
            of_pairs = zip(numbers, (clouds[stamp_ns] for stamp_ns in mapped), strict=True)
            whole = PointCloud.concatenate(
                [replace(cloud, pair=np.full(len(cloud), number, np.uint8)) for number, cloud in of_pairs]
            )
        return replace(whole, fused=is_of_all_pairs, pair_stamps_ns=pairs), None, pairs

    def last_map(self) -> tuple[PointCloud | None, tuple[int, ...]]:
        """Return the last complete map and the stamps of its pairs, in the order of the points' `pair`."""
        fusions = self.calls[Task.MAPPING]
        for stamp_ns, cloud in reversed(self.clouds):
            if (call := fusions.get((MappingState.FUSED, stamp_ns))) is not None:
                return replace(cloud, fused=call.is_fused, pair_stamps_ns=call.pair_stamps_ns), call.pair_stamps_ns
        return None, ()

    def sent_stamps(self, rig: str) -> list[int]:
        """Return the stamps of the pairs of a rig (`loc` or `nav`) that were published."""
        return sorted(stamp_ns for each, stamp_ns in self.sent_pairs if each == rig)

    def has_pair(self, rig: str, stamp_ns: int) -> bool:
        """Return whether the results of a pair of a node of the suite are complete."""
        if rig == Task.LOCALISATION.rig:
            is_posed = stamp_ns in self.covariances  # each pose has a covariance
            return is_posed and ("", stamp_ns) in self.calls[Task.LOCALISATION]
        return (MappingState.MAPPED, stamp_ns) in self.calls[Task.MAPPING]


def _reported_covariance(published: FloatArray | None, of_call: FloatArray | None) -> FloatArray | None:
    """Return the covariance `(6, 6)` of a pose that `first_reported` chooses; None if neither is reported."""
    found = first_reported(*(None if matrix is None else matrix[None, *UPPER] for matrix in (published, of_call)))
    return None if found is None else symmetric(found[0])

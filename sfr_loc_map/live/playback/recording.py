"""A recorded run as moments in their order. Each task has a clock of its own, which begins with its first stamp."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import attrgetter

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import LOST_VARIANCE, NS_PER_S, SIDES
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.live.cloud_truth import CloudTruth
from sfr_loc_map.live.elevation import grid_of_cloud
from sfr_loc_map.live.media import cloud_sample
from sfr_loc_map.live.updates import CloudSample, ElevationSample, PoseSample, Status, StatusKind, Track
from sfr_loc_map.metrics.association import UPPER, Estimates
from sfr_loc_map.metrics.cloud_error import ScoredMap
from sfr_loc_map.pipeline.call_stats import CallRecord
from sfr_loc_map.pipeline.monitor_score import MonitorScore

LOST = np.eye(6) * LOST_VARIANCE
MAPPING_NODE, POINTS = "mapping_node", "mapping/points"


@dataclass(frozen=True, slots=True)
class RecordedStatus:
    """One status of /diagnostics.

    Attributes:
        at_s: Its place on the time line.
        status: As a feed would tell it; the time of its receipt is filled in when it is played.
        record: The call that it describes, None where it describes something else.
    """

    at_s: float
    status: Status
    record: CallRecord | None


@dataclass(frozen=True, slots=True)
class Moment:
    """Something that has happened.

    Attributes:
        at_s: Seconds since the begin of its task.
        shown: What the views are told; the time of its receipt is filled in when it is played.
        score: Tells the score of it.
    """

    at_s: float
    shown: PoseSample | Status | CloudSample | ElevationSample
    score: Callable[[MonitorScore], None] | None = None


@dataclass(frozen=True, slots=True)
class Frame:
    """One image of a pair.

    Attributes:
        at_s: Seconds since the begin of its task.
        topic: Such as `loc/left`.
        stamp_ns: Its stamp.
        image: Its pixels.
    """

    at_s: float
    topic: str
    stamp_ns: int
    image: GreyImage


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMap:
    """A map with its truth.

    Attributes:
        cloud: The map.
        sample: The same thinned for the screen, with the stamp of its last pair.
        grid: The same from above; None of an empty cloud.
        rig: Rig of its pairs, None where it is not known.
        pairs: Its pairs, without any where there is no source.
        scored: Its score, once it was made: it takes seconds, and whoever jumps back does not wait for it again.
    """

    cloud: PointCloud
    sample: CloudSample
    grid: ElevationSample | None
    rig: StereoRig | None
    pairs: Sequence[PosedStereoPair]
    scored: list[ScoredMap] = field(default_factory=list)

    @classmethod
    def of(cls, cloud: PointCloud, source: Source | None) -> RecordedMap:
        """Return a map, with the truth of its pairs where a source has it.

        Raises:
            InputError: If the source is broken.
        """
        stamps, nav = cloud.pair_stamps_ns or (0,), None if source is None else source.nav
        pairs = [] if nav is None else [item for item in nav.pairs() if item.pair.stamp_ns in stamps]
        truth = CloudTruth()
        for item in pairs:
            if item.truth is not None:
                truth.add_points(item.pair.stamp_ns, item.truth)
        error = truth.errors(cloud)
        sample = cloud_sample(POINTS, stamps[-1], cloud.xyz, cloud.sigma, 0.0, error)
        grid = grid_of_cloud(stamps[-1], cloud.xyz, cloud.sigma, 0.0, error)
        return cls(cloud, sample, grid, None if nav is None else nav.rig, pairs)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recorded run; what is absent is None or empty.

    Attributes:
        title: Its name.
        estimates: Estimated poses.
        truth: True poses.
        statuses: Calls and health of the nodes, in their order.
        source: Images, and the truth of the map.
        map: The map.
        report: JSON of a score that was made before, for where it cannot be made again.
        begin_ns: First stamp of the drive and of the mapping pairs.
        end_s: Length.
    """

    title: str
    estimates: Estimates | None
    truth: Trajectory | None
    statuses: Sequence[RecordedStatus]
    source: Source | None
    map: RecordedMap | None
    report: str
    begin_ns: tuple[int, int]
    end_s: float

    @property
    def silent_nodes(self) -> frozenset[str]:
        """Nodes whose calls were recorded but not their health."""
        spoken = {item.status.node for item in self.statuses if item.status.kind is StatusKind.HEALTH}
        return frozenset(item.status.node for item in self.statuses) - spoken

    def moments(self) -> Iterator[Moment]:
        """Yield all that has happened but images, in its order; the truth of a stamp comes first."""
        streams = (self._true_poses(), self._calls(), self._poses(), self._map())
        return heapq.merge(*streams, key=attrgetter("at_s"))

    def frames(self) -> Iterator[Frame]:
        """Yield the images in their order, read from the disk as they are asked for."""
        source = self.source
        loc = iter(()) if source is None or source.loc is None else source.loc.pairs()
        nav = iter(()) if source is None or source.nav is None else source.nav.pairs()
        drive = (frame for pair in loc for frame in self._pair("loc", pair))
        panorama = (frame for item in nav for frame in self._pair("nav", item.pair))
        return heapq.merge(drive, panorama, key=attrgetter("at_s"))

    def _pair(self, rig: str, pair: StereoPair) -> Iterator[Frame]:
        at_s = place(pair.stamp_ns, self.begin_ns[rig == "nav"])
        for side, image in zip(SIDES, (pair.left, pair.right), strict=True):
            yield Frame(at_s, f"{rig}/{side}", pair.stamp_ns, image)

    def _true_poses(self) -> Iterator[Moment]:
        for stamp_ns, position, quat in _rows(self.truth):
            sample = PoseSample(Track.TRUTH, stamp_ns, position, quat, 0.0)

            def score(of: MonitorScore, sample: PoseSample = sample) -> None:
                of.add_truth(sample.stamp_ns, sample.position, sample.quat_xyzw)

            yield Moment(place(stamp_ns, self.begin_ns[0]), sample, score)

    def _poses(self) -> Iterator[Moment]:
        estimates = self.estimates
        if estimates is None:
            return
        for number, (stamp_ns, position, quat) in enumerate(_rows(estimates.trajectory)):
            covariance = _covariance(estimates, number)
            sample = PoseSample(Track.ESTIMATE, stamp_ns, position, quat, 0.0, covariance)

            def score(of: MonitorScore, sample: PoseSample = sample) -> None:
                of.add_estimate(sample.stamp_ns, sample.position, sample.quat_xyzw, sample.covariance)

            yield Moment(place(stamp_ns, self.begin_ns[0]), sample, score)

    def _calls(self) -> Iterator[Moment]:
        for item in self.statuses:
            record = item.record
            if record is None:
                yield Moment(item.at_s, item.status)
                continue

            def score(of: MonitorScore, record: CallRecord = record) -> None:
                of.add_call(record)

            yield Moment(item.at_s, item.status, score)

    def _map(self) -> Iterator[Moment]:
        found = self.map
        if found is None:
            return

        def score(of: MonitorScore) -> None:
            if found.scored:
                of.map_score = found.scored[0]
                return
            of.map_inputs.rig = found.rig
            for item in found.pairs:
                of.map_inputs.add_pose(item.pair.stamp_ns, item.T_lm_navsb)
                if item.truth is not None:
                    of.map_inputs.add_true_points(item.pair.stamp_ns, item.truth)
            of.map_inputs.add_cloud(found.sample.stamp_ns, found.cloud)
            if of.score_maps() and of.map_score is not None:
                found.scored.append(of.map_score)

        at_s = place(found.sample.stamp_ns, self.begin_ns[1])
        yield Moment(at_s, found.sample, score)
        if found.grid is not None:
            yield Moment(at_s, found.grid)


def place(stamp_ns: int, begin_ns: int) -> float:
    """Return the place of a stamp on the time line, seconds."""
    return max(stamp_ns - begin_ns, 0) / NS_PER_S


def _rows(
    trajectory: Trajectory | None,
) -> Iterator[tuple[int, tuple[float, float, float], tuple[float, float, float, float]]]:
    if trajectory is None:
        return
    for row in range(len(trajectory)):
        x, y, z = trajectory.positions[row].tolist()
        a, b, c, d = trajectory.quats_xyzw[row].tolist()
        yield int(trajectory.stamps_ns[row]), (x, y, z), (a, b, c, d)


def _covariance(estimates: Estimates, row: int) -> FloatArray | None:
    """Return the covariance `(6, 6)` of a pose; that of a lost one says so, None is not known."""
    if estimates.lost[row]:
        return LOST
    known = estimates.covariance
    if known is None or not np.isfinite(known[row]).all():
        return None
    full = np.zeros((6, 6))
    full[UPPER] = known[row]
    return full + np.triu(full, 1).T

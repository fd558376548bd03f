"""Runs of localiser and mapper over a whole source, without ROS: the same `process` calls as the nodes make."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import InputError, MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.sequence import LocSequence, NavSequence
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.start_pose import StartPose
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.mapper import FusedMap, Mapper, PairMap
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.method_record import MethodRecord
from sfr_loc_map.metrics.resources import CallMeter
from sfr_loc_map.pipeline.call_record import CallRecord
from sfr_loc_map.pipeline.call_stats import COVARIANCE_NAMES, METHOD_NAMES, STEP_NAMES, UPPER
from sfr_loc_map.pipeline.load_kernels import load_kernels

MAX_START_GAP_NS = NS_PER_S
"""Longest gap of the truth in which a drive can start."""
Progress = Callable[[int], None]
FrameObserver = Callable[[StereoPair, PoseEstimate, Localiser], None]
"""Looks at a pair, its estimate and the localiser after the call; its time is not the call's."""


def no_observer(pair: StereoPair, estimate: PoseEstimate, localiser: Localiser) -> None:
    """FrameObserver nothing."""


def localise(
    sequence: LocSequence, config: LocalisationConfig, start: StartPose, watch: FrameObserver = no_observer
) -> Iterator[tuple[PoseEstimate, CallRecord]]:
    """Yield the estimate and the cost of each pair of a drive.

    Args:
        sequence: The drive.
        config: Parameters of the localiser.
        start: Pose of RB in DS, at its stamp or at the first pair.
        watch: Called after each pair.
    """
    localiser = Localiser(sequence.rig, config, start)
    load_kernels("localisation")
    meter = CallMeter()
    for pair in sequence.pairs():
        with meter.measure() as call:
            estimate = localiser.process(pair)
        watch(pair, estimate, localiser)
        yield (
            estimate,
            CallRecord(
                pair.stamp_ns,
                call.processing_time_s,
                estimate.state.value,
                call.peak_rss_bytes,
                call.above_idle_bytes,
                estimate.figures,
                estimate.covariance,
                estimate.reason_text,
                None if estimate.step is None else estimate.step.uncertainty,
            ),
        )


def start_pose(sequence: LocSequence, start: str, offset_s: float = 0.0) -> StartPose:
    """Return the pose at which a drive starts, with its stamp.

    Args:
        sequence: The drive.
        start: `identity` (RB is DS at the first pair) or `truth`: the true pose at the first pair, if need be between
            two poses of the truth; without one the next pose of the truth, or its last.
        offset_s: Seconds of the drive that are left out; the true pose is then the first one after them.

    Raises:
        InputError: If the truth is wanted and there is none.
    """
    if start == "identity":
        return StartPose(Transform.identity())
    truth = sequence.ground_truth
    if truth is None or not len(truth):
        raise InputError(
            "'--start truth' needs ground truth, the source has none: leave it out to start at the identity"
        )
    stamps = truth.stamps_ns
    first = next(sequence.pairs(), None)
    wanted = int(stamps[0] if first is None else first.stamp_ns) + round(offset_s * NS_PER_S)
    after = min(int(np.searchsorted(stamps, wanted)), len(stamps) - 1)
    gap = int(stamps[after] - stamps[after - 1]) if after else 0
    if offset_s > 0.0 or not stamps[after - 1] < wanted < stamps[after] or gap > MAX_START_GAP_NS:
        return StartPose(truth.pose(after), stamp_ns=int(stamps[after]))
    share = (wanted - int(stamps[after - 1])) / gap
    return StartPose(interpolated(truth.pose(after - 1), truth.pose(after), share), stamp_ns=wanted)


@dataclass(frozen=True, slots=True)
class MapRun:
    """The map of a source.

    Attributes:
        maps: What each pair gave.
        fused: All pairs in one cloud.
        records: One a pair, then one for the fusion.
    """

    maps: list[PairMap]
    fused: FusedMap
    records: list[CallRecord]

    @property
    def unfused(self) -> PointCloud:
        """The points of every pair."""
        stamps_ns = tuple(item.stamp_ns for item in self.maps)
        return replace(PointCloud.concatenate([item.cloud for item in self.maps]), pair_stamps_ns=stamps_ns)

    @property
    def unfused_random_sigma(self) -> NDArray[np.float32]:
        """The random part of the sigma of the points of every pair `(N,)`, metres."""
        return np.concatenate([item.random_sigma for item in self.maps])


def map_pairs(sequence: NavSequence, config: MappingConfig, progress: Progress = lambda done: None) -> MapRun:
    """Map the pairs of a source and fuse them.

    Raises:
        MappingError: If there are more pairs than a map may have, or none.
    """
    if not 1 <= len(sequence) <= MAX_PAIRS:
        raise MappingError(f"a map is made of 1 to {MAX_PAIRS} stereo pairs, the source has {len(sequence)}: split it")
    mapper = Mapper(sequence.rig, config)
    load_kernels("mapping")
    meter = CallMeter()
    maps: list[PairMap] = []
    records: list[CallRecord] = []
    for index, item in enumerate(sequence.pairs()):
        with meter.measure() as call:
            result = mapper.process(item.pair, item.T_lm_navsb, index)
        maps.append(result)
        cost = (call.processing_time_s, MappingState.MAPPED.value, call.peak_rss_bytes, call.above_idle_bytes)
        records.append(CallRecord(item.pair.stamp_ns, *cost, result.statistics))
        progress(index + 1)
    with meter.measure() as call:
        fused = mapper.fuse(maps)
    cost = (call.processing_time_s, MappingState.FUSED.value, call.peak_rss_bytes, call.above_idle_bytes)
    records.append(CallRecord(maps[-1].stamp_ns, *cost, fused.statistics))
    return MapRun(maps, fused, records)


def trajectory_of(estimates: Iterable[PoseEstimate]) -> Trajectory:
    """Return the trajectory of estimates."""
    return Trajectory.from_poses((estimate.stamp_ns, estimate.T_ds_rb) for estimate in estimates)


def save_stats(path: Path, records: list[CallRecord], method: MethodRecord | None = None) -> None:
    """Write one row a call: costs, state, reason, statistics, and of a pose its covariance and that of its step.

    Args:
        path: The file.
        records: The calls.
        method: Their method, which every row then names, with what it did wrong in the call; None to leave that out.
    """
    named = () if method is None else (method.name, method.version or "", method.kind.value, method.sha256 or "")
    names = sorted({name for record in records for name in record.statistics})
    with_covariance = any(record.covariance is not None for record in records)
    pose_names = [*COVARIANCE_NAMES, *STEP_NAMES] if with_covariance else []
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        header = ["stamp_ns", "processing_time_s", "state", "reason", "peak_rss_bytes", "above_idle_bytes"]
        writer.writerow([*header, *(METHOD_NAMES if named else ()), *names, *pose_names])
        writer.writerows(_stats_row(record, names, named) for record in records)


def _stats_row(record: CallRecord, names: list[str], method: tuple[str, ...]) -> list[str | int]:
    memory = (record.peak_rss_bytes, record.above_idle_bytes)
    statistics = (record.statistics.get(name) for name in names)
    pose: list[str] = []
    if record.covariance is not None:
        pose = list(map(repr, record.covariance[UPPER].tolist()))
        pose += [""] * len(STEP_NAMES) if record.step is None else map(repr, record.step.tolist())
    return [
        record.stamp_ns,
        repr(record.processing_time_s),
        record.state,
        record.reason,
        *("" if item is None else item for item in memory),
        *((*method, record.finding) if method else ()),
        *("" if value is None else repr(float(value)) for value in statistics),
        *pose,
    ]

"""A localiser or mapper over a complete source, without ROS; the nodes make the same calls of `process`.

`run_localiser` and `run_mapper` accept the configuration of our localiser or mapper, or a method under test
(`UnderTest`), and return the complete run:

    run_localiser ─► localiser_steps ─► localise, localise_with
    run_mapper    ────────────────────► map_pairs, map_pairs_with ─► _map_and_fuse

`localise` and `map_pairs` call our own code in this process. `localise_with` and `map_pairs_with` call a method in its
own process. `localiser_steps` yields the estimates of a drive one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord, call_of_estimate, call_of_fusion, call_of_stages, mapping_call
from sfr_loc_map.config import changed
from sfr_loc_map.errors import InputError, MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stamped_poses import LONGEST_GAP_S
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.io.sequence import LocSequence, NavSequence
from sfr_loc_map.kernels import load_kernels
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.maps import FusedMap, MappedPair, PairMap, warnings_of_pairs
from sfr_loc_map.mapping.search_range import search_range_of
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.config_truth import check_configuration
from sfr_loc_map.methods.isolated_localiser import IsolatedLocaliser
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.registry import Method, MethodLimits, record_of_ours
from sfr_loc_map.metrics.calls.call_meter import CallMeter
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.table.records import MethodRecord
from sfr_loc_map.runs.track_video import FrameObserver
from sfr_loc_map.signals import stopping
from sfr_loc_map.suite_names import Task

MAX_START_GAP_NS = round(LONGEST_GAP_S * NS_PER_S)
"""Longest gap of the truth in which the start pose is interpolated, ns; as in a score."""
DEFAULT_STEP_S = 0.1
Progress = Callable[[int], None]
Map = TypeVar("Map", bound=PairMap)


@dataclass(frozen=True, slots=True)
class UnderTest:
    """A method under test, in place of the localiser or mapper of the suite."""

    method: Method
    limits: MethodLimits = field(default_factory=MethodLimits)
    hidden: Sequence[Path] = field(kw_only=True)  #: Paths to which the method has no access: `Source.truth_paths`.


# ---- drives


class Step(NamedTuple):
    """The result of a call of a localiser."""

    estimate: PoseEstimate
    record: CallRecord  #: State and cost.
    method: MethodRecord  #: Method that made the call.


@dataclass(frozen=True, slots=True)
class DriveRun:
    """The steps of a drive, at least one."""

    steps: Sequence[Step]

    @property
    def trajectory(self) -> Trajectory:
        """The estimated trajectory."""
        return trajectory_of(step.estimate for step in self.steps)

    @property
    def records(self) -> list[CallRecord]:
        """State and cost of each call."""
        return [step.record for step in self.steps]

    @property
    def method(self) -> MethodRecord:
        """The method that made the estimates, from the last step, because the version may be reported late."""
        return self.steps[-1].method


def start_pose(sequence: LocSequence, start: str, from_ns: int = 0) -> StartPose:
    """Return the pose at which a drive starts, with its stamp.

    `identity`: RB is DS at the first pair. `truth`: the true pose at the first pair, interpolated if necessary. If the
    truth has a gap there, or if the pairs before `from_ns` are omitted, the next true pose is used, or the last one.
    """
    if start == "identity":
        return StartPose(Transform.identity())
    truth = sequence.ground_truth
    if truth is None or not len(truth):
        raise InputError(
            "'--start truth' requires ground truth, which the source does not have: omit it to start at the identity"
        )
    if not truth.has_attitude:
        raise InputError(
            "'--start truth' requires true attitudes, but the ground truth has only positions: use --start identity"
        )
    stamps = truth.stamps_ns
    first_ns = int(sequence.stamps_ns[0] if len(sequence) else stamps[0])
    wanted_ns = max(first_ns, from_ns)
    after = min(int(np.searchsorted(stamps, wanted_ns)), len(stamps) - 1)
    next_true_pose = StartPose(truth.pose(after), stamp_ns=int(stamps[after]))
    if wanted_ns > first_ns or after == 0:
        return next_true_pose
    before_ns, after_ns = int(stamps[after - 1]), int(stamps[after])
    if not before_ns < wanted_ns < after_ns or after_ns - before_ns > MAX_START_GAP_NS:
        return next_true_pose
    fraction = (wanted_ns - before_ns) / (after_ns - before_ns)
    return StartPose(interpolated(truth.pose(after - 1), truth.pose(after), fraction), stamp_ns=wanted_ns)


def true_start(sequence: LocSequence) -> StartPose:
    """Return the pose at which a drive starts: the true pose, or the identity without true attitudes."""
    truth = sequence.ground_truth
    has_attitude = truth is not None and len(truth) > 0 and truth.has_attitude
    return start_pose(sequence, "truth" if has_attitude else "identity")


def unstamped_start_warning(start: StartPose, sequence: LocSequence) -> str | None:
    """Return a warning if the start pose of a method under test is the pose of another time than its first pair.

    Our localiser uses the stamp of a start pose. The interface of methods has no such stamp, so that all poses of a
    method are offset by the motion between both stamps.
    """
    if start.stamp_ns is None or not len(sequence):
        return None
    after_s = (start.stamp_ns - int(sequence.stamps_ns[0])) / NS_PER_S
    if abs(after_s) * NS_PER_S <= MAX_START_GAP_NS:
        return None
    return (
        f"the start pose is the true pose {abs(after_s):.3g} s {'after' if after_s > 0.0 else 'before'} the first "
        "pair: all poses of the method, and errors without re-basing, are offset by the motion in this time"
    )


def run_localiser(
    sequence: LocSequence,
    how: LocalisationConfig | UnderTest,
    start: StartPose,
    watch: FrameObserver | None = None,
    progress: Progress = lambda done: None,
    *,
    keeps_finished: bool = False,
) -> DriveRun:
    """Localise the pairs of a drive by our localiser or by a method under test; see `localiser_steps`.

    `progress` is called with the number of localised pairs. With `keeps_finished`, an interruption after the first pair
    ends the drive, and the run has the localised pairs. Otherwise the interruption is raised.
    """
    steps: list[Step] = []
    try:
        for step in localiser_steps(sequence, how, start, watch):
            steps.append(step)
            progress(len(steps))
    except KeyboardInterrupt:
        if not (keeps_finished and steps):
            raise
    return DriveRun(steps)


def localiser_steps(
    sequence: LocSequence, how: LocalisationConfig | UnderTest, start: StartPose, watch: FrameObserver | None = None
) -> Iterator[Step]:
    """Yield the step of each pair of a drive by our localiser or by a method under test.

    `watch` is called after each pair of our localiser. InputError if the drive has no pair.
    """
    if not len(sequence):
        raise InputError("the drive has no complete pair of images: at least one is required; sfr info SRC shows why")
    with checked_clock():
        if isinstance(how, UnderTest):
            yield from localise_with(how, sequence, start.T_ds_rb)
            return
        about = record_of_ours(Task.LOCALISATION, changed(how))
        for estimate, record in localise(sequence, how, start, watch):
            yield Step(estimate, record, about)


def localise(
    sequence: LocSequence, config: LocalisationConfig, start: StartPose, watch: FrameObserver | None = None
) -> Iterator[tuple[PoseEstimate, CallRecord]]:
    """Yield the estimate and the cost of each pair of a drive by our localiser; `watch` is called after each pair."""
    localiser = Localiser(sequence.rig, config, start)
    load_kernels("localisation")
    meter = CallMeter()
    for pair in sequence.pairs():
        with stopping() as stopped, meter.measure() as call:  # an exception out of a kernel ends the process
            estimate = localiser.process(pair)
        if stopped():
            raise KeyboardInterrupt
        if watch is not None:
            watch(pair, estimate)
        yield replace(estimate, tracks=None), call_of_estimate(estimate, call)


def localise_with(how: UnderTest, sequence: LocSequence, T_ds_rb: Transform) -> Iterator[Step]:
    """Yield the step of each pair of a drive by a method under test."""
    check_configuration(how.method.config, sequence.ground_truth)
    first_ns, *later_ns = sequence.stamps_ns[:2]
    step_s = next(((stamp_ns - first_ns) / NS_PER_S for stamp_ns in later_ns if stamp_ns > first_ns), DEFAULT_STEP_S)
    setup = (sequence.rig, T_ds_rb, how.limits)
    with IsolatedLocaliser(how.method, *setup, rate_hz=1.0 / step_s, hidden=how.hidden) as localiser:
        for pair in sequence.pairs():
            estimate, call = localiser.localise(pair, (pair.stamp_ns - first_ns) / NS_PER_S)
            record = CallRecord(
                pair.stamp_ns,
                call.usage.processing_time_s,
                estimate.state.value,
                call.usage.peak_rss_bytes,
                call.usage.above_idle_bytes,
                statistics=call.statistics,
                covariance=call.covariance,
                reason=call.reason,
                step=call.step,
                finding=call.finding,
            )
            yield Step(estimate, record, localiser.record)


def trajectory_of(estimates: Iterable[PoseEstimate]) -> Trajectory:
    """Return the trajectory of estimates."""
    return Trajectory.from_poses((estimate.stamp_ns, estimate.T_ds_rb) for estimate in estimates)


# ---- maps


@dataclass(frozen=True, slots=True)
class MapRun:
    """The map of a source."""

    maps: Sequence[PairMap]
    fused: FusedMap
    records: list[CallRecord]  # each pair, the fusion if it is a call, the set; only the set if a method maps sets
    method: MethodRecord  # method that made the map

    @property
    def unfused(self) -> PointCloud:
        """The points of every pair."""
        stamps_ns = tuple(item.stamp_ns for item in self.maps)
        return replace(PointCloud.concatenate([item.cloud for item in self.maps]), pair_stamps_ns=stamps_ns)

    @property
    def warnings(self) -> list[str]:
        """Warnings about each pair and about the fusion, one line each."""
        return [*warnings_of_pairs(self.maps), *self.fused.warnings]


def run_mapper(
    sequence: NavSequence,
    how: MappingConfig | UnderTest,
    progress: Progress = lambda done: None,
    *,
    keeps_finished: bool = False,
) -> MapRun:
    """Map the pairs of a source by our mapper or by a method under test; see `map_pairs`.

    `progress` is called with the number of mapped pairs. With `keeps_finished`, an interruption after the first pair
    ends the run after the current pair, and the map has the mapped pairs. Otherwise the interruption is raised.
    """
    done = 0

    def count(mapped: int) -> None:
        nonlocal done
        done = mapped
        progress(mapped)

    def stop() -> None:
        if not done:
            raise KeyboardInterrupt

    with checked_clock(), stopping(stop) if keeps_finished else nullcontext(lambda: False) as ended:
        if isinstance(how, UnderTest):
            return map_pairs_with(sequence, how, count, ended)
        return map_pairs(sequence, how, count, ended)


def map_pairs(
    sequence: NavSequence,
    config: MappingConfig,
    progress: Progress = lambda done: None,
    ended: Callable[[], bool] = lambda: False,
) -> MapRun:
    """Map the pairs of a source by our mapper and fuse them; once `ended` returns true, only the mapped pairs."""
    check_count(sequence)
    mapper = _OwnMapper(sequence.rig, config)
    pairs = [replace(item, truth=None) for item in sequence.pairs()]  # the call excludes reading, its memory the truth
    return _map_and_fuse(mapper, pairs, progress, ended)


def map_pairs_with(
    sequence: NavSequence,
    how: UnderTest,
    progress: Progress = lambda done: None,
    ended: Callable[[], bool] = lambda: False,
) -> MapRun:
    """Map the pairs of a source by a method under test.

    `ended` is as in `map_pairs`, but a method that maps sets is not stopped.
    """
    check_count(sequence)
    searched = search_range_of(sequence.rig, MappingConfig()).count
    with IsolatedMapper(how.method, sequence.rig, how.limits, disparities=searched, hidden=how.hidden) as mapper:
        if not mapper.maps_sets:
            return _map_and_fuse(_MapperUnderTest(mapper), sequence.pairs(), progress, ended)
        maps, fused, call = mapper.map_set(list(sequence.pairs()))
        progress(len(maps))
        whole = mapping_call(maps[-1].stamp_ns, call.usage, MappingState.MAPPED_SET, fused.statistics, call.finding)
        return MapRun(maps, fused, [whole], mapper.record)


class _MeasuredMapper(Protocol[Map]):
    """A mapper of single pairs whose calls are measured."""

    @property
    def record(self) -> MethodRecord:
        """Method that maps."""

    def map_pair(self, item: PosedStereoPair, index: int) -> tuple[Map, CallRecord]:
        """Map a pair, which has an index among the pairs of the map."""

    def fuse(self, maps: Sequence[Map], last: StereoPair) -> tuple[FusedMap, CallRecord | None]:
        """Fuse maps, of which the last is that of a pair; the call is None if the method does not fuse."""


class _OwnMapper:
    """Our mapper, in this process."""

    def __init__(self, rig: StereoRig, config: MappingConfig) -> None:
        self.record = record_of_ours(Task.MAPPING, changed(config))
        self._mapper = Mapper(rig, config)
        load_kernels("mapping")
        self._meter = CallMeter()

    def map_pair(self, item: PosedStereoPair, index: int) -> tuple[MappedPair, CallRecord]:
        with self._meter.measure() as usage:
            done = self._mapper.process(item.pair, item.T_lm_navsb, index)
        return done, mapping_call(item.pair.stamp_ns, usage, MappingState.MAPPED, done.statistics)

    def fuse(self, maps: Sequence[MappedPair], last: StereoPair) -> tuple[FusedMap, CallRecord]:
        with self._meter.measure() as usage:
            fused = self._mapper.fuse(maps)
        return fused, call_of_fusion(fused, [item.stamp_ns for item in maps], usage, MappingState.FUSED)


class _MapperUnderTest:
    """A method under test, in its own process."""

    def __init__(self, mapper: IsolatedMapper) -> None:
        self._mapper = mapper

    @property
    def record(self) -> MethodRecord:
        return self._mapper.record

    def map_pair(self, item: PosedStereoPair, index: int) -> tuple[PairMap, CallRecord]:
        done, call = self._mapper.map_pair(item.pair, item.T_lm_navsb, index)
        record = mapping_call(item.pair.stamp_ns, call.usage, MappingState.MAPPED, done.statistics, call.finding)
        return done, record

    def fuse(self, maps: Sequence[PairMap], last: StereoPair) -> tuple[FusedMap, CallRecord | None]:
        fused, call = self._mapper.fuse(maps, last)
        if call is None:
            return fused, None
        return fused, mapping_call(last.stamp_ns, call.usage, MappingState.FUSED, fused.statistics, call.finding)


def _map_and_fuse(
    mapper: _MeasuredMapper[Map], pairs: Iterable[PosedStereoPair], progress: Progress, ended: Callable[[], bool]
) -> MapRun:
    """Map pairs one by one and fuse the maps; once `ended` returns true, only the mapped pairs."""
    maps: list[Map] = []
    stages: list[CallRecord] = []
    for index, item in enumerate(pairs):
        done, record = mapper.map_pair(item, index)
        maps.append(done)
        stages.append(record)
        last = item.pair
        progress(index + 1)
        if ended():
            break
    fused, fusion = mapper.fuse(maps, last)
    if fusion is not None:
        stages.append(fusion)
    whole = mapping_call(last.stamp_ns, call_of_stages(stages), MappingState.MAPPED_SET)
    return MapRun(maps, fused, [*stages, whole], mapper.record)


def check_count(sequence: NavSequence) -> None:
    """Raise MappingError if the number of pairs is not valid for a map."""
    if not 1 <= len(sequence) <= MAX_PAIRS:
        raise MappingError(
            f"the source has {len(sequence)} stereo pairs: a source with 1 to {MAX_PAIRS} is required for a map"
        )

"""A mapper over all pairs of a source, without ROS; the node makes the same calls of `process`.

    run_mapper ─┬─► _map_and_fuse: pair by pair, by our mapper (`_OwnMap`) or a method under test (`_MapUnderTest`)
                └─► _map_set: all pairs in one call of a method under test

Our mapper is called in this process, and a method under test in its own process.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from sfr_loc_map.calls.call_record import CallRecord, call_of_fusion, mapping_call, usage_of_stages
from sfr_loc_map.calls.run_identity import hash_of_pair, hash_of_set
from sfr_loc_map.configuration.parameters import changed
from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.io.sequence import NavSequence
from sfr_loc_map.kernels import load_kernels
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.maps import FusedMap, MappedPair, PairMap, warnings_of_pairs
from sfr_loc_map.methods.isolated_mapper import IsolatedMapper
from sfr_loc_map.methods.registry import record_of_ours
from sfr_loc_map.metrics.calls.call_meter import CallMeter, CallUsage
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.figures.records import MethodRecord
from sfr_loc_map.runs.under_test import Progress, UnderTest
from sfr_loc_map.signals import stopping
from sfr_loc_map.suite_names import Task


@dataclass(frozen=True, slots=True)
class MapRun:
    """The map of a source."""

    maps: Sequence[PairMap]
    fused: FusedMap
    # calls of each pair, of the fusion if it is a call, and of the set; only of the set if a method maps sets
    records: list[CallRecord]
    method: MethodRecord  # method that made the map

    @property
    def unfused(self) -> PointCloud:
        """The points of every pair."""
        stamps_ns = tuple(item.stamp_ns for item in self.maps)
        return replace(PointCloud.concatenate([item.cloud for item in self.maps]), pair_stamps_ns=stamps_ns)

    @property
    def warnings(self) -> list[str]:
        """Warnings about each pair and about the fusion, one line each."""
        return [*warnings_of_pairs([item.warnings for item in self.maps]), *self.fused.warnings]


def run_mapper(
    sequence: NavSequence,
    mapper: MappingConfig | UnderTest,
    progress: Progress = lambda done: None,
    *,
    keeps_finished: bool = False,
) -> MapRun:
    """Map the pairs of a source by our mapper or by a method under test.

    `progress` is called with the number of mapped pairs. With `keeps_finished`, an interruption after the first pair
    ends the map, which then has the pairs that were already mapped. Otherwise, and if a method maps all pairs in one
    call, the interruption is raised. Raises MappingError if the number of pairs is not valid for a map.
    """
    check_count(sequence)
    with checked_clock():
        if not isinstance(mapper, UnderTest):
            # The measured calls exclude the reading of the pairs, and their memory excludes the ground truth.
            pairs = [replace(item, truth=None) for item in sequence.pairs()]
            return _map_and_fuse(_OwnMap(sequence.rig, mapper), pairs, progress, keeps_finished=keeps_finished)
        with IsolatedMapper(mapper.method, sequence.rig, mapper.limits, hidden=mapper.hidden) as isolated:
            if isolated.maps_sets:
                return _map_set(isolated, list(sequence.pairs()), progress)
            under_test = _MapUnderTest(isolated)
            return _map_and_fuse(under_test, sequence.pairs(), progress, keeps_finished=keeps_finished)


def _map_set(mapper: IsolatedMapper, pairs: Sequence[PosedStereoPair], progress: Progress) -> MapRun:
    """Map all pairs in one call of a method under test."""
    maps, fused, call = mapper.map_set(pairs)
    progress(len(maps))
    whole = mapping_call(
        maps[-1].stamp_ns,
        call.usage,
        MappingState.MAPPED_SET,
        fused.statistics,
        call.finding,
        images_sha256=hash_of_set([hash_of_pair(item.pair) for item in pairs]),
    )
    return MapRun(maps, fused, [whole], mapper.record)


class _MeasuredMap(Protocol):
    """A map of pairs that are mapped one by one in measured calls."""

    @property
    def record(self) -> MethodRecord:
        """The method that makes the map."""

    def map_pair(self, item: PosedStereoPair) -> tuple[PairMap, CallUsage, str]:
        """Map the next pair. Return its map, the cost of the call, and the findings on the method."""

    def fuse(self) -> tuple[FusedMap, CallRecord | None]:
        """Fuse the mapped pairs; the call is None if the method does not fuse."""


class _OwnMap:
    """A map by our mapper, in this process."""

    def __init__(self, rig: StereoRig, config: MappingConfig) -> None:
        self.record = record_of_ours(Task.MAPPING, changed(config))
        load_kernels("mapping")
        self._meter = CallMeter()  # first, so that the memory of the mapper itself counts
        self._mapper = Mapper(rig, config)
        self._maps: list[MappedPair] = []

    def map_pair(self, item: PosedStereoPair) -> tuple[MappedPair, CallUsage, str]:
        with self._meter.measure() as usage:
            done = self._mapper.process(item.pair, item.T_lm_navsb, len(self._maps))
        self._maps.append(done)
        return done, usage, ""

    def fuse(self) -> tuple[FusedMap, CallRecord]:
        with self._meter.measure() as usage:
            fused = self._mapper.fuse(self._maps)
        return fused, call_of_fusion(fused, [item.stamp_ns for item in self._maps], usage, MappingState.FUSED)


class _MapUnderTest:
    """A map by a method under test, in its own process."""

    def __init__(self, mapper: IsolatedMapper) -> None:
        self._map = mapper.begin_map()
        self._last_ns = 0  # stamp of the last mapped pair
        self.record = mapper.record

    def map_pair(self, item: PosedStereoPair) -> tuple[PairMap, CallUsage, str]:
        done, call = self._map.map_pair(item.pair, item.T_lm_navsb)
        self._last_ns = done.stamp_ns
        return done, call.usage, call.finding

    def fuse(self) -> tuple[FusedMap, CallRecord | None]:
        fused, call = self._map.fuse()
        if call is None:
            return fused, None
        return fused, mapping_call(self._last_ns, call.usage, MappingState.FUSED, fused.statistics, call.finding)


def _map_and_fuse(
    measured: _MeasuredMap, pairs: Iterable[PosedStereoPair], progress: Progress, *, keeps_finished: bool
) -> MapRun:
    """Map pairs one by one and fuse the maps; `keeps_finished` is as in `run_mapper`.

    A signal during a call takes effect after the call, so that its pair is kept. A further signal ends the call.
    """
    maps: list[PairMap] = []
    stages: list[CallRecord] = []
    try:
        for item in pairs:
            with stopping() as stopped:  # an exception in a kernel would end the process
                done, usage, finding = measured.map_pair(item)
            maps.append(done)
            stages.append(_call_of_pair(item.pair, done, usage, finding))
            progress(len(maps))
            if stopped():
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        if not (keeps_finished and maps):
            raise
    with stopping() as stopped:  # after a signal, the pairs mapped so far are fused
        fused, fusion = measured.fuse()
    if stopped() and not keeps_finished:
        raise KeyboardInterrupt
    if fusion is not None:
        stages.append(fusion)
    whole = mapping_call(maps[-1].stamp_ns, usage_of_stages(stages), MappingState.MAPPED_SET)
    return MapRun(maps, fused, [*stages, whole], measured.record)


def _call_of_pair(pair: StereoPair, done: PairMap, usage: CallUsage, finding: str) -> CallRecord:
    """Return the record of the call that mapped a pair."""
    images_sha256 = hash_of_pair(pair)
    return mapping_call(
        pair.stamp_ns, usage, MappingState.MAPPED, done.statistics, finding, images_sha256=images_sha256
    )


def check_count(sequence: NavSequence) -> None:
    """Raise MappingError if the number of pairs is not valid for a map."""
    if not 1 <= len(sequence) <= MAX_PAIRS:
        raise MappingError(
            f"the source has {len(sequence)} stereo pairs: a source with 1 to {MAX_PAIRS} is required for a map"
        )

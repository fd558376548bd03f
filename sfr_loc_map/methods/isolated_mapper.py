"""A mapper under test in its own process. Each pair has a map, which is empty if the mapper fails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.checks import check_index, check_pair_count
from sfr_loc_map.mapping.config import MAX_PAIRS, MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range_of
from sfr_loc_map.mapping.maps import FusedMap, PairMap
from sfr_loc_map.mapping.pair_view import reproject_pixels
from sfr_loc_map.methods.child.loop import Answer
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.map_arrays import Arrays, cloud_in, disparity_in, largest_files
from sfr_loc_map.methods.method_call import MethodCall, Request, RequestedPair
from sfr_loc_map.methods.method_process import ProcessSettings
from sfr_loc_map.methods.registry import Method, MethodLimits

F = np.float32
DISPARITY_SIGMA_PX = F(0.5)  #: Standard deviation assumed for disparities of matchers, which do not estimate it.

Warnings = tuple[str, ...]


class IsolatedMapper(IsolatedMethod):
    """A mapper, which maps a set of pairs in one call, or maps single pairs and may then fuse the maps."""

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        limits: MethodLimits | None = None,
        *,
        disparities: int | None = None,
        hidden: Sequence[Path],
    ) -> None:
        """Start the mapper, which cannot read `hidden`.

        Matchers search `disparities`, by default as many as our mapper with its default configuration.
        """
        settings = ProcessSettings(
            method=method,
            rig=rig,
            limits=limits or MethodLimits(),
            disparities=search_range_of(rig, MappingConfig()).count if disparities is None else disparities,
            hidden=hidden,
        )
        super().__init__(settings, Transform.identity())
        self._last_map: MapOfPairs | None = None  # the map that was begun last

    def map_set(self, pairs: Sequence[PosedStereoPair]) -> tuple[list[PairMap], FusedMap, MethodCall]:
        """Map one to three pairs in one call.

        Return the part of the cloud of each pair, the cloud, and the record of the call. MappingError for another
        number of pairs, and for a method that maps only single pairs.
        """
        if not self.maps_sets:
            raise MappingError(f"method '{self.record.name}' maps only single pairs: map them one by one (begin_map)")
        check_pair_count(len(pairs))
        rig = self.rig
        stamps_ns = tuple(item.pair.stamp_ns for item in pairs)
        T_lm_left = tuple(item.T_lm_navsb @ rig.T_sb_left for item in pairs)
        requested = [RequestedPair(item.pair, number, item.T_lm_navsb) for number, item in enumerate(pairs)]

        def read(answer: Answer, arrays: Arrays) -> tuple[PointCloud, Warnings]:
            cloud = replace(cloud_in(arrays, rig, len(pairs)), fused=answer.get("fused", True))
            return cloud, _warnings(answer)

        call, result = self.call(Request(kind="set", pairs=requested, largest_files=largest_files(rig)), read)
        cloud, warnings = result or (PointCloud.empty(), ())
        cloud = replace(cloud, pair_stamps_ns=stamps_ns)
        parts = [cloud.select(cloud.pair == number) for number in range(len(pairs))]
        maps = [_pair_map(rig, *part, None, {}, ()) for part in zip(stamps_ns, parts, T_lm_left, strict=True)]
        return maps, FusedMap(cloud, cloud.sigma, T_lm_left, call.statistics, warnings), call

    def begin_map(self) -> MapOfPairs:
        """Begin a map of pairs that are mapped one by one; the previous map ends."""
        if self._last_map is not None:
            self._last_map.end()
        self._last_map = MapOfPairs(self)
        return self._last_map


class MapOfPairs:
    """A map that is built from one to three pairs, with one call for each pair.

    The pairs may then be fused. After the fusion, the map accepts no further calls.
    """

    def __init__(self, mapper: IsolatedMapper) -> None:
        self._mapper = mapper
        self._maps: list[PairMap] = []
        self._is_complete = True  # whether the results of all mapped pairs are valid
        self._last_pair: StereoPair | None = None
        self._has_ended = False

    def end(self) -> None:
        """End the map. Later calls of this map raise MappingError: the method has no results of its pairs any more."""
        self._has_ended = True

    def map_pair(self, pair: StereoPair, T_lm_navsb: Transform) -> tuple[PairMap, MethodCall]:
        """Map the next pair. Return its points, which are empty if the result is invalid, and the record of the call.

        MappingError after `MAX_PAIRS` pairs, or if the map has ended.
        """
        self._check_not_ended()
        index = len(self._maps)
        check_index(index)
        rig, maps_sets = self._mapper.rig, self._mapper.maps_sets
        T_lm_left = T_lm_navsb @ rig.T_sb_left

        def read(answer: Answer, arrays: Arrays) -> tuple[PointCloud, FloatImage | None, Warnings]:
            return *_points_of_pair(arrays, rig, pair, T_lm_left, index), _warnings(answer)

        was_complete, self._is_complete = self._is_complete, False  # if a signal interrupts the call
        request = Request(
            kind="set" if maps_sets else "pair",
            pairs=[RequestedPair(pair, 0 if maps_sets else index, T_lm_navsb)],
            begins_map=index == 0,
            largest_files=largest_files(rig),
        )
        call, result = self._mapper.call(request, read)
        self._is_complete = was_complete and result is not None
        self._last_pair = pair
        cloud, disparity, warnings = result or (PointCloud.empty(fused=False), None, ())
        made = _pair_map(rig, pair.stamp_ns, cloud, T_lm_left, disparity, call.statistics, warnings)
        self._maps.append(made)
        return made, call

    def _check_not_ended(self) -> None:
        if self._has_ended:
            raise MappingError("the map has ended, because it was fused or another map was begun: begin a new map")

    def fuse(self) -> tuple[FusedMap, MethodCall | None]:
        """Return one cloud of all pairs, and the record of the call.

        The clouds of the pairs are concatenated without a call if the method does not fuse, or if the result of a pair
        is invalid. MappingError if the map has no pair, or has ended.
        """
        self._check_not_ended()
        check_pair_count(len(self._maps))
        self.end()
        call: MethodCall | None = None
        cloud = PointCloud.concatenate([item.cloud for item in self._maps])
        warnings: Warnings = ()
        if self._mapper.fuses and self._is_complete and self._last_pair is not None:
            call, result = self._fused(self._last_pair)
            cloud, warnings = result or (cloud, warnings)
        cloud = replace(cloud, pair_stamps_ns=tuple(item.stamp_ns for item in self._maps))
        poses_lm_left = tuple(item.T_lm_left for item in self._maps)
        statistics = {} if call is None else call.statistics
        return FusedMap(cloud, cloud.sigma, poses_lm_left, statistics, warnings), call

    def _fused(self, last_pair: StereoPair) -> tuple[MethodCall, tuple[PointCloud, Warnings] | None]:
        """Let the method fuse the pairs. Return the record of the call, and the cloud with the warnings if valid."""
        rig = self._mapper.rig

        def read(answer: Answer, arrays: Arrays) -> tuple[PointCloud, Warnings]:
            return replace(cloud_in(arrays, rig, len(self._maps)), fused=True), _warnings(answer)

        requested = [RequestedPair(last_pair, len(self._maps) - 1)]
        return self._mapper.call(Request(kind="fuse", pairs=requested, largest_files=largest_files(rig)), read)


def _points_of_pair(
    arrays: Arrays, rig: StereoRig, pair: StereoPair, T_lm_left: Transform, index: int
) -> tuple[PointCloud, FloatImage | None]:
    """Return the points and the disparity image in an answer, the points from the disparities if there is no cloud."""
    disparity = disparity_in(arrays, rig)
    if "cloud" in arrays:
        found = cloud_in(arrays, rig, MAX_PAIRS)
        return replace(found, pair=np.full(len(found), index, np.uint8)), disparity
    if disparity is None:
        return PointCloud.empty(fused=False), None
    disparity = np.where(disparity > 0.0, disparity, F(np.nan))
    sigma = np.full_like(disparity, DISPARITY_SIGMA_PX)
    points, _ = reproject_pixels(disparity, sigma, pair.left, rig, T_lm_left)
    return points.to_cloud(points.fusion_sigma, np.full(points.size, index, np.uint8), fused=False), disparity


def _pair_map(
    rig: StereoRig,
    stamp_ns: int,
    cloud: PointCloud,
    T_lm_left: Transform,
    disparity: FloatImage | None,
    figures: Mapping[str, float],
    warnings: Warnings,
) -> PairMap:
    shown = np.full((rig.height, rig.width), np.nan, F) if disparity is None else disparity
    return PairMap(stamp_ns, cloud, cloud.sigma, T_lm_left, shown, figures, warnings)


def _warnings(answer: Answer) -> Warnings:
    return tuple(answer.get("warnings", ()))

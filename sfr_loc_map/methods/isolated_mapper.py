"""A mapper under test in its own process. Each pair has a map, which is empty if the mapper fails."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.cloud import FIELD_TYPES, PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import MAX_CLOUD_BYTES
from sfr_loc_map.io.clouds.array_file import MAX_HEADER, parse_npy
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.mapping.maps import FusedMap, PairMap
from sfr_loc_map.mapping.reprojection import points_from_disparity
from sfr_loc_map.methods.child.loop import Answer, OrderedPair
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.method_call import MethodCall, MethodFailureError
from sfr_loc_map.methods.method_process import numbers_of
from sfr_loc_map.methods.registry import Method, MethodLimits
from sfr_loc_map.metrics.table.records import FindingKind

F = np.float32
DISPARITY_SIGMA_PX = F(0.5)  #: Standard deviation assumed for disparities of matchers, which do not estimate it.


class IsolatedMapper(IsolatedMethod):
    """A mapper, which maps a set of pairs in one call, or maps single pairs and may then fuse the maps."""

    def __init__(
        self,
        method: Method,
        rig: StereoRig,
        limits: MethodLimits | None = None,
        *,
        disparities: int = 0,
        hidden: Sequence[Path],
    ) -> None:
        """Start the mapper, which cannot read `hidden`; matchers search this number of disparities."""
        super().__init__(method, rig, limits, T_ds_rb=Transform.identity(), disparities=disparities, hidden=hidden)
        self.maps_sets: bool = self._running_process().maps_sets  # all pairs of a map in a single call
        self._is_complete = True  # whether all pairs so far were mapped

    def map_set(self, pairs: Sequence[PosedStereoPair]) -> tuple[list[PairMap], FusedMap, MethodCall]:
        """Map one to three pairs in one call.

        Return the part of the cloud of each pair, the cloud, and the record of the call.
        """
        stamps_ns = tuple(item.pair.stamp_ns for item in pairs)
        T_lm_left = tuple(item.T_lm_navsb @ self._rig.T_sb_left for item in pairs)
        about = [_ordered(item.pair, item.T_lm_navsb, number) for number, item in enumerate(pairs)]

        def read(answer: Answer, arrays: Mapping[str, bytes]) -> tuple[PointCloud, tuple[str, ...]]:
            cloud = replace(self._cloud(arrays, len(pairs)), fused=answer.get("fused", True))
            return cloud, tuple(answer.get("warnings", ()))

        stereo_pairs = [item.pair for item in pairs]
        call, result = self._checked(read, "set", stereo_pairs, about, arrays=_largest_files(pairs[-1].pair))
        cloud, warnings = result or (PointCloud.empty(), ())
        cloud = replace(cloud, pair_stamps_ns=stamps_ns)
        parts = [cloud.select(cloud.pair == number) for number in range(len(pairs))]
        maps = [self._pair_map(*part, None, {}, ()) for part in zip(stamps_ns, parts, T_lm_left, strict=True)]
        return maps, FusedMap(cloud, cloud.sigma, T_lm_left, call.statistics, warnings), call

    def map_pair(self, pair: StereoPair, T_lm_navsb: Transform, index: int) -> tuple[PairMap, MethodCall]:
        """Map one pair. Return its points, which are empty if the result is invalid, and the record of the call."""
        T_lm_left = T_lm_navsb @ self._rig.T_sb_left
        kind, number = ("set", 0) if self.maps_sets else ("pair", index)

        def read(answer: Answer, arrays: Mapping[str, bytes]) -> tuple[PointCloud, FloatImage | None, tuple[str, ...]]:
            cloud = PointCloud.empty(fused=False)
            disparity = self._disparity(arrays, pair)
            if "cloud" in arrays:
                found = self._cloud(arrays, MAX_PAIRS)
                cloud = replace(found, pair=np.full(len(found), index, np.uint8))
            elif disparity is not None:
                disparity = np.where(disparity > 0.0, disparity, F(np.nan))
                sigma = np.full_like(disparity, DISPARITY_SIGMA_PX)
                points = points_from_disparity(disparity, sigma, pair.left, self._rig, T_lm_left)
                cloud = points.to_cloud(points.fusion_sigma, np.full(points.size, index, np.uint8), fused=False)
            return cloud, disparity, tuple(answer.get("warnings", ()))

        about = [_ordered(pair, T_lm_navsb, number)]
        call, result = self._checked(read, kind, [pair], about, arrays=_largest_files(pair))
        if result is None:
            self._is_complete = False
        cloud, disparity, warnings = result or (PointCloud.empty(fused=False), None, ())
        return self._pair_map(pair.stamp_ns, cloud, T_lm_left, disparity, call.statistics, warnings), call

    def _pair_map(
        self,
        stamp_ns: int,
        cloud: PointCloud,
        T_lm_left: Transform,
        disparity: FloatImage | None,
        figures: Mapping[str, float],
        warnings: tuple[str, ...],
    ) -> PairMap:
        shown = np.full((self._rig.height, self._rig.width), np.nan, F) if disparity is None else disparity
        return PairMap(stamp_ns, cloud, cloud.sigma, T_lm_left, shown, figures, warnings)

    def fuse(self, maps: Sequence[PairMap], last: StereoPair) -> tuple[FusedMap, MethodCall | None]:
        """Return one cloud of all maps, concatenated if the method does not fuse, and the record of the call."""
        call: MethodCall | None = None
        warnings: tuple[str, ...] = ()
        cloud = PointCloud.concatenate([item.cloud for item in maps])
        if self._process is not None and self._process.fuses and self._is_complete:

            def read(answer: Answer, arrays: Mapping[str, bytes]) -> tuple[PointCloud, tuple[str, ...]]:
                fused = replace(self._cloud(arrays, len(maps)), fused=True)
                return fused, tuple(answer.get("warnings", ()))

            about = [_ordered(last, None, 0)]
            call, result = self._checked(read, "fuse", [last], about, arrays=_largest_files(last))
            cloud, warnings = result or (cloud, warnings)
        cloud = replace(cloud, pair_stamps_ns=tuple(item.stamp_ns for item in maps))
        poses_lm_left = tuple(item.T_lm_left for item in maps)
        statistics = {} if call is None else call.statistics
        return FusedMap(cloud, cloud.sigma, poses_lm_left, statistics, warnings), call

    def _array(self, arrays: Mapping[str, bytes], what: str, fields: Collection[str] = ()) -> NDArray[Any]:
        """Return an array of an answer, with checks, because the method can write anything to its folder."""
        try:
            if what not in arrays:
                raise ValueError("there is no file")
            return parse_npy(arrays[what], fields)
        except ValueError as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, f"the {what} cannot be read: {error}") from error

    def _disparity(self, arrays: Mapping[str, bytes], pair: StereoPair) -> FloatImage | None:
        if "disparity" not in arrays:
            return None
        found: FloatImage = self._array(arrays, "disparity")
        if found.shape != pair.left.shape:
            text = f"the disparity image has the shape {found.shape}: {pair.left.shape} of the left image is required"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text)
        if np.isinf(found).any():
            raise MethodFailureError(FindingKind.NOT_FINITE, "a disparity is infinite")
        return found

    def _cloud(self, arrays: Mapping[str, bytes], pairs: int) -> PointCloud:
        """Return the points of an answer; `pairs` is the number of mapped pairs."""
        records = self._array(arrays, "cloud", tuple(FIELD_TYPES))
        try:
            cloud = PointCloud.from_structured(records, fused=False)
        except GeometryError as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, f"the cloud is invalid: {error}") from error
        if not (np.isfinite(cloud.xyz).all() and np.isfinite(cloud.sigma).all()):
            raise MethodFailureError(FindingKind.NOT_FINITE, "a point or its sigma is not finite")
        if len(cloud) and cloud.sigma.min() < 0.0:
            text = f"the sigma of a point is negative: {cloud.sigma.min():g} m"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text)
        if len(cloud) and not (cloud.u.max() < self._rig.width and cloud.v.max() < self._rig.height):
            raise MethodFailureError(FindingKind.INVALID_RESULT, "the pixel of a point is outside of the image")
        if len(cloud) and not cloud.pair.max() < pairs:
            text = f"a point has the pair number {cloud.pair.max()}: 0 to {pairs - 1} is required"
            raise MethodFailureError(FindingKind.INVALID_RESULT, text)
        return cloud


def _largest_files(pair: StereoPair) -> dict[str, int]:
    """Return the largest sizes of the files of an answer by their suffix, bytes."""
    return {"cloud": MAX_CLOUD_BYTES, "disparity": 8 * pair.left.size + 2 * MAX_HEADER}


def _ordered(pair: StereoPair, T_lm_navsb: Transform | None, index: int) -> OrderedPair:
    pose = None if T_lm_navsb is None else numbers_of(T_lm_navsb)
    return OrderedPair(stamp_ns=pair.stamp_ns, index=index, T_lm_navsb=pose)

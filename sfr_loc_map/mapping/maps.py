"""The maps of one stereo pair and of a set of pairs, by any method or by `Mapper`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import MappingError
from sfr_loc_map.geometry.arrays import FloatArray32, FloatImage, read_only
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.calibration_sigma import CalibrationSigma
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.pixel_status import StatusImage
from sfr_loc_map.mapping.findings import Findings
from sfr_loc_map.mapping.pair_view import PairView
from sfr_loc_map.mapping.point_sigma import PointSigma


@dataclass(frozen=True, slots=True, eq=False)
class PairMap:
    """The map of one stereo pair, by any method."""

    stamp_ns: int  #: Stamp of the pair.
    cloud: PointCloud  #: Points in LM with the total sigma; their `pair` is the index that was given to `process`.
    #: `(N,)`, metres, part of sigma that differs from point to point: noise, smoothing and saturation. Other
    #: methods may state the complete sigma.
    random_sigma: FloatArray32
    T_lm_left: Transform  #: Pose of the left camera in LM.
    disparity_px: FloatImage  #: Disparities of the left image `(H, W)` float32, pixels; NaN where invalid.
    statistics: Mapping[str, float] = field(default_factory=dict)  #: Statistics of the call by name.
    warnings: tuple[str, ...] = ()  #: Warnings of the call, one line each.


class ViewValues(NamedTuple):
    """The values of a `PairMap` that follow from its view.

    The fusion uses the view. A caller who filters the cloud with `dataclasses.replace` and then fuses the map would
    otherwise obtain the points of the unfiltered cloud. `fusion_input_of` therefore refuses such a map.
    """

    cloud: PointCloud
    random_sigma: FloatArray32
    T_lm_left: Transform
    disparity_px: FloatImage

    @classmethod
    def of(cls, pair_map: PairMap) -> ViewValues:
        """Return the present values of a map."""
        return cls._make(getattr(pair_map, name) for name in cls._fields)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FusionInput:
    """Data of one pair that the fusion uses."""

    rig: StereoRig  #: Rig of the pair.
    view: PairView  #: Points with their fusion sigma, disparities, pose and saturation.
    calibration: CalibrationSigma  #: Uncertainty of the calibration given the measurements in this pair.
    as_made: ViewValues  #: The values of the map as `Mapper.process` returned them.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MappedPair(PairMap):
    """The map of one stereo pair by `Mapper.process`, which `Mapper.fuse` accepts.

    The arrays of the map are read-only, so that an attempt to change them in place fails. The arrays of `fusion_input`
    share this memory and are writable, because the kernels are compiled for writable arrays. Only the fusion may use
    them.
    """

    #: `(H, W)` uint8, the `PixelStatus` of each pixel: measured, filled, or the reason why it has no disparity.
    pixel_status: StatusImage
    fusion_input: FusionInput

    @classmethod
    def of(
        cls,
        *,
        stamp_ns: int,
        index: int,
        rig: StereoRig,
        disparity_map: DisparityMap,
        view: PairView,
        sigma: PointSigma,
        calibration: CalibrationSigma,
        findings: Findings,
    ) -> MappedPair:
        """Return the map of a pair from the results of the stages of `Mapper.process`."""
        pair = np.full(view.points.size, index, np.uint8)
        cloud = view.points.to_cloud(sigma.total, pair, fused=False)
        values = ViewValues(cloud, sigma.random, view.T_lm_left, read_only(view.images.disparity))
        fusion_input = FusionInput(rig=rig, view=view, calibration=calibration, as_made=values)
        return cls(
            stamp_ns=stamp_ns,
            **values._asdict(),
            pixel_status=read_only(disparity_map.status),
            fusion_input=fusion_input,
            statistics=findings.statistics,
            warnings=findings.warnings,
        )


def fusion_input_of(pair_map: PairMap, rig: StereoRig) -> FusionInput:
    """Return the input of the fusion that `Mapper.process` stored in a map.

    Raises MappingError for a map of another method or of other cameras, and for a map whose values were replaced. The
    method is checked for callers without type checks.
    """
    if not isinstance(pair_map, MappedPair):
        raise MappingError(
            f"the map of stamp {pair_map.stamp_ns} was not made by `Mapper.process`: only such maps can be fused"
        )
    found = pair_map.fusion_input
    if not found.rig.same_cameras(rig):
        raise MappingError(
            f"the map of stamp {pair_map.stamp_ns} is from other cameras than those of this mapper: fuse maps of "
            "one rig"
        )
    values = zip(ViewValues.of(pair_map), found.as_made, strict=True)
    if any(value is not made for value, made in values):
        raise MappingError(
            f"the cloud, sigma, pose or disparities of the map of stamp {pair_map.stamp_ns} were replaced after "
            "`Mapper.process`: fuse maps as they were made, and select or move points afterwards"
        )
    return found


@dataclass(frozen=True, slots=True, eq=False)
class FusedMap:
    """The map of up to three pairs."""

    cloud: PointCloud  #: Points in LM, each on the ray of its pair and pixel, with the total sigma.
    #: `(N,)`, metres, part of sigma that differs from point to point: noise, smoothing and saturation.
    random_sigma: FloatArray32
    poses_lm_left: tuple[Transform, ...] = ()  #: Poses of the pairs' left cameras in LM, as given or as registered.
    #: Statistics of the fusion by name (overlap and disagreement per pair, ...).
    statistics: Mapping[str, float] = field(default_factory=dict)
    #: Warnings of the fusion, one line each; `Mapper.map` also includes the warnings of the pairs.
    warnings: tuple[str, ...] = ()


def warnings_of_pairs(maps: Sequence[PairMap]) -> tuple[str, ...]:
    """Return the warnings of the maps of a set of pairs, one line each, with the index of the pair."""
    return tuple(f"pair {index}: {line}" for index, item in enumerate(maps) for line in item.warnings)

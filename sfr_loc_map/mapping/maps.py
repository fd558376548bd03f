"""The maps of one stereo pair and of a set of pairs, by any method or by `Mapper`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sfr_loc_map.geometry.arrays import FloatArray32, FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.calibration_sigma import CalibrationSigma
from sfr_loc_map.mapping.disparity.pixel_status import StatusImage
from sfr_loc_map.mapping.disparity.saturation import Saturation
from sfr_loc_map.mapping.pair_view import PairView


@dataclass(frozen=True, slots=True, eq=False)
class PairMap:
    """The map of one stereo pair, by any method."""

    stamp_ns: int  #: Stamp of the pair.
    cloud: PointCloud  #: Points in LM with the total sigma; their `pair` is the index that was given to `process`.
    #: `(N,)`, metres, part of sigma that differs from point to point: noise, smoothing and saturation.
    random_sigma: FloatArray32
    T_lm_left: Transform  #: Pose of the left camera in LM.
    disparity_px: FloatImage  #: Disparities of the left image `(H, W)` float32, pixels; NaN where invalid.
    statistics: Mapping[str, float] = field(default_factory=dict)  #: Statistics of the call by name.
    warnings: tuple[str, ...] = ()  #: Warnings of the call, one line each.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FusionInput:
    """Data of one pair that the fusion uses."""

    rig: StereoRig  #: Rig of the pair.
    view: PairView  #: Points with their fusion sigma, disparities and pose.
    saturation: Saturation  #: Saturated pixels, which increase the sigma of fused points.
    calibration: CalibrationSigma  #: Uncertainty of the calibration given the measurements in this pair.
    #: Cloud, random sigma, pose and disparities that `Mapper.process` stored in the map. `Mapper.fuse` refuses a map if
    #: one of these values was replaced, because the fusion uses the view and would ignore the new value.
    original_values: tuple[object, ...]


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


@dataclass(frozen=True, slots=True, eq=False)
class FusedMap:
    """The map of up to three pairs."""

    cloud: PointCloud  #: Points in LM, each on the ray of its pair and pixel, with the total sigma.
    #: `(N,)`, metres, part of sigma that differs from point to point: noise, smoothing and saturation.
    random_sigma: FloatArray32
    T_lm_left: tuple[Transform, ...] = ()  #: Poses of the pairs' left cameras, as given or as registered.
    #: Statistics of the fusion by name (overlap and disagreement per pair, ...).
    statistics: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()  #: Warnings of the fusion, one line each.

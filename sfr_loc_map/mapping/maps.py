"""The maps of one stereo pair and of a set of pairs, by any method or by `Mapper`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

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
    cloud: PointCloud  #: Points in LM with the total sigma; their pair index is the index given to `process`.
    #: `(N,)`, metres, part of sigma that differs from point to point: noise, smoothing and saturation. Other
    #: methods may state the complete sigma.
    random_sigma: FloatArray32
    T_lm_left: Transform  #: Pose of the left camera in LM.
    disparity_px: FloatImage  #: Disparities of the left image `(H, W)` float32, pixels; NaN where invalid.
    statistics: Mapping[str, float] = field(default_factory=dict)  #: Statistics of the call by name.
    warnings: tuple[str, ...] = ()  #: Warnings of the call, one line each.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FusionInput:
    """Data of one pair that the fusion uses, and the values of the map that follow from these data."""

    rig: StereoRig  #: Rig of the pair.
    view: PairView  #: Points with their fusion sigma, disparities, pose and saturation.
    calibration: CalibrationSigma  #: Uncertainty of the calibration given the measurements in this pair.
    cloud: PointCloud  #: `PairMap.cloud` of the map.
    random_sigma: FloatArray32  #: `PairMap.random_sigma` of the map.
    disparity_px: FloatImage  #: `PairMap.disparity_px` of the map.


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
        pair_index = np.full(view.points.size, index, np.uint8)
        cloud = view.points.to_cloud(sigma.total, pair_index, fused=False)
        disparity_px = read_only(view.images.disparity)
        fusion_input = FusionInput(
            rig=rig,
            view=view,
            calibration=calibration,
            cloud=cloud,
            random_sigma=sigma.random,
            disparity_px=disparity_px,
        )
        return cls(
            stamp_ns=stamp_ns,
            cloud=cloud,
            random_sigma=sigma.random,
            T_lm_left=view.T_lm_left,
            disparity_px=disparity_px,
            pixel_status=read_only(disparity_map.status),
            fusion_input=fusion_input,
            statistics=findings.statistics,
            warnings=findings.warnings,
        )

    @property
    def is_as_made(self) -> bool:
        """Whether points, sigmas, pose and disparities are those that `Mapper.process` returned.

        The map and its arrays are read-only, so that these values can only be replaced by other objects
        (`dataclasses.replace`). The objects are therefore compared, and not their values.
        """
        made = self.fusion_input
        return (
            self.cloud is made.cloud
            and self.random_sigma is made.random_sigma
            and self.T_lm_left is made.view.T_lm_left
            and self.disparity_px is made.disparity_px
        )


def fusion_input_of(pair_map: PairMap, rig: StereoRig) -> FusionInput:
    """Return the input of the fusion that `Mapper.process` stored in a map.

    Raises MappingError for a map of another method, which only callers without type checks can give, for a stamp that
    is not an integer, and for a map of other cameras. A map whose points, sigmas, pose or disparities were replaced is
    refused as well, because the fusion uses the stored input and would ignore the new values.
    """
    if not isinstance(pair_map, MappedPair):
        raise MappingError(
            f"the map of stamp {pair_map.stamp_ns} was not made by `Mapper.process`: only such maps can be fused"
        )
    if isinstance(pair_map.stamp_ns, bool) or not isinstance(pair_map.stamp_ns, int | np.integer):
        raise MappingError(f"the stamp of a map is {pair_map.stamp_ns!r}: an integer number of nanoseconds is required")
    found = pair_map.fusion_input
    if not found.rig.same_cameras(rig):
        raise MappingError(
            f"the map of stamp {pair_map.stamp_ns} is from other cameras than those of this mapper: fuse maps of "
            "one rig"
        )
    if not pair_map.is_as_made:
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
    #: Statistics of the fusion by name, such as the overlap and the range differences of each two pairs.
    statistics: Mapping[str, float] = field(default_factory=dict)
    #: Warnings of the fusion, one line each; `Mapper.map` also includes the warnings of the pairs.
    warnings: tuple[str, ...] = ()


def warnings_of_pairs(maps: Sequence[PairMap]) -> tuple[str, ...]:
    """Return the warnings of the maps of a set of pairs, one line each, with the index of the pair."""
    return tuple(f"pair {index}: {line}" for index, item in enumerate(maps) for line in item.warnings)

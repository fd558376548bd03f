"""The maps of one stereo pair and of a set of pairs, by any method or by `Mapper`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray32, FloatImage, read_only
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.calibration_sigma import CalibrationSigma
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
class PairEstimate:
    """What the mapper estimates from one pair: the input of the fusion, and the content of the map of the pair.

    The arrays are writable, because the kernels are compiled for writable arrays. The kernels do not change them.
    """

    stamp_ns: int  #: Stamp of the pair.
    rig: StereoRig  #: Rig of the pair.
    view: PairView  #: Points with their fusion sigma, disparities, pose and saturation.
    calibration: CalibrationSigma  #: Uncertainty of the calibration given the measurements in this pair.
    pixel_status: StatusImage  #: `(H, W)` uint8, the `PixelStatus` of each pixel.
    findings: Findings  #: Statistics and warnings of the pair.


@dataclass(frozen=True, slots=True, eq=False)
class MappedPair(PairMap):
    """The map of one stereo pair by `Mapper.process`, which `Mapper.fuse` accepts.

    The map is given by its estimate, its index and its sigma. All other fields are read-only views of these values.
    They are not parameters, so that `dataclasses.replace` cannot replace a field that the fusion would then ignore.
    """

    stamp_ns: int = field(init=False)
    cloud: PointCloud = field(init=False)
    random_sigma: FloatArray32 = field(init=False)
    T_lm_left: Transform = field(init=False)
    disparity_px: FloatImage = field(init=False)
    statistics: Mapping[str, float] = field(init=False)
    warnings: tuple[str, ...] = field(init=False)
    #: `(H, W)` uint8, the `PixelStatus` of each pixel: measured, filled, or the reason why it has no disparity.
    pixel_status: StatusImage = field(init=False)
    estimate: PairEstimate  #: Input of the fusion.
    index: int  #: Pair index of the points.
    sigma: PointSigma  #: Standard deviations of the points.

    def __post_init__(self) -> None:
        """Set the fields that follow from the estimate, the index and the sigma."""
        estimate = self.estimate
        points = estimate.view.points
        pair_index = np.full(points.size, self.index, np.uint8)
        derived = {
            "stamp_ns": estimate.stamp_ns,
            "cloud": points.to_cloud(self.sigma.total, pair_index, fused=False),
            "random_sigma": self.sigma.random,
            "T_lm_left": estimate.view.T_lm_left,
            "disparity_px": read_only(estimate.view.images.disparity),
            "statistics": estimate.findings.statistics,
            "warnings": estimate.findings.warnings,
            "pixel_status": read_only(estimate.pixel_status),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)  # the dataclass is frozen


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


def warnings_of_pairs(warnings: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the warnings of each pair of a set, one line each, with the index of the pair."""
    return tuple(f"pair {index}: {line}" for index, lines in enumerate(warnings) for line in lines)

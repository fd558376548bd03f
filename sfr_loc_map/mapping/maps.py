"""The maps of one stereo pair and of a set of pairs, by any method or by `Mapper`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from sfr_loc_map.geometry.arrays import FloatArray32, FloatImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.calibration_sigma import CalibrationSigma
from sfr_loc_map.mapping.disparity.validity.pixel_status import StatusImage
from sfr_loc_map.mapping.pair_view import PairView


@dataclass(frozen=True, slots=True, eq=False)
class PairMap:
    """The map of one stereo pair, by any method."""

    stamp_ns: int  #: Stamp of the pair.
    cloud: PointCloud  #: Points in LM with the total sigma; their pair index is the index of the pair in its set.
    #: `(N,)`, metres, part of sigma that differs from point to point: noise, smoothing and saturation. Other
    #: methods may state the complete sigma.
    random_sigma: FloatArray32
    T_lm_left: Transform  #: Pose of the left camera in LM.
    disparity_px: FloatImage  #: Disparities of the left image `(H, W)` float32, pixels; NaN where invalid.
    statistics: Mapping[str, float] = field(default_factory=dict)  #: Statistics of the call by name.
    warnings: tuple[str, ...] = ()  #: Warnings of the call, one line each.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MappedPair(PairMap):
    """The map of one stereo pair by `Mapper.process`, which `Mapper.fuse` accepts.

    `fuse` uses the stamp, the rig, the view and the calibration. Replacing the cloud, a sigma, the pose or the
    disparities therefore has no effect on the fusion. To change a pose, call `process` again. The arrays outside `view`
    are read-only. The cloud and the disparities share the memory of `view`. The arrays of `view` are writable, because
    the kernels are compiled for writable arrays.
    """

    #: `(H, W)` uint8, the `PixelStatus` of each pixel: measured, filled, or the reason why it has no disparity.
    pixel_status: StatusImage
    rig: StereoRig  #: Rig of the pair.
    view: PairView  #: The pair as `fuse` requires it.
    calibration: CalibrationSigma  #: Uncertainty of the calibration given the measurements in this pair.


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

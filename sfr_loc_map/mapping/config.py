"""Parameters of the mapper."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfr_loc_map.configuration.parameters import param

MAX_PAIRS = 3  #: Maximum number of stereo pairs of one map: clause 1.3 of the specification.


@dataclass(frozen=True, slots=True)
class CalibrationPrior:
    """Standard deviations of the calibration error, which is common to all points and part of each point's sigma.

    The defaults are chosen by hand: 0.01 deg of yaw causes a disparity error of 0.14 px at a focal length of 804 px,
    and 0.1 % of the baseline or of the focal length causes 1 mm per metre of range. If all values are 0, sigma contains
    only the random part, unless a significant yaw or pitch of the right camera is measured in a pair
    (`calibration_sigma`).
    """

    yaw_deg: float = param(
        0.01,
        unit="deg",
        doc="Standard deviation of the right camera's yaw; unequal principal points along rows have the same effect.",
        low=0.0,
        high=5.0,
    )
    pitch_deg: float = param(0.01, unit="deg", doc="Standard deviation of the right camera's pitch.", low=0.0, high=5.0)
    roll_deg: float = param(0.01, unit="deg", doc="Standard deviation of the right camera's roll.", low=0.0, high=5.0)
    focal_share: float = param(0.001, doc="Standard deviation of the focal length as a fraction.", low=0.0, high=0.5)
    baseline_share: float = param(0.001, doc="Standard deviation of the baseline as a fraction.", low=0.0, high=0.5)
    distortion_px: float = param(
        0.3,
        unit="px",
        doc="Residual distortion: root mean square, over an image, of the error of a pixel's column or row. It is part "
        "of the sigma of the points unless the vertical disparity of a pair indicates another value. It also sets the "
        "vertical disparity above which a warning is issued (docs/mapping.md). 0: no residual distortion.",
        low=0.0,
        high=10.0,
    )


@dataclass(frozen=True, slots=True)
class TerrainConfig:
    """Parameters of the elevation and hazard grids; the defaults suit a medium rover with six wheels."""

    cell_m: float = param(0.1, unit="m", doc="Side of a cell of the elevation and hazard grids.", low=0.01, high=10.0)
    range_m: float = param(
        10.0,
        unit="m",
        doc="Points farther than this from the mean position of the cameras, along x or y of LM, are excluded from the "
        "grids.",
        low=0.5,
        high=1000.0,
    )
    footprint_radius_m: float = param(
        0.5,
        unit="m",
        doc="Radius of the rover's footprint. Slope and roughness are computed within the footprint, or within 1.5 "
        "cells if this is larger. A step anywhere within the footprint is a hazard.",
        low=0.0,
        high=10.0,
    )
    max_slope_deg: float = param(20.0, unit="deg", doc="Slope at which a cell becomes a hazard.", low=0.1, high=89.0)
    max_roughness_m: float = param(
        0.05, unit="m", doc="Roughness at which a cell becomes a hazard.", low=0.001, high=10.0
    )
    max_step_m: float = param(
        0.18, unit="m", doc="Step at which a cell becomes a hazard; about the radius of a wheel.", low=0.001, high=10.0
    )


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """Parameters of the mapper and of the grids that are computed from its cloud.

    ROS parameters and configuration files have the same names.
    """

    min_range_m: float = param(
        0.9, unit="m", doc="Minimum depth of the search; nearer surfaces may be found, too.", low=0.05, high=1000.0
    )
    max_range_m: float = param(40.0, unit="m", doc="Depth beyond which points are dropped.", low=0.1, high=10_000.0)
    refine_poses: bool = param(
        False, doc="Register the poses of the second and third pair (up to 2 degrees, 0.1 m) where pairs overlap."
    )
    calibration: CalibrationPrior = field(default_factory=CalibrationPrior)
    terrain: TerrainConfig = field(default_factory=TerrainConfig)

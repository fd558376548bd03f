"""Settings of a simulated data set."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from sfr_loc_map.configuration.parameters import param

MAX_CRATER_DENSITY = 0.057
"""Largest density of craters, 1/m^2. At 1 / (0.75 * 4.8^2) = 0.058, every cell of a size class has its one crater."""
MAX_DRIVE_PAIRS = 1_000_000  #: Largest number of pairs of a drive.


@dataclass(frozen=True, slots=True)
class ReliefConfig:
    """Shape of the ground."""

    relief_m: float = param(
        0.10,
        unit="m",
        doc="Height scale of the rolling relief, about 1.25 standard deviations of the height.",
        low=0.0,
        high=50.0,
    )
    relief_length_m: float = param(7.0, unit="m", doc="Longest wavelength of the rolling relief.", low=0.5, high=1000.0)
    hurst: float = param(0.85, doc="Hurst exponent; lower values are rougher at small scales.", low=0.3, high=1.2)
    hills_m: float = param(
        1.2,
        unit="m",
        doc="Height scale of the hills on the horizon, about 1.16 standard deviations of the height.",
        low=0.0,
        high=1000.0,
    )
    hills_length_m: float = param(90.0, unit="m", doc="Wavelength of the hills.", low=10.0, high=10_000.0)
    slope_deg: float = param(0.0, unit="deg", doc="Slope of the terrain, rising to the east.", low=-35.0, high=35.0)
    ripple_height_m: float = param(0.012, unit="m", doc="Height of ripples on sand.", low=0.0, high=5.0)
    ripple_length_m: float = param(0.55, unit="m", doc="Wavelength of wind ripples.", low=0.05, high=100.0)
    ripple_azimuth_deg: float = param(
        35.0, unit="deg", doc="Direction across the ripples in DS, from east to north.", low=-360.0, high=360.0
    )
    crater_density: float = param(
        0.004, unit="1/m^2", doc="Number of craters wider than 1 m, per area.", low=0.0, high=MAX_CRATER_DENSITY
    )
    rim_radius_m: float = param(0.0, unit="m", doc="Radius of one large crater; 0 for none.", low=0.0, high=10_000.0)
    rim_x_m: float = param(0.0, unit="m", doc="Large crater: east coordinate in DS.", low=-10_000.0, high=10_000.0)
    rim_y_m: float = param(0.0, unit="m", doc="Large crater: north coordinate in DS.", low=-10_000.0, high=10_000.0)
    coarseness: float = param(
        1.0,
        doc="Triangle size relative to full detail, for previews. Waves that the triangles do not resolve are absent, "
        "such as the default ripples from 13 on.",
        low=1.0,
        high=64.0,
    )


@dataclass(frozen=True, slots=True)
class GroundConfig:
    """Materials and appearance of the ground."""

    albedo: float = param(0.22, doc="Mean reflectance of the ground.", low=0.01, high=1.0)
    contrast: float = param(1.0, doc="Strength of the variation of reflectance.", low=0.0, high=3.0)
    bump: float = param(1.0, doc="Strength of the fine relief in the shading.", low=0.0, high=3.0)
    gravel: float = param(0.5, doc="Fraction of the ground with dense pebbles.", low=0.0, high=1.0)
    bedrock: float = param(0.08, doc="Fraction of the ground that is bare rock.", low=0.0, high=1.0)
    pebbles: float = param(0.6, doc="Density of pebbles on gravel.", low=0.0, high=1.0)
    lunar: float = param(0.35, doc="Weight of Lommel-Seeliger reflection; the rest is Lambert.", low=0.0, high=1.0)


@dataclass(frozen=True, slots=True)
class RockConfig:
    """Number, size and depth of the rocks."""

    cover: float = param(0.05, doc="Fraction of the ground under rocks (Golombek and Rapp 1997).", low=0.0, high=0.4)
    smallest_m: float = param(0.03, unit="m", doc="Smallest diameter; smaller stones are pebbles.", low=0.01, high=5.0)
    largest_m: float = param(
        1.5, unit="m", doc="Largest diameter; the size distribution ends at 5 m.", low=0.05, high=5.0
    )
    buried: float = param(0.35, doc="Mean fraction of the height below ground.", low=0.0, high=0.9)
    angular: float = param(0.5, doc="0 for rounded, 1 for angular rocks.", low=0.0, high=1.0)
    albedo: float = param(0.19, doc="Mean reflectance of rocks.", low=0.01, high=1.0)
    clear_m: float = param(0.12, unit="m", doc="Largest rock diameter on the rover's path.", low=0.0, high=50.0)


@dataclass(frozen=True, slots=True)
class LightConfig:
    """Sun, sky and haze."""

    sun_elevation_deg: float = param(38.0, unit="deg", doc="Elevation of the sun.", low=1.0, high=90.0)
    sun_azimuth_deg: float = param(
        120.0, unit="deg", doc="Azimuth of the sun in DS, from east to north.", low=-360.0, high=360.0
    )
    sun_radius_deg: float = param(
        0.18, unit="deg", doc="Angular radius of the sun, for soft shadows.", low=0.0, high=10.0
    )
    sky: float = param(0.35, doc="Sky light on level ground, relative to an overhead sun.", low=0.0, high=2.0)
    sky_grey: float = param(
        0.62, doc="Brightness of the sky above the horizon, fraction of the full range.", low=0.0, high=1.5
    )
    haze_m: float = param(
        600.0, unit="m", doc="Distance at which haze removes 63 % of the contrast.", low=1.0, high=1e6
    )
    rover_shadow: bool = param(False, doc="Whether the rover casts a shadow.")


@dataclass(frozen=True, slots=True)
class CamerasConfig:
    """A rectified stereo rig."""

    width: int = param(512, unit="px", doc="Columns.", low=16, high=8192)
    height: int = param(512, unit="px", doc="Rows.", low=16, high=8192)
    focal_px: float = param(402.0, unit="px", doc="Focal length.", low=5.0, high=100000.0)
    baseline_m: float = param(0.12, unit="m", doc="Distance between the optical centres.", low=0.001, high=100.0)
    x_m: float = param(0.52, unit="m", doc="Forward offset from RB or the mast head.", low=-100.0, high=100.0)
    y_m: float = param(0.015, unit="m", doc="Offset to the left from RB or the mast head.", low=-100.0, high=100.0)
    z_m: float = param(0.63, unit="m", doc="Upward offset from RB or the mast head.", low=-100.0, high=100.0)
    roll_deg: float = param(0.4, unit="deg", doc="Rotation about x, applied first.", low=-360.0, high=360.0)
    pitch_deg: float = param(19.0, unit="deg", doc="Rotation about y; positive is downwards.", low=-360.0, high=360.0)
    yaw_deg: float = param(1.0, unit="deg", doc="Rotation about z, applied last.", low=-360.0, high=360.0)


def _redefault(name: str, default: float) -> Any:  # noqa: ANN401 - fields have any type
    """Return a parameter of `CamerasConfig` with another default."""
    return field(default=default, metadata=CamerasConfig.__dataclass_fields__[name].metadata)


@dataclass(frozen=True, slots=True)
class NavCamerasConfig(CamerasConfig):
    """The mapping cameras on the mast head."""

    width: int = _redefault("width", 1024)
    height: int = _redefault("height", 1024)
    focal_px: float = _redefault("focal_px", 804.0)
    baseline_m: float = _redefault("baseline_m", 0.15)
    x_m: float = _redefault("x_m", 0.06)
    y_m: float = _redefault("y_m", 0.0)
    z_m: float = _redefault("z_m", 0.08)
    roll_deg: float = _redefault("roll_deg", 0.0)
    pitch_deg: float = _redefault("pitch_deg", 0.0)
    yaw_deg: float = _redefault("yaw_deg", 0.0)


@dataclass(frozen=True, slots=True)
class DriveConfig:
    """Drive of the rover with the localisation cameras. If it is disabled, the rover stays at the start."""

    enabled: bool = param(True, doc="Whether to render the drive (localisation pairs).")
    segments: tuple[str, ...] = param(
        ("straight 4", "arc 6 40", "arc -8 30", "straight 4"),
        doc="Path: straight M, arc RADIUS_M (> 0: left) ANGLE_DEG, turn DEG, stop S, goto X Y; M and ANGLE_DEG < 0: "
        "backwards.",
    )
    start_x_m: float = param(0.0, unit="m", doc="East coordinate of the start in DS.", low=-10_000.0, high=10_000.0)
    start_y_m: float = param(0.0, unit="m", doc="North coordinate of the start in DS.", low=-10_000.0, high=10_000.0)
    start_heading_deg: float = param(
        30.0, unit="deg", doc="Heading at the start in DS, from east to north.", low=-360.0, high=360.0
    )
    speed_m_s: float = param(0.15, unit="m/s", doc="Speed along straight lines and arcs.", low=0.001, high=100.0)
    turn_rate_deg_s: float = param(4.0, unit="deg/s", doc="Angular rate of point turns.", low=0.01, high=360.0)
    period_s: float = param(0.5, unit="s", doc="Time between two pairs.", low=0.001, high=3600.0)
    pairs: int = param(0, doc="Largest number of pairs; 0 for no limit.", low=0, high=MAX_DRIVE_PAIRS)
    slip: float = param(0.08, doc="Mean wheel slip; the slip varies along the path.", low=0.0, high=0.9)
    sway_m: float = param(0.01, unit="m", doc="Standard deviation of the sideways drift.", low=0.0, high=10.0)
    sway_deg: float = param(0.8, unit="deg", doc="Standard deviation of the heading error.", low=0.0, high=45.0)
    vibration_deg: float = param(0.08, unit="deg", doc="Vibration in roll, pitch and yaw, 1 sigma.", low=0.0, high=10.0)
    vibration_m: float = param(0.0006, unit="m", doc="Vibration in height, 1 sigma.", low=0.0, high=1.0)


@dataclass(frozen=True, slots=True)
class PanoramaConfig:
    """Panorama of up to three pairs of the mapping cameras on the mast, with the rover at the start of its path."""

    enabled: bool = param(False, doc="Whether to render the mapping pairs.")
    pan_deg: tuple[float, ...] = param(
        (42.0, 0.0, -42.0), doc="Pan of each pair; positive to the left.", low=-360.0, high=360.0
    )
    tilt_deg: tuple[float, ...] = param(
        (20.0, 20.0, 20.0), doc="Tilt of each pair; positive down.", low=-90.0, high=90.0
    )
    period_s: float = param(1.0, unit="s", doc="Time between two pairs.", low=0.001, high=3600.0)


@dataclass(frozen=True, slots=True)
class SensorConfig:
    """Sensor model, from brightness to grey levels."""

    samples: int = param(4, doc="Rays per pixel, at different times within the exposure.", low=1, high=64)
    target_grey: float = param(
        0.48, doc="Brightness of level sunlit ground, fraction of the range.", low=0.01, high=1.0
    )
    blur_px: float = param(0.45, unit="px", doc="Standard deviation of the point spread function.", low=0.0, high=5.0)
    exposure_s: float = param(0.0, unit="s", doc="Exposure time for motion blur; 0 for none.", low=0.0, high=10.0)
    full_well: float = param(
        12000.0, doc="Electrons at the full range, for photon noise; 0 for none.", low=0.0, high=1e9
    )
    read_noise_grey: float = param(0.6, doc="Standard deviation of read noise, 8-bit grey levels.", low=0.0, high=50.0)
    gain_step: float = param(
        0.0, doc="Standard deviation of the logarithm of the exposure, from pair to pair.", low=0.0, high=1.0
    )
    gain_mismatch: float = param(
        0.0,
        doc="Standard deviation of the logarithm of the ratio of the right exposure to the left exposure.",
        low=0.0,
        high=1.0,
    )
    adc_bits: int = param(8, doc="Bits of the converter; images are stored with 8.", low=4, high=16)


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """A simulated data set."""

    seed: int = param(1, doc="Random seed.", low=0, high=2**63 - 1)
    start_stamp_ns: int = param(1_700_000_000_000_000_000, unit="ns", doc="Stamp of the first pair.", low=0, high=2**62)
    terrain: ReliefConfig = field(default_factory=ReliefConfig)
    ground: GroundConfig = field(default_factory=GroundConfig)
    rocks: RockConfig = field(default_factory=RockConfig)
    light: LightConfig = field(default_factory=LightConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)
    loc: CamerasConfig = field(default_factory=CamerasConfig)
    panorama: PanoramaConfig = field(default_factory=PanoramaConfig)
    nav: NavCamerasConfig = field(default_factory=NavCamerasConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)

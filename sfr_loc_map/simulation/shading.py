"""The brightness of ray hits (`shade`): surfaces (`surface`) under sun and sky, seen through haze.

Lengths are in metres, positions in DS. A footprint is the size of a pixel on a surface. Arrays are `(N,)`. The page
docs/simulation.md states the source of each number.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.config import LightConfig, SimulationConfig
from sfr_loc_map.simulation.pebbles import PebbleField, pebble_cache
from sfr_loc_map.simulation.surface import (
    GroundHits,
    GroundTexture,
    SurfaceParameters,
    Vector,
    ground_surface,
    ground_texture,
    rock_surface,
)
from sfr_loc_map.simulation.terrain import Terrain
from sfr_loc_map.simulation.tracer import GROUND, SKY, Hits

RUN = 1024  #: Number of rays that are shaded together: their data fit into the first-level cache.
ZENITH_DARKENING = 0.25  #: Fraction by which the sky is darker at the zenith than at the horizon.
HORIZON_BRIGHTENING = 0.06  #: Fraction by which the sky is brighter at the horizon.
HORIZON_DECAY = 12.0  #: Rate of the decrease of the bright horizon with the sine of the elevation.
HAZE_BRIGHTNESS = 0.9  #: Ratio of the brightness of the haze to that of the sky.
WALL_SKY = 0.55  #: Fraction of the sky light that a vertical surface receives.
SKY_PER_COSINE = 0.45  #: Additional fraction that a level surface receives.
PEBBLE_SHADOW_SKY = 0.6  #: Fraction of the sky light that remains in the shadow of a pebble.
MIN_EMISSION_COSINE = 0.05  #: Lower bound of the cosine of the emission angle for the reflection.
MIN_FOOTPRINT_COSINE = 0.08  #: Lower bound of the cosine of the emission angle for the footprint.
MIN_REFLECTION = 1e-6  #: Added to the sum of the cosines in the law of reflection, which is a divisor.
LEVEL_MU = 0.5  #: Cosine of the emission angle of the level ground that defines the brightness of an image.


class ShadingParameters(NamedTuple):
    """Appearance of ground and rocks, sun, sky and haze."""

    surface: SurfaceParameters  #: Ground and rocks.
    lunar: float  #: Weight of Lommel-Seeliger reflection; the rest is Lambert.
    sky: float  #: Sky light on level ground, relative to an overhead sun.
    sky_grey: float  #: Brightness of the sky above the horizon.
    haze_m: float  #: Distance at which haze removes 63 % of the contrast.
    sun_x: float  #: East component of the unit vector towards the sun, DS.
    sun_y: float  #: North component.
    sun_z: float  #: Vertical component.
    gain: float  #: Factor that scales level, sunlit ground of mean reflectance to a brightness of 1.
    target: float  #: Brightness of this ground in the image, fraction of the full range.


def sun_direction(light: LightConfig) -> FloatArray:
    """Return the unit vector `(3,)` towards the sun, DS. The azimuth is measured from east to north."""
    elevation = math.radians(light.sun_elevation_deg)
    azimuth = math.radians(light.sun_azimuth_deg)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])


def shading_parameters(config: SimulationConfig, sun: FloatArray, terrain: Terrain) -> ShadingParameters:
    """Return the parameters of the shading; `sun` is the unit vector `(3,)` towards the sun, DS."""
    ground = config.ground
    light = config.light
    level_light = reflect(sun[2], LEVEL_MU, ground.lunar) * sun[2] + light.sky
    surface = SurfaceParameters(
        albedo=float(ground.albedo),
        contrast=float(ground.contrast),
        bump=float(ground.bump),
        rock_albedo=float(config.rocks.albedo),
        field=PebbleField.of(float(ground.pebbles), float(ground.bump), terrain.parameters.seed, sun),
        terrain=terrain.parameters,
    )
    return ShadingParameters(
        surface=surface,
        lunar=float(ground.lunar),
        sky=float(light.sky),
        sky_grey=float(light.sky_grey),
        haze_m=float(light.haze_m),
        sun_x=float(sun[0]),
        sun_y=float(sun[1]),
        sun_z=float(sun[2]),
        gain=float(1.0 / (ground.albedo * level_light)),
        target=float(config.sensor.target_grey),
    )


@jit_inline
def reflect(mu0: float, mu: float, lunar: float) -> float:
    """Return lunar-Lambert reflection divided by the cosine of incidence: `2 L / (mu0 + mu) + 1 - L` (McEwen 1991)."""
    return 2.0 * lunar / (mu0 + mu + MIN_REFLECTION) + 1.0 - lunar


@jit
def shade(
    hits: Hits,
    rays: FloatArray,
    lit: NDArray[np.float32],
    pixel_rad: float,
    parameters: ShadingParameters,
    out: NDArray[np.float32],
) -> None:
    """Write the brightness of ray hits, as a fraction of the full range."""
    ground = GroundHits(np.empty(RUN, np.int64), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN))
    texture = GroundTexture(
        np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN)
    )
    cache = pebble_cache()
    surface = parameters.surface
    target = parameters.target
    for start in range(0, len(hits.objects), RUN):
        end = min(start + RUN, len(hits.objects))
        count = 0
        for n in range(start, end):
            if hits.objects[n] == GROUND:
                ground.ray[count] = n
                ground.range[count] = hits.ranges[n]
                ground.x[count] = hits.points[n, 0]
                ground.y[count] = hits.points[n, 1]
                ground.footprint[count] = _footprint(hits.normals[n], rays[n], hits.ranges[n] * pixel_rad)
                count += 1
        ground_texture(count, ground, surface.bump, surface.terrain, texture)
        for m in range(count):
            n = ground.ray[m]
            albedo, sx, sy, sunlit = ground_surface(ground, texture, m, pixel_rad, surface, cache)
            normal = hits.normals[n]
            slanted = normal[0] - sx * normal[2], normal[1] - sy * normal[2], normal[2]
            mu = _emission_cosine(normal, rays[n])
            out[n] = surface_brightness(slanted, mu, hits.ranges[n], target * albedo, sunlit, lit[n], parameters)
        for n in range(start, end):
            if hits.objects[n] == SKY:
                up = max(rays[n, 2], 0.0)
                horizon = HORIZON_BRIGHTENING * math.exp(-HORIZON_DECAY * up)
                out[n] = parameters.sky_grey * (1.0 - ZENITH_DARKENING * up + horizon)
            elif hits.objects[n] != GROUND:
                normal = hits.normals[n]
                footprint = _footprint(normal, rays[n], hits.ranges[n] * pixel_rad)
                albedo, bump = rock_surface(hits.points[n], footprint, hits.objects[n], surface)
                slanted = _bumped(normal, bump)
                mu = _emission_cosine(normal, rays[n])
                out[n] = surface_brightness(slanted, mu, hits.ranges[n], target * albedo, 1.0, lit[n], parameters)


@jit_inline
def _bumped(normal: FloatArray, gradient: Vector) -> Vector:
    """Return the normal, tilted by the tangential component of a bump gradient."""
    nx = normal[0]
    ny = normal[1]
    nz = normal[2]
    gx, gy, gz = gradient
    along = gx * nx + gy * ny + gz * nz
    return nx - (gx - along * nx), ny - (gy - along * ny), nz - (gz - along * nz)


@jit_inline
def _emission_cosine(normal: FloatArray, ray: FloatArray) -> float:
    """Return the cosine of the emission angle at the meshed surface, without the fine relief.

    With the fine relief, the texture would change with the viewpoint, but without the parallax and occlusion of real
    relief. The texture would appear shifted by 0.01 px between the left and the right image.
    """
    return float(max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), MIN_EMISSION_COSINE))


@jit_inline
def _footprint(normal: FloatArray, ray: FloatArray, small: float) -> float:
    """Return the size of a pixel on a surface, a weighted geometric mean of the sizes across and along the view.

    The size is proportional to cos^(-3/8) of the emission angle. The size across the line of sight does not depend on
    the emission angle, and the size along it is proportional to cos^(-1).
    """
    cosine = max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), MIN_FOOTPRINT_COSINE)
    root4 = math.sqrt(math.sqrt(cosine))
    return float(small / (root4 * math.sqrt(root4)))  # 1/4 + 1/8 = 3/8; square roots are faster than a power


@jit_inline
def surface_brightness(
    normal: Vector, mu: float, distance: float, albedo: float, sunlit: float, lit: float, parameters: ShadingParameters
) -> float:
    """Return the brightness of a surface under sun and sky, seen through haze.

    `normal` need not have unit length, `mu` is the cosine of the emission angle, and `distance` is in metres. `sunlit`
    is the fraction of the sunlight that pebbles let pass, and `lit` is 0 in the shadow of the ground and of rocks. A
    level surface receives all sky light. Pebbles that block the sun also block a part of the sky light.
    """
    nx, ny, nz = normal
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    nx *= scale
    ny *= scale
    nz *= scale
    mu0 = max(nx * parameters.sun_x + ny * parameters.sun_y + nz * parameters.sun_z, 0.0)
    direct = reflect(mu0, mu, parameters.lunar) * mu0 * sunlit * lit
    open_sky = parameters.sky * (WALL_SKY + SKY_PER_COSINE * nz)
    open_sky *= PEBBLE_SHADOW_SKY + (1.0 - PEBBLE_SHADOW_SKY) * sunlit
    clear = math.exp(-distance / parameters.haze_m)
    haze = (1.0 - clear) * HAZE_BRIGHTNESS * parameters.sky_grey
    return float(parameters.gain * albedo * (direct + open_sky) * clear + haze)

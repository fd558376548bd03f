"""Texture and illumination of the ground, the pebbles and the rocks that rays hit.

Lengths are in metres, positions in DS. A footprint is the size of a pixel on the ground. Arrays are `(N,)`. Loops that
should be vectorised have no branches and only inlined calls. The page docs/simulation.md states the source of each
number.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.config import LightConfig, SimulationConfig, settings_in
from sfr_loc_map.simulation.noise import Stream, hash2, mix, unit, value2, value3
from sfr_loc_map.simulation.pebbles import PebbleCache, PebbleField, pebble_cache, pebbles
from sfr_loc_map.simulation.terrain import Terrain, TerrainParameters, materials, smooth_step
from sfr_loc_map.simulation.tracer import GROUND, SKY, Hits

UNMESHED_M = 0.12
UNMESHED_PER_RANGE = 0.03
"""Wavelengths below this length, m, or below this fraction of the range are too short for the mesh of the ground."""
GRAIN_M = 0.045  #: Longest wavelength of the reflectance that counts as grain, m.
OCTAVES = 9  #: Number of octaves of the fine relief and reflectance.
LONGEST_M = 3.1  #: Longest wavelength of these octaves, m.
OCTAVE_RATIO = 0.46  #: Ratio of the wavelengths of successive octaves.
RUN = 1024  #: Number of rays that are shaded together: their data fit into the first-level cache.
STONE_OCTAVES = 7  #: Number of octaves of the surface of a rock; each has half the wavelength of the previous octave.
LONGEST_STONE_M = 0.24  #: Longest wavelength of these octaves, m.
PLATE_M = 0.42  #: Width of the plates of bare rock, m.
CRACK_M = 0.009  #: Width of the cracks between plates, m.
PLATE_SLOPE = 0.16  #: Range of the slopes of the plates: up to 0.08 to either side.
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
_FINE = np.uint32(Stream.FINE_TEXTURE)
_PLATE = np.uint32(Stream.PLATES)
_STONE = np.uint32(Stream.ROCK_SURFACE)
Vector = tuple[float, float, float]  #: A vector in DS.


class GroundHits(NamedTuple):
    """Ray hits of the ground that are shaded together; arrays are `(N,)` float64 unless noted."""

    ray: IntArray  #: int64, index of the ray.
    x: FloatArray  #: Metres, DS.
    y: FloatArray  #: Metres, DS.
    range: FloatArray  #: Metres.
    footprint: FloatArray  #: Size of a pixel on the ground, metres.


class GroundTexture(NamedTuple):
    """Materials and fine structure at positions; arrays are `(N,)` float64."""

    sand: FloatArray  #: Fraction of sand.
    gravel: FloatArray  #: Fraction of gravel.
    rock: FloatArray  #: Fraction of bare rock.
    tone: FloatArray  #: Logarithm of the ratio of the reflectance to the mean.
    slope_x: FloatArray  #: Slope of the fine structure to the east.
    slope_y: FloatArray  #: Slope of the fine structure to the north.
    grain: FloatArray  #: Graininess, 0.5 for sand to 1 for gravel.


@jit_inline
def fade_of(length: float, footprint: float) -> float:
    """Return the contrast of a wave in a pixel: 0 for wavelengths below 1.4 footprints, 1 above 3.4 footprints."""
    return min(max((length / footprint - 1.4) * 0.5, 0.0), 1.0)


@jit
def ground_texture(count: int, hits: GroundHits, bump: float, terrain: TerrainParameters, out: GroundTexture) -> None:
    """Write materials, tone and slopes of the fine structure, with octaves from 3 m down to the footprint.

    Waves too short for the mesh contribute slopes. Waves shorter than `GRAIN_M` also contribute grain. The slopes are
    the gradient of the tone rotated by 90 deg, so that slopes and tone are uncorrelated. Otherwise the view-dependent
    reflection of dusty ground would shift the texture between the two images by about 0.02 px.
    """
    x = hits.x
    y = hits.y
    ranges = hits.range
    footprints = hits.footprint
    tone = out.tone
    sx = out.slope_x
    sy = out.slope_y
    grain = out.grain
    for n in range(count):
        out.sand[n], out.gravel[n], out.rock[n] = materials(x[n], y[n], terrain)
    finest = np.inf
    for n in range(count):
        tone[n] = 0.0
        sx[n] = 0.0
        sy[n] = 0.0
        grain[n] = 0.5 * out.sand[n] + out.gravel[n] + 0.65 * out.rock[n]
        finest = min(finest, footprints[n])
    length = LONGEST_M
    c, s = 1.0, 0.0  # cosine and sine of the angle of the octave's grid
    for k in range(OCTAVES):
        if fade_of(length, finest) <= 0.0:
            break
        key = terrain.seed ^ _FINE ^ np.uint32(k)
        cc = c / length
        ss = s / length
        shift = 0.37 * k
        low, high = (0.03, 0.11) if length < UNMESHED_M else (0.07, 0.0)
        smooth, rough = (0.11, 0.0) if length > GRAIN_M else (0.17, 0.26)
        for n in range(count):
            fade = fade_of(length, footprints[n])
            v, gx, gy = value2(cc * x[n] + ss * y[n] + shift, cc * y[n] - ss * x[n], key)
            tone[n] += fade * v * (smooth + rough * grain[n])
            unmeshed = length < max(UNMESHED_M, UNMESHED_PER_RANGE * ranges[n])
            slope = fade * bump * (low + high * grain[n]) if unmeshed else 0.0
            sx[n] -= slope * (s * gx + c * gy)
            sy[n] += slope * (c * gx - s * gy)
        c, s = 0.8 * c - 0.6 * s, 0.6 * c + 0.8 * s
        length *= OCTAVE_RATIO


@jit
def plates(x: float, y: float, footprint: float, seed: np.uint32) -> tuple[float, float, float]:
    """Return the darkness, 0 to 1, of cracks between plates of bare rock, and the slopes of the plates (Voronoi cells).

    Noise makes the edges jagged. The sizes were chosen by comparison with images of bedrock.
    """
    cell = PLATE_M
    wx = x / cell + 0.35 * value2(x * 2.1, y * 2.1, seed ^ _PLATE)[0]
    wy = y / cell + 0.35 * value2(x * 2.1 + 7.0, y * 2.1, seed ^ _PLATE)[0]
    jag, shift, _ = value2(x * 17.0 + 3.0 * y, y * 17.0 - 3.0 * x, seed ^ _PLATE)
    wx += 0.045 * jag
    wy += 0.02 * shift
    i0 = math.floor(wx)
    j0 = math.floor(wy)
    first = 9.0  # squared distances of the nearest and of the second nearest centre of a plate, in cells
    second = 9.0
    best = np.uint32(0)
    for i in range(i0 - 1, i0 + 2):
        for j in range(j0 - 1, j0 + 2):
            h = hash2(i, j, seed ^ _PLATE)
            dx = i + unit(h) - wx
            dy = j + unit(mix(h)) - wy
            d = dx * dx + dy * dy
            if d < first:
                second = first
                first = d
                best = h
            elif d < second:
                second = d
    edge = (math.sqrt(second) - math.sqrt(first)) * cell
    width = CRACK_M * (1.0 + 0.8 * jag)
    crack = (1.0 - smooth_step(0.3 * width, width + footprint, edge)) * min(1.0, width / footprint)
    tilt = mix(best ^ np.uint32(5))
    return crack, PLATE_SLOPE * (unit(tilt) - 0.5), PLATE_SLOPE * (unit(mix(tilt)) - 0.5)


class ShadingParameters(NamedTuple):
    """Appearance of ground, rocks, sun, sky and haze; a field named like a setting has its value."""

    albedo: float  #: Mean reflectance of the ground.
    contrast: float  #: Strength of the variation of reflectance.
    bump: float  #: Strength of the fine relief.
    lunar: float  #: Weight of Lommel-Seeliger reflection; the rest is Lambert.
    sky: float  #: Sky light on level ground, relative to an overhead sun.
    sky_grey: float  #: Brightness of the sky above the horizon.
    haze_m: float  #: Distance at which haze removes 63 % of the contrast.
    rock_albedo: float  #: Mean reflectance of rocks.
    sun_x: float  #: East component of the unit vector towards the sun, DS.
    sun_y: float  #: North component.
    sun_z: float  #: Vertical component.
    gain: float  #: Factor that scales level, sunlit ground of mean reflectance to a brightness of 1.
    target: float  #: Brightness of this ground in the image, fraction of the full range.
    field: PebbleField  #: The pebbles.
    terrain: TerrainParameters  #: The ground.


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
    return ShadingParameters(
        **settings_in(ground, ShadingParameters._fields),
        **settings_in(light, ShadingParameters._fields),
        sun_x=float(sun[0]),
        sun_y=float(sun[1]),
        sun_z=float(sun[2]),
        rock_albedo=float(config.rocks.albedo),
        gain=float(1.0 / (ground.albedo * level_light)),
        target=float(config.sensor.target_grey),
        field=PebbleField.of(float(ground.pebbles), float(ground.bump), terrain.parameters.seed, sun),
        terrain=terrain.parameters,
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
        ground_texture(count, ground, parameters.bump, parameters.terrain, texture)
        for m in range(count):
            n = ground.ray[m]
            albedo, sx, sy, sunlit = _ground(ground, texture, m, pixel_rad, parameters, cache)
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
                albedo, bump = _stone(hits.points[n], footprint, hits.objects[n], parameters)
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


@jit_inline
def _ground(
    hits: GroundHits,
    texture: GroundTexture,
    m: int,
    pixel_rad: float,
    parameters: ShadingParameters,
    cache: PebbleCache,
) -> tuple[float, float, float, float]:
    """Return the reflectance, the two slopes of the fine relief, and the fraction of sunlight that pebbles let pass.

    Sand is 22 % and rock 27 % brighter than gravel. The reflectance is limited to 0.2 to 3.3 times the mean. The
    weights were chosen by eye.
    """
    x = hits.x[m]
    y = hits.y[m]
    sand = texture.sand[m]
    gravel = texture.gravel[m]
    rock = texture.rock[m]
    sx = texture.slope_x[m]
    sy = texture.slope_y[m]
    tone = 0.85 * texture.tone[m] + 0.10 * sand + 0.14 * rock - 0.10 * gravel
    bump = parameters.bump
    field = parameters.field
    if rock > 0.02:
        crack, cx, cy = plates(x, y, hits.footprint[m], field.seed)
        tone -= 0.9 * rock * rock * rock * crack
        sx += rock * cx * bump
        sy += rock * cy * bump
    fill = field.fill * (gravel + 0.05 * sand + 0.12 * rock)
    cover, grey, px, py, shadow = pebbles(x, y, hits.range[m] * pixel_rad, fill, field, cache)
    sunlit = 1.0
    if cover > 0.0 or shadow > 0.0:
        tone = (1.0 - cover) * tone + cover * grey
        sx = (1.0 - cover) * sx + cover * px
        sy = (1.0 - cover) * sy + cover * py
        sunlit = 1.0 - (1.0 - cover) * shadow
    return parameters.albedo * math.exp(min(max(parameters.contrast * tone, -1.6), 1.2)), sx, sy, sunlit


@jit
def _stone(point: FloatArray, footprint: float, number: int, parameters: ShadingParameters) -> tuple[float, Vector]:
    """Return reflectance and bump gradient of a rock's surface, with octaves from 0.24 m to 4 mm.

    Half of the rocks are dusty, and therefore brighter. The amplitudes were chosen by eye.
    """
    x = point[0]
    y = point[1]
    z = point[2]
    seed = parameters.terrain.seed
    h = mix(np.uint32(number) ^ seed ^ _STONE)
    tone = 0.5 * (unit(h) - 0.5)
    gx, gy, gz = 0.0, 0.0, 0.0
    length = LONGEST_STONE_M
    for k in range(STONE_OCTAVES):
        fade = fade_of(length, footprint)
        if fade <= 0.0:
            break
        v, a, b, c = value3(x / length + 0.41 * k, y / length + 0.17 * k, z / length, seed ^ _STONE ^ np.uint32(k))
        tone += 0.16 * fade * v
        slope = 0.13 * fade * parameters.bump
        # the components of the gradient are permuted, so that slopes and tone are uncorrelated (`ground_texture`)
        gx += slope * b
        gy += slope * c
        gz += slope * a
        length *= 0.5
    dust = smooth_step(0.75, 1.0, 0.5 + 0.5 * unit(mix(h)))
    reflectance = parameters.rock_albedo * math.exp(min(max(parameters.contrast * (tone + 0.2 * dust), -1.5), 1.2))
    return reflectance, (gx, gy, gz)

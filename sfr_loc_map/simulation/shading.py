"""Appearance of what rays hit: texture of the ground, pebbles, rocks, and its light.

Lengths are metres, positions are in DS, a footprint is the size of a pixel on the ground, arrays are `(N,)`. Loops over
positions have no branches and no calls that are not inlined where they shall become vector code. The page
docs/simulation.md has the source of each number.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.config import SimulationConfig, settings_in
from sfr_loc_map.simulation.noise import Stream, hash2, mix, unit, value2, value3
from sfr_loc_map.simulation.pebbles import PebbleCache, PebbleField, pebble_cache, pebbles
from sfr_loc_map.simulation.terrain import Terrain, TerrainParameters, materials, smooth_step
from sfr_loc_map.simulation.tracer import GROUND, SKY, Hits

UNMESHED_M = 0.12
UNMESHED_PER_RANGE = 0.03
"""Waves shorter than this, or than this share of the range, are too fine for the triangles of the ground."""
GRAIN_M = 0.045  #: Longest wave of the reflectance that counts as grain, m.
OCTAVES = 9  #: Octaves of the fine relief and reflectance.
LONGEST_M = 3.1  #: Longest wave of these octaves, m.
_FINE, _PLATE = np.uint32(Stream.FINE_TEXTURE), np.uint32(Stream.PLATES)


class GroundHits(NamedTuple):
    """Ray hits of the ground that are shaded together; each array is `(N,)` float64 if not said otherwise."""

    ray: IntArray  #: int64, index of the ray.
    x: FloatArray  #: Metres, DS.
    y: FloatArray  #: Metres, DS.
    range: FloatArray  #: Metres.
    footprint: FloatArray  #: Size of a pixel on the ground, metres.


class GroundTexture(NamedTuple):
    """Materials and fine structure of positions; each array is `(N,)` float64."""

    sand: FloatArray  #: Share of sand.
    gravel: FloatArray  #: Share of gravel.
    rock: FloatArray  #: Share of bare rock.
    tone: FloatArray  #: Logarithm of the reflectance over the mean.
    slope_x: FloatArray  #: Slope of the fine structure to the east.
    slope_y: FloatArray  #: Slope of the fine structure to the north.
    grain: FloatArray  #: Coarseness.


@jit_inline
def fade_of(length: float, footprint: float) -> float:
    """Return the contrast at which a pixel resolves a wave: 0 below 1.4 footprints, 1 above 3.4."""
    return min(max((length / footprint - 1.4) * 0.5, 0.0), 1.0)


@jit
def ground_texture(count: int, hits: GroundHits, bump: float, terrain: TerrainParameters, out: GroundTexture) -> None:
    """Write materials, tone and slopes of the fine structure: octaves from 3 m down to the footprint.

    Waves too short for the triangles of the ground show as slopes; those shorter than `GRAIN_M` are grains. The slopes
    are the gradient of the tone rotated by a right angle: if they followed the tone, each bright spot would have a side
    that faces the left camera, and as dusty ground looks brighter at grazing views, the two cameras would see the
    texture shifted against each other by some 0.02 px.
    """
    x, y, ranges, footprints = hits.x, hits.y, hits.range, hits.footprint
    tone, sx, sy, grain = out.tone, out.slope_x, out.slope_y, out.grain
    for n in range(count):
        out.sand[n], out.gravel[n], out.rock[n] = materials(x[n], y[n], terrain)
    finest, seed = np.inf, terrain.seed
    for n in range(count):
        tone[n], sx[n], sy[n] = 0.0, 0.0, 0.0
        grain[n] = 0.5 * out.sand[n] + out.gravel[n] + 0.65 * out.rock[n]
        finest = min(finest, footprints[n])
    length, c, s = LONGEST_M, 1.0, 0.0
    for k in range(OCTAVES):
        if fade_of(length, finest) <= 0.0:
            break
        key = seed ^ _FINE ^ np.uint32(k)
        cc, ss, shift = c / length, s / length, 0.37 * k
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
        length *= 0.46


@jit
def plates(x: float, y: float, footprint: float, seed: np.uint32) -> tuple[float, float, float]:
    """Return the darkness 0 to 1 of cracks between plates of bare rock, and slopes: a warped Voronoi pattern.

    Plates are about 0.42 m wide, cracks 9 mm, and plates are tilted by up to 0.08; noise makes the edges jagged. The
    sizes were chosen by eye beside images of bedrock.
    """
    cell = 0.42
    wx = x / cell + 0.35 * value2(x * 2.1, y * 2.1, seed ^ _PLATE)[0]
    wy = y / cell + 0.35 * value2(x * 2.1 + 7.0, y * 2.1, seed ^ _PLATE)[0]
    jag, shift, _ = value2(x * 17.0 + 3.0 * y, y * 17.0 - 3.0 * x, seed ^ _PLATE)
    wx, wy = wx + 0.045 * jag, wy + 0.02 * shift
    i0, j0 = math.floor(wx), math.floor(wy)
    first, second, best = 9.0, 9.0, np.uint32(0)
    for i in range(i0 - 1, i0 + 2):
        for j in range(j0 - 1, j0 + 2):
            h = hash2(i, j, seed ^ _PLATE)
            dx, dy = i + unit(h) - wx, j + unit(mix(h)) - wy
            d = dx * dx + dy * dy
            if d < first:
                second, first, best = first, d, h
            elif d < second:
                second = d
    edge = (math.sqrt(second) - math.sqrt(first)) * cell
    width = 0.009 * (1.0 + 0.8 * jag)
    crack = (1.0 - smooth_step(0.3 * width, width + footprint, edge)) * min(1.0, width / footprint)
    tilt = mix(best ^ np.uint32(5))
    return crack, 0.16 * (unit(tilt) - 0.5), 0.16 * (unit(mix(tilt)) - 0.5)


class ShadingParameters(NamedTuple):
    """Appearance of ground and rocks, sun, sky and air; a field has the name of the setting that it is."""

    albedo: float  #: Mean reflectance of the ground.
    contrast: float  #: Strength of the changes of reflectance.
    bump: float  #: Strength of the fine relief.
    lunar: float  #: Share of Lommel-Seeliger against Lambert reflection.
    sky: float  #: Light of the sky on level ground, the overhead sun being 1.
    sky_grey: float  #: Brightness of the sky above the horizon.
    haze_m: float  #: Distance at which haze has taken 63 % of the contrast.
    rock_albedo: float  #: Mean reflectance of rocks.
    sun_x: float  #: Unit vector towards the sun, DS.
    sun_y: float  #: Unit vector towards the sun, DS.
    sun_z: float  #: Unit vector towards the sun, DS.
    gain: float  #: Factor that gives level mean ground in the sun a brightness of 1.
    target: float  #: Brightness of level mean ground in the image, as a share of the full range.
    field: PebbleField  #: The pebbles.
    terrain: TerrainParameters  #: The ground.


def shading_parameters(config: SimulationConfig, sun: FloatArray, terrain: Terrain) -> ShadingParameters:
    """Return the parameters of the shading, for a unit vector `(3,)` towards the sun."""
    ground, sky = config.ground, config.light
    return ShadingParameters(
        **settings_in(ground, ShadingParameters._fields),
        **settings_in(sky, ShadingParameters._fields),
        **dict(zip(("sun_x", "sun_y", "sun_z"), map(float, sun), strict=True)),
        rock_albedo=float(config.rocks.albedo),
        gain=float(1.0 / (ground.albedo * (reflect(sun[2], 0.5, ground.lunar) * sun[2] + sky.sky))),
        target=float(config.sensor.target_grey),
        field=PebbleField.of(float(ground.pebbles), float(ground.bump), terrain.parameters.seed, sun),
        terrain=terrain.parameters,
    )


@jit_inline
def reflect(mu0: float, mu: float, lunar: float) -> float:
    """Lunar-Lambert reflection over the cosine of incidence: `2 L / (mu0 + mu) + 1 - L` (McEwen 1991)."""
    return 2.0 * lunar / (mu0 + mu + 1e-6) + 1.0 - lunar


RUN = 1024  #: Rays shaded at once: their numbers stay in the processor's first cache.
_STONE = np.uint32(Stream.ROCK_SURFACE)


Vector = tuple[float, float, float]  #: A vector in DS.


@jit
def shade(
    hits: Hits,
    rays: FloatArray,
    lit: NDArray[np.float32],
    pixel_rad: float,
    parameters: ShadingParameters,
    out: NDArray[np.float32],
) -> None:
    """Write the brightness of ray hits, as a share of the full range."""
    ground = GroundHits(np.empty(RUN, np.int64), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN))
    texture = GroundTexture(
        np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN)
    )
    cache, target = pebble_cache(), parameters.target
    for start in range(0, len(hits.objects), RUN):
        end = min(start + RUN, len(hits.objects))
        count = 0
        for n in range(start, end):
            if hits.objects[n] == GROUND:
                ground.ray[count], ground.range[count] = n, hits.ranges[n]
                ground.x[count], ground.y[count] = hits.points[n, 0], hits.points[n, 1]
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
                out[n] = parameters.sky_grey * (1.0 - 0.25 * up + 0.06 * math.exp(-12.0 * up))
            elif hits.objects[n] != GROUND:
                normal = hits.normals[n]
                footprint = _footprint(normal, rays[n], hits.ranges[n] * pixel_rad)
                albedo, bump = _stone(hits.points[n], footprint, hits.objects[n], parameters)
                slanted = _bumped(normal, bump)
                mu = _emission_cosine(normal, rays[n])
                out[n] = surface_brightness(slanted, mu, hits.ranges[n], target * albedo, 1.0, lit[n], parameters)


@jit_inline
def _bumped(normal: FloatArray, gradient: Vector) -> Vector:
    """Return the normal tilted by the part of a bump gradient that lies in the surface."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    gx, gy, gz = gradient
    along = gx * nx + gy * ny + gz * nz
    return nx - (gx - along * nx), ny - (gy - along * ny), nz - (gz - along * nz)


@jit_inline
def _emission_cosine(normal: FloatArray, ray: FloatArray) -> float:
    """Return the cosine of emission of the solid's surface.

    That of the fine relief would change how the relief looks from different positions, without the parallax and the
    occlusion that belong to it: every texture would seem to move, by 0.01 px between the left and the right image.
    """
    return float(max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), 0.05))


@jit_inline
def _footprint(normal: FloatArray, ray: FloatArray, small: float) -> float:
    """Return the size of a pixel on a surface, between that across and that along the line of sight.

    The size is proportional to cos^-3/8 of the emission angle: cos^0 gives the size across, cos^-1 along the line.
    """
    cosine = max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), 0.08)
    root4 = math.sqrt(math.sqrt(cosine))
    return float(small / (root4 * math.sqrt(root4)))  # 1/4 + 1/8; square roots are faster than a power


@jit_inline
def surface_brightness(
    normal: Vector, mu: float, distance: float, albedo: float, sunlit: float, lit: float, parameters: ShadingParameters
) -> float:
    """Return the brightness of a surface in the light of sun and sky, through the haze.

    A level surface sees the whole sky and a vertical one 55 % of it. Pebbles that block the sun block 40 % of the sky.
    Haze has 0.9 of the brightness of the sky.
    """
    nx, ny, nz = normal
    length = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx * length, ny * length, nz * length
    mu0 = max(nx * parameters.sun_x + ny * parameters.sun_y + nz * parameters.sun_z, 0.0)
    direct = reflect(mu0, mu, parameters.lunar) * mu0 * sunlit * lit
    open_sky = parameters.sky * (0.55 + 0.45 * nz) * (0.6 + 0.4 * sunlit)
    clear = math.exp(-distance / parameters.haze_m)
    return float(parameters.gain * albedo * (direct + open_sky) * clear + (1.0 - clear) * 0.9 * parameters.sky_grey)


@jit_inline
def _ground(
    hits: GroundHits,
    texture: GroundTexture,
    m: int,
    pixel_rad: float,
    parameters: ShadingParameters,
    cache: PebbleCache,
) -> tuple[float, float, float, float]:
    """Return reflectance, slopes of the fine relief, and the share of the sun that pebbles leave, of one hit.

    Sand and rock are brighter than gravel by 20 to 27 %. The reflectance is limited to 0.2 to 3.3 times its mean. The
    weights were chosen by eye.
    """
    x, y, small, footprint = hits.x[m], hits.y[m], hits.range[m] * pixel_rad, hits.footprint[m]
    sand, gravel, rock = texture.sand[m], texture.gravel[m], texture.rock[m]
    tone, sx, sy = texture.tone[m], texture.slope_x[m], texture.slope_y[m]
    tone = 0.85 * tone + 0.10 * sand + 0.14 * rock - 0.10 * gravel
    sunlit, bump, field = 1.0, parameters.bump, parameters.field
    if rock > 0.02:
        crack, cx, cy = plates(x, y, footprint, field.seed)
        tone -= 0.9 * rock * rock * rock * crack
        sx, sy = sx + rock * cx * bump, sy + rock * cy * bump
    fill = field.fill * (gravel + 0.05 * sand + 0.12 * rock)
    cover, grey, px, py, shadow = pebbles(x, y, small, fill, field, cache)
    if cover > 0.0 or shadow > 0.0:
        tone = (1.0 - cover) * tone + cover * grey
        sx, sy = (1.0 - cover) * sx + cover * px, (1.0 - cover) * sy + cover * py
        sunlit = 1.0 - (1.0 - cover) * shadow
    return parameters.albedo * math.exp(min(max(parameters.contrast * tone, -1.6), 1.2)), sx, sy, sunlit


@jit
def _stone(point: FloatArray, footprint: float, number: int, parameters: ShadingParameters) -> tuple[float, Vector]:
    """Return reflectance and bump gradient of a rock's surface: seven octaves from 0.24 m down to 4 mm.

    Amplitudes were chosen by eye; half of the rocks are dusty, which makes them brighter.
    """
    x, y, z, seed = point[0], point[1], point[2], parameters.terrain.seed
    h = mix(np.uint32(number) ^ seed ^ _STONE)
    tone = 0.5 * (unit(h) - 0.5)
    gx, gy, gz = 0.0, 0.0, 0.0
    length = 0.24
    for k in range(7):
        fade = fade_of(length, footprint)
        if fade <= 0.0:
            break
        v, a, b, c = value3(x / length + 0.41 * k, y / length + 0.17 * k, z / length, seed ^ _STONE ^ np.uint32(k))
        tone += 0.16 * fade * v
        slope = 0.13 * fade * parameters.bump
        gx, gy, gz = gx + slope * b, gy + slope * c, gz + slope * a  # not the tone's own gradient, as for the ground
        length *= 0.5
    dust = smooth_step(0.75, 1.0, 0.5 + 0.5 * unit(mix(h)))
    reflectance = parameters.rock_albedo * math.exp(min(max(parameters.contrast * (tone + 0.2 * dust), -1.5), 1.2))
    return reflectance, (gx, gy, gz)

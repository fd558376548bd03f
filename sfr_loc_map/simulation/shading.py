"""Shading: reflectance, fine relief and light, evaluated where a ray hits.

Everything is a function of position in DS, and every octave fades out before it is finer than a pixel's footprint, so
near ground is sharp and far ground does not flicker.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.appearance import Light, ShadingParameters, Surface, reflect
from sfr_loc_map.simulation.ground import GroundHits, GroundTexture, fade_of, ground_texture, plates
from sfr_loc_map.simulation.noise import mix, unit, value3
from sfr_loc_map.simulation.pebbles import PebbleCache, PebbleField, pebble_cache, pebbles
from sfr_loc_map.simulation.rays import GROUND, SKY, Hits
from sfr_loc_map.simulation.terrain import smooth_step

RUN = 1024
"""Rays shaded at once: their numbers stay in the processor's first cache."""
_STONE = np.uint32(103)


class Vector(NamedTuple):
    """A vector in DS."""

    x: float
    y: float
    z: float


@jit
def shade(
    hits: Hits,
    rays: FloatArray,
    lit: NDArray[np.float32],
    pixel_rad: float,
    parameters: ShadingParameters,
    out: NDArray[np.float32],
) -> None:
    """Write the brightness of ray hits, as a share of the full range.

    Args:
        hits: What the rays hit.
        rays: `(N, 3)` unit, DS.
        lit: `(N,)` visible share of the sun's disc.
        pixel_rad: Angle of one pixel.
        parameters: Appearance and light.
        out: `(N,)`.
    """
    ground = GroundHits(np.empty(RUN, np.int64), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN))
    texture = GroundTexture(
        np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN), np.empty(RUN)
    )
    surface, light, seed = parameters.surface, parameters.light, parameters.seed
    field, cache = PebbleField(surface.pebbles, surface.bump, light.shadow, seed), pebble_cache()
    for start in range(0, len(hits.objects), RUN):
        end = min(start + RUN, len(hits.objects))
        count = _gather_ground(hits, rays, pixel_rad, start, end, ground)
        ground_texture(count, ground, surface.bump, parameters.shares, seed, texture)
        for m in range(count):
            n = ground.ray[m]
            albedo, sx, sy, sunlit = _ground(ground, texture, m, pixel_rad, surface, field, cache)
            normal = hits.normals[n]
            slanted = Vector(normal[0] - sx * normal[2], normal[1] - sy * normal[2], normal[2])
            mu = _emission_cosine(normal, rays[n])
            out[n] = _brightness(slanted, mu, hits.ranges[n], light.target * albedo, sunlit, lit[n], parameters)
        for n in range(start, end):
            if hits.objects[n] == SKY:
                out[n] = _sky(rays[n, 2], light)
            elif hits.objects[n] != GROUND:
                normal = hits.normals[n]
                footprint = _footprint(normal, rays[n], hits.ranges[n] * pixel_rad)
                albedo, bump = _stone(hits.points[n], footprint, hits.objects[n], surface, seed)
                slanted = _bumped(normal, bump)
                mu = _emission_cosine(normal, rays[n])
                out[n] = _brightness(slanted, mu, hits.ranges[n], light.target * albedo, 1.0, lit[n], parameters)


@jit
def _gather_ground(hits: Hits, rays: FloatArray, pixel_rad: float, start: int, end: int, out: GroundHits) -> int:
    """Collect the hits of the ground; return their number."""
    count = 0
    for n in range(start, end):
        if hits.objects[n] == GROUND:
            out.ray[count] = n
            out.x[count], out.y[count], out.range[count] = hits.points[n, 0], hits.points[n, 1], hits.ranges[n]
            out.footprint[count] = _footprint(hits.normals[n], rays[n], hits.ranges[n] * pixel_rad)
            count += 1
    return count


@jit_inline
def _bumped(normal: FloatArray, gradient: Vector) -> Vector:
    """Return the normal tilted by the part of a bump gradient that lies in the surface."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    along = gradient.x * nx + gradient.y * ny + gradient.z * nz
    return Vector(nx - (gradient.x - along * nx), ny - (gradient.y - along * ny), nz - (gradient.z - along * nz))


@jit_inline
def _emission_cosine(normal: FloatArray, ray: FloatArray) -> float:
    """Return the cosine of emission of the solid's surface.

    That of the fine relief would change how the relief looks from different positions, without the parallax and the
    occlusion that belong to it: every texture would seem to move, by 0.01 px between the left and the right image.
    """
    return float(max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), 0.05))


@jit_inline
def _footprint(normal: FloatArray, ray: FloatArray, small: float) -> float:
    """Return the size of a pixel on a surface, between that across and that along the line of sight."""
    cosine = max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), 0.08)
    root = math.sqrt(math.sqrt(cosine))
    return float(small / (root * math.sqrt(root)))


@jit_inline
def _brightness(
    normal: Vector,
    mu: float,
    distance: float,
    albedo: float,
    sunlit: float,
    lit: float,
    parameters: ShadingParameters,
) -> float:
    """Return the brightness of a surface in the light of sun and sky, through the haze.

    Args:
        normal: Of any length.
        mu: Cosine of emission.
        distance: Metres.
        albedo: Reflectance, times the brightness wanted of level mean ground.
        sunlit: Share of the sun that pebbles leave.
        lit: Share of the sun that solids leave.
        parameters: Reflection and light.
    """
    light = parameters.light
    length = 1.0 / math.sqrt(normal.x * normal.x + normal.y * normal.y + normal.z * normal.z)
    nx, ny, nz = normal.x * length, normal.y * length, normal.z * length
    mu0 = max(nx * light.sun_x + ny * light.sun_y + nz * light.sun_z, 0.0)
    direct = reflect(mu0, mu, parameters.surface.lunar) * mu0 * sunlit * lit
    open_sky = light.sky * (0.55 + 0.45 * nz) * (0.6 + 0.4 * sunlit)
    clear = math.exp(-distance / light.haze_m)
    return float(light.gain * albedo * (direct + open_sky) * clear + (1.0 - clear) * 0.9 * light.sky_grey)


@jit
def _sky(rise: float, light: Light) -> float:
    up = max(rise, 0.0)
    return float(light.sky_grey * (1.0 - 0.25 * up + 0.06 * math.exp(-12.0 * up)))


@jit_inline
def _ground(
    hits: GroundHits,
    texture: GroundTexture,
    m: int,
    pixel_rad: float,
    surface: Surface,
    field: PebbleField,
    cache: PebbleCache,
) -> tuple[float, float, float, float]:
    """Return reflectance, slopes of the fine relief, and the share of the sun that pebbles leave, of one hit."""
    x, y, small, footprint = hits.x[m], hits.y[m], hits.range[m] * pixel_rad, hits.footprint[m]
    sand, gravel, rock = texture.sand[m], texture.gravel[m], texture.rock[m]
    tone, sx, sy = texture.tone[m], texture.slope_x[m], texture.slope_y[m]
    tone = 0.85 * tone + 0.10 * sand + 0.14 * rock - 0.10 * gravel
    sunlit = 1.0
    if rock > 0.02:
        crack, cx, cy = plates(x, y, footprint, field.seed)
        tone -= 0.9 * rock * rock * rock * crack
        sx, sy = sx + rock * cx * surface.bump, sy + rock * cy * surface.bump
    fill = surface.pebbles * (gravel + 0.05 * sand + 0.12 * rock)
    cover, grey, px, py, shadow = pebbles(x, y, small, fill, field, cache)
    if cover > 0.0 or shadow > 0.0:
        tone = (1.0 - cover) * tone + cover * grey
        sx, sy = (1.0 - cover) * sx + cover * px, (1.0 - cover) * sy + cover * py
        sunlit = 1.0 - (1.0 - cover) * shadow
    return surface.albedo * math.exp(min(max(surface.contrast * tone, -1.6), 1.2)), sx, sy, sunlit


@jit
def _stone(point: FloatArray, footprint: float, number: int, surface: Surface, seed: np.uint32) -> tuple[float, Vector]:
    """Return reflectance and bump gradient of a rock's surface."""
    x, y, z = point[0], point[1], point[2]
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
        slope = 0.13 * fade * surface.bump
        gx, gy, gz = gx + slope * b, gy + slope * c, gz + slope * a  # not the tone's own gradient, as for the ground
        length *= 0.5
    dust = smooth_step(0.75, 1.0, 0.5 + 0.5 * unit(mix(h)))
    reflectance = surface.rock_albedo * math.exp(min(max(surface.contrast * (tone + 0.2 * dust), -1.5), 1.2))
    return reflectance, Vector(gx, gy, gz)

"""How a place of the world looks: reflectance, fine relief and light, evaluated where a ray hits.

Everything is a function of place in DS, and every octave fades out before it is finer than a pixel's footprint, so
near ground is sharp and far ground does not flicker.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.config import GroundConfig, LightConfig, RockConfig
from sfr_loc_map.simulation.ground import fade_of, ground_texture, plates
from sfr_loc_map.simulation.noise import mix, unit, value3
from sfr_loc_map.simulation.pebbles import pebble_memory, pebbles, throw_values
from sfr_loc_map.simulation.terrain import smooth_step

SKY, GROUND = -2, -1
"""What a ray hit, if not the rock of that number."""
RUN = 1024
"""Rays shaded at once: their numbers stay in the processor's first cache."""
_STONE = np.uint32(103)


def look_values(ground: GroundConfig, rocks: RockConfig, light: LightConfig, sun: FloatArray) -> FloatArray:
    """Return the numbers that the compiled shading takes.

    Args:
        ground: Settings.
        rocks: Settings.
        light: Settings.
        sun: `(3,)` unit vector towards the sun, DS.
    """
    level = _reflect(sun[2], 0.5, ground.lunar) * sun[2] + light.sky
    return np.array(
        [
            ground.albedo,
            ground.contrast,
            ground.bump,
            ground.pebbles,
            ground.lunar,
            rocks.albedo,
            light.sky,
            light.haze_m,
            light.sky_grey,
            1.0 / (ground.albedo * level),
            *sun,
            *throw_values(sun),
        ]
    )


@jit
def shade(
    points: FloatArray,
    normals: FloatArray,
    objects: NDArray[np.int32],
    lit: NDArray[np.float32],
    rays: FloatArray,
    ranges: FloatArray,
    pixel_rad: float,
    look: FloatArray,
    shares: FloatArray,
    seed: np.uint32,
    target: float,
    out: NDArray[np.float32],
) -> None:
    """Write the brightness of ray hits, as a share of the full range.

    Args:
        points: `(N, 3)` metres, DS.
        normals: `(N, 3)` unit, DS.
        objects: `(N,)` -2 for the sky, -1 for the ground, else the number of a rock.
        lit: `(N,)` share of the sun's disc that is seen.
        rays: `(N, 3)` unit, DS.
        ranges: `(N,)` metres.
        pixel_rad: Angle of one pixel.
        look: From `look_values`.
        shares: Shares of gravel and bedrock.
        seed: Of the ground.
        target: Brightness of level mean ground.
        out: `(N,)`.
    """
    which, place, made = np.empty(RUN, np.int64), np.empty((4, RUN)), np.empty((7, RUN))
    throws, memory = look[13:16], pebble_memory()
    for start in range(0, len(objects), RUN):
        end = min(start + RUN, len(objects))
        count = _gather_ground(points, normals, objects, rays, ranges, pixel_rad, start, end, which, place)
        ground_texture(count, place, look[2], shares, seed, made)
        for m in range(count):
            n = which[m]
            albedo, sx, sy, seen = _ground(place[:, m], made[:, m], pixel_rad, look, throws, seed, memory)
            nx, ny, nz = normals[n, 0], normals[n, 1], normals[n, 2]
            nx, ny = nx - sx * nz, ny - sy * nz
            mu = _facing(normals[n], rays[n])
            out[n] = _lit_surface(nx, ny, nz, mu, ranges[n], target * albedo, seen, lit[n], look)
        for n in range(start, end):
            if objects[n] == SKY:
                out[n] = _sky(rays[n, 2], look)
            elif objects[n] != GROUND:
                nx, ny, nz = normals[n, 0], normals[n, 1], normals[n, 2]
                footprint = _footprint(normals[n], rays[n], ranges[n] * pixel_rad)
                albedo, gx, gy, gz = _stone(points[n], footprint, objects[n], look, seed)
                along = gx * nx + gy * ny + gz * nz
                nx, ny, nz = nx - (gx - along * nx), ny - (gy - along * ny), nz - (gz - along * nz)
                mu = _facing(normals[n], rays[n])
                out[n] = _lit_surface(nx, ny, nz, mu, ranges[n], target * albedo, 1.0, lit[n], look)


@jit
def _gather_ground(
    points: FloatArray,
    normals: FloatArray,
    objects: NDArray[np.int32],
    rays: FloatArray,
    ranges: FloatArray,
    pixel_rad: float,
    start: int,
    end: int,
    which: NDArray[np.int64],
    place: FloatArray,
) -> int:
    """Collect the hits of the ground: number; x, y, range, size of a pixel there."""
    count = 0
    for n in range(start, end):
        if objects[n] == GROUND:
            which[count] = n
            place[0, count], place[1, count], place[2, count] = points[n, 0], points[n, 1], ranges[n]
            place[3, count] = _footprint(normals[n], rays[n], ranges[n] * pixel_rad)
            count += 1
    return count


@jit_inline
def _facing(normal: FloatArray, ray: FloatArray) -> float:
    """Return the cosine of emission of the solid's surface.

    That of the fine relief would change how the relief looks from place to place, without the parallax and the hiding
    that go with it: every texture would seem to move, by 0.01 px between the left and the right picture.
    """
    return float(max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), 0.05))


@jit_inline
def _footprint(normal: FloatArray, ray: FloatArray, small: float) -> float:
    """Return the size of a pixel on a surface, between that across and that along the line of sight."""
    cosine = max(-(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2]), 0.08)
    root = math.sqrt(math.sqrt(cosine))
    return float(small / (root * math.sqrt(root)))


@jit_inline
def _lit_surface(
    nx: float,
    ny: float,
    nz: float,
    mu: float,
    distance: float,
    albedo: float,
    seen: float,
    lit: float,
    look: FloatArray,
) -> float:
    """Return the brightness of a surface in the light of sun and sky, through the haze.

    The normal need not have unit length; `mu` is the cosine of emission, `seen` the share of the sun that pebbles
    leave, `lit` that of solids.
    """
    length = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx * length, ny * length, nz * length
    mu0 = max(nx * look[10] + ny * look[11] + nz * look[12], 0.0)
    direct = _reflect(mu0, mu, look[4]) * mu0 * seen * lit
    open_sky = look[6] * (0.55 + 0.45 * nz) * (0.6 + 0.4 * seen)
    clear = math.exp(-distance / look[7])
    return float(look[9] * albedo * (direct + open_sky) * clear + (1.0 - clear) * 0.9 * look[8])


@jit_inline
def _reflect(mu0: float, mu: float, lunar: float) -> float:
    """Lunar-Lambert reflection over the cosine of incidence: `2 L / (mu0 + mu) + 1 - L` (McEwen 1991)."""
    return 2.0 * lunar / (mu0 + mu + 1e-6) + 1.0 - lunar


@jit
def _sky(rise: float, look: FloatArray) -> float:
    up = max(rise, 0.0)
    return float(look[8] * (1.0 - 0.25 * up + 0.06 * math.exp(-12.0 * up)))


@jit_inline
def _ground(
    place: FloatArray,
    made: FloatArray,
    pixel_rad: float,
    look: FloatArray,
    throws: FloatArray,
    seed: np.uint32,
    memory: FloatArray,
) -> tuple[float, float, float, float]:
    """Return reflectance, slopes of the fine relief, and the share of the sun that pebbles leave."""
    x, y, small, footprint = place[0], place[1], place[2] * pixel_rad, place[3]
    sand, gravel, rock, tone, sx, sy = made[0], made[1], made[2], made[3], made[4], made[5]
    tone = 0.85 * tone + 0.10 * sand + 0.14 * rock - 0.10 * gravel
    seen = 1.0
    if rock > 0.02:
        crack, cx, cy = plates(x, y, footprint, seed)
        tone -= 0.9 * rock * rock * rock * crack
        sx, sy = sx + rock * cx * look[2], sy + rock * cy * look[2]
    full = look[3] * (gravel + 0.05 * sand + 0.12 * rock)
    cover, grey, px, py, shadow = pebbles(x, y, small, full, look[3], look[2], throws, seed, memory)
    if cover > 0.0 or shadow > 0.0:
        tone = (1.0 - cover) * tone + cover * grey
        sx, sy = (1.0 - cover) * sx + cover * px, (1.0 - cover) * sy + cover * py
        seen = 1.0 - (1.0 - cover) * shadow
    return look[0] * math.exp(min(max(look[1] * tone, -1.6), 1.2)), sx, sy, seen


@jit
def _stone(
    point: FloatArray, footprint: float, number: int, look: FloatArray, seed: np.uint32
) -> tuple[float, float, float, float]:
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
        slope = 0.13 * fade * look[2]
        gx, gy, gz = gx + slope * b, gy + slope * c, gz + slope * a  # not the tone's own gradient, as for the ground
        length *= 0.5
    dust = smooth_step(0.75, 1.0, 0.5 + 0.5 * unit(mix(h)))
    return look[5] * math.exp(min(max(look[1] * (tone + 0.2 * dust), -1.5), 1.2)), gx, gy, gz

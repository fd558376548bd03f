"""How a place of the world looks: reflectance, fine relief and light, evaluated where a ray hits.

Everything is a function of place in DS, and every octave fades out before it is finer than a pixel's footprint, so
near ground is sharp and far ground does not flicker.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.simulation.config import GroundConfig, LightConfig, RockConfig
from sfr_loc_map.simulation.noise import hash2, jit, mix, unit, value2, value3
from sfr_loc_map.simulation.pebbles import pebbles
from sfr_loc_map.simulation.terrain import FloatArray, materials, smooth_step

FloatImage = NDArray[np.float32]
UNMADE_M = 0.12
UNMADE_PER_RANGE = 0.03
"""Waves shorter than this, or than this share of the range, are too fine for the triangles of the ground."""
GRAIN_M = 0.045
_FINE, _STONE, _PLATE = (np.uint32(k) for k in (102, 103, 104))


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
    for n in range(len(objects)):
        if objects[n] == -2:
            out[n] = _sky(rays[n, 2], look)
            continue
        nx, ny, nz = normals[n, 0], normals[n, 1], normals[n, 2]
        cosine = max(-(nx * rays[n, 0] + ny * rays[n, 1] + nz * rays[n, 2]), 0.08)
        small = ranges[n] * pixel_rad
        footprint = small / cosine**0.35
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if objects[n] == -1:
            albedo, sx, sy, seen = _ground(x, y, ranges[n], footprint, small, look, shares, seed)
            nx, ny, nz = nx - sx * nz, ny - sy * nz, nz
        else:
            albedo, gx, gy, gz = _stone(x, y, z, footprint, objects[n], look, seed)
            along = gx * nx + gy * ny + gz * nz
            nx, ny, nz = nx - (gx - along * nx), ny - (gy - along * ny), nz - (gz - along * nz)
            seen = 1.0
        length = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * length, ny * length, nz * length
        mu0 = max(nx * look[10] + ny * look[11] + nz * look[12], 0.0)
        mu = max(-(nx * rays[n, 0] + ny * rays[n, 1] + nz * rays[n, 2]), 0.05)
        direct = _reflect(mu0, mu, look[4]) * mu0 * seen * lit[n]
        open_sky = look[6] * (0.55 + 0.45 * nz) * (0.6 + 0.4 * seen)
        bright = target * look[9] * albedo * (direct + open_sky)
        clear = math.exp(-ranges[n] / look[7])
        out[n] = bright * clear + (1.0 - clear) * 0.9 * look[8]


@jit
def _reflect(mu0: float, mu: float, lunar: float) -> float:
    """Lunar-Lambert reflection over the cosine of incidence: `2 L / (mu0 + mu) + 1 - L` (McEwen 1991)."""
    return 2.0 * lunar / (mu0 + mu + 1e-6) + 1.0 - lunar


@jit
def _sky(rise: float, look: FloatArray) -> float:
    up = max(rise, 0.0)
    return float(look[8] * (1.0 - 0.25 * up + 0.06 * math.exp(-12.0 * up)))


@jit
def _fade(length: float, footprint: float) -> float:
    """Return how much of a wave a pixel shows: none under 1.4 footprints, all over 3.4."""
    return min(max((length / footprint - 1.4) * 0.5, 0.0), 1.0)


@jit
def _ground(
    x: float,
    y: float,
    distance: float,
    footprint: float,
    small: float,
    look: FloatArray,
    shares: FloatArray,
    seed: np.uint32,
) -> tuple[float, float, float, float]:
    """Return reflectance, slopes of the fine relief, and the share of the sun that pebbles leave."""
    sand, gravel, rock = materials(x, y, shares, seed)
    unmade, rough = max(UNMADE_M, UNMADE_PER_RANGE * distance), 0.5 * sand + gravel + 1.3 * rock
    tone, sx, sy = _fine(x, y, footprint, unmade, rough, look[2], seed)
    tone = 0.85 * tone + 0.10 * sand + 0.22 * rock - 0.10 * gravel
    seen = 1.0
    if rock > 0.02:
        crack, cx, cy = _plates(x, y, footprint, seed)
        tone -= 0.9 * rock * rock * rock * crack
        sx, sy = sx + rock * cx * look[2], sy + rock * cy * look[2]
    full = look[3] * (gravel + 0.05 * sand + 0.12 * rock)
    cover, grey, px, py, shadow = pebbles(x, y, small, full, look[2], look[10:13], seed)
    if cover > 0.0 or shadow > 0.0:
        tone = (1.0 - cover) * tone + cover * grey
        sx, sy = (1.0 - cover) * sx + cover * px, (1.0 - cover) * sy + cover * py
        seen = 1.0 - (1.0 - cover) * shadow
    return look[0] * math.exp(min(max(look[1] * tone, -1.6), 1.2)), sx, sy, seen


@jit
def _fine(
    x: float, y: float, footprint: float, unmade: float, rough: float, bump: float, seed: np.uint32
) -> tuple[float, float, float]:
    """Return tone and slopes of the fine structure: octaves of 3 m down to the footprint.

    Waves shorter than `unmade` are not in the triangles and show as slopes; those shorter than `GRAIN_M` are grains.
    The slopes are the gradient of the tone turned by a right angle: if they went with the tone, each bright spot would
    have a side that faces the left camera, and as dusty ground looks brighter where it is seen aslant, the two cameras
    would see the texture shifted against each other by some 0.02 px.
    """
    tone, sx, sy = 0.0, 0.0, 0.0
    length, c, s = 3.1, 1.0, 0.0
    for k in range(9):
        fade = _fade(length, footprint)
        if fade <= 0.0:
            break
        v, gx, gy = value2((c * x + s * y) / length + 0.37 * k, (c * y - s * x) / length, seed ^ _FINE ^ np.uint32(k))
        if length < unmade:
            slope = fade * bump * (0.03 + 0.11 * rough if length < UNMADE_M else 0.07)
            sx -= slope * (s * gx + c * gy)
            sy += slope * (c * gx - s * gy)
        tone += fade * v * (0.11 if length > GRAIN_M else 0.17 + 0.26 * rough)
        c, s = 0.8 * c - 0.6 * s, 0.6 * c + 0.8 * s
        length *= 0.46
    return tone, sx, sy


@jit
def _plates(x: float, y: float, footprint: float, seed: np.uint32) -> tuple[float, float, float]:
    """Return darkness of the cracks between plates of bare rock and the tilt of the plate: a warped Voronoi pattern."""
    cell = 0.42
    wx = x / cell + 0.35 * value2(x * 2.1, y * 2.1, seed ^ _PLATE)[0]
    wy = y / cell + 0.35 * value2(x * 2.1 + 7.0, y * 2.1, seed ^ _PLATE)[0]
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
    width = 0.012
    crack = (1.0 - smooth_step(0.3 * width, width + footprint, edge)) * min(1.0, width / footprint)
    tilt = mix(best ^ np.uint32(5))
    return crack, 0.16 * (unit(tilt) - 0.5), 0.16 * (unit(mix(tilt)) - 0.5)


@jit
def _stone(
    x: float, y: float, z: float, footprint: float, number: int, look: FloatArray, seed: np.uint32
) -> tuple[float, float, float, float]:
    """Return reflectance and bump gradient of a rock's surface."""
    h = mix(np.uint32(number) ^ seed ^ _STONE)
    tone = 0.5 * (unit(h) - 0.5)
    gx, gy, gz = 0.0, 0.0, 0.0
    length = 0.24
    for k in range(7):
        fade = _fade(length, footprint)
        if fade <= 0.0:
            break
        v, a, b, c = value3(x / length + 0.41 * k, y / length + 0.17 * k, z / length, seed ^ _STONE ^ np.uint32(k))
        tone += 0.16 * fade * v
        slope = 0.13 * fade * look[2]
        gx, gy, gz = gx + slope * b, gy + slope * c, gz + slope * a  # not the tone's own gradient, as in _fine
        length *= 0.5
    dust = smooth_step(0.75, 1.0, 0.5 + 0.5 * unit(mix(h)))
    return look[5] * math.exp(min(max(look[1] * (tone + 0.2 * dust), -1.5), 1.2)), gx, gy, gz

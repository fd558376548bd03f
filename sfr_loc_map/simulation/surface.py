"""The surfaces of the ground and of the rocks: their reflectance, and the slopes of their fine relief.

The fine relief is too small to be meshed and appears only in the shading (`shading`). Lengths are in metres, positions
in DS. A footprint is the size of a pixel on the surface. Arrays are `(N,)`. Loops that should be vectorised have no
branches and only inlined calls. The page docs/simulation.md states the source of each number.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.noise import Stream, hash2, mix, unit, value2, value3
from sfr_loc_map.simulation.pebbles import PebbleCache, PebbleField, pebbles
from sfr_loc_map.simulation.terrain import TerrainParameters, materials, smooth_step

UNMESHED_M = 0.12
UNMESHED_PER_RANGE = 0.03
"""Wavelengths below this length, m, or below this fraction of the range are too short for the mesh of the ground."""
GRAIN_M = 0.045  #: Longest wavelength of the reflectance that counts as grain, m.
OCTAVES = 9  #: Number of octaves of the fine relief and reflectance.
LONGEST_M = 3.1  #: Longest wavelength of these octaves, m.
OCTAVE_RATIO = 0.46  #: Ratio of the wavelengths of successive octaves.
STONE_OCTAVES = 7  #: Number of octaves of the surface of a rock; each has half the wavelength of the previous octave.
LONGEST_STONE_M = 0.24  #: Longest wavelength of these octaves, m.
PLATE_M = 0.42  #: Width of the plates of bare rock, m.
CRACK_M = 0.009  #: Width of the cracks between plates, m.
PLATE_SLOPE = 0.16  #: Range of the slopes of the plates: up to 0.08 to either side.
Vector = tuple[float, float, float]  #: A vector in DS.
_FINE = np.uint32(Stream.FINE_TEXTURE)
_PLATE = np.uint32(Stream.PLATES)
_STONE = np.uint32(Stream.ROCK_SURFACE)


class SurfaceParameters(NamedTuple):
    """Appearance of ground and rocks without light."""

    albedo: float  #: Mean reflectance of the ground.
    contrast: float  #: Strength of the variation of reflectance.
    bump: float  #: Strength of the fine relief.
    rock_albedo: float  #: Mean reflectance of rocks.
    field: PebbleField  #: The pebbles.
    terrain: TerrainParameters  #: The ground.


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


@jit_inline
def ground_surface(
    hits: GroundHits,
    texture: GroundTexture,
    m: int,
    pixel_rad: float,
    parameters: SurfaceParameters,
    cache: PebbleCache,
) -> tuple[float, float, float, float]:
    """Return the reflectance, the two slopes of the fine relief, and the fraction of sunlight that pebbles let pass.

    The position is that of hit `m`. `pixel_rad` is the angle of a pixel. The detail of pebbles follows from
    the size of a pixel across the line of sight, not from its footprint on the ground.

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
def rock_surface(
    point: FloatArray, footprint: float, number: int, parameters: SurfaceParameters
) -> tuple[float, Vector]:
    """Return the reflectance of a rock and the gradient of its fine relief, with octaves from 0.24 m to 4 mm.

    `number` is the number of the rock, and `footprint` the size of a pixel on its surface, metres.

    Half of the rocks are dusty, and therefore brighter. The amplitudes were chosen by eye.
    """
    x = point[0]
    y = point[1]
    z = point[2]
    seed = parameters.terrain.seed
    h = mix(np.uint32(number) ^ seed ^ _STONE)
    tone = 0.5 * (unit(h) - 0.5)
    gx = 0.0
    gy = 0.0
    gz = 0.0
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

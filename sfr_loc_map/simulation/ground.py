"""Texture of the ground: its materials and fine structure, for many positions at once.

The loops over positions have no branches and no calls that are not inlined, so that they become vector code.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.noise import hash2, mix, unit, value2
from sfr_loc_map.simulation.terrain import MaterialShares, materials, smooth_step

UNMESHED_M = 0.12
UNMESHED_PER_RANGE = 0.03
"""Waves shorter than this, or than this share of the range, are too fine for the triangles of the ground."""
GRAIN_M = 0.045
OCTAVES = 9
LONGEST_M = 3.1
_FINE, _PLATE = np.uint32(102), np.uint32(104)


class GroundHits(NamedTuple):
    """Ray hits of the ground that are shaded together; each array is `(N,)` float64 if not said otherwise.

    Attributes:
        ray: int64, index of the ray.
        x: Metres, DS.
        y: Metres, DS.
        range: Metres.
        footprint: Size of a pixel on the ground, metres.
    """

    ray: IntArray
    x: FloatArray
    y: FloatArray
    range: FloatArray
    footprint: FloatArray


class GroundTexture(NamedTuple):
    """Materials and fine structure of positions; each array is `(N,)` float64.

    Attributes:
        sand: Share of sand.
        gravel: Share of gravel.
        rock: Share of bare rock.
        tone: Logarithm of the reflectance over the mean.
        slope_x: Slope of the fine structure to the east.
        slope_y: Slope of the fine structure to the north.
        grain: Coarseness.
    """

    sand: FloatArray
    gravel: FloatArray
    rock: FloatArray
    tone: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    grain: FloatArray


@jit_inline
def fade_of(length: float, footprint: float) -> float:
    """Return how much of a wave a pixel shows: none under 1.4 footprints, all over 3.4.

    Args:
        length: Wavelength, metres.
        footprint: Size of a pixel on the ground, metres.
    """
    return min(max((length / footprint - 1.4) * 0.5, 0.0), 1.0)


@jit
def ground_texture(
    count: int, hits: GroundHits, bump: float, shares: MaterialShares, seed: np.uint32, out: GroundTexture
) -> None:
    """Write materials, tone and slopes of the fine structure: octaves from 3 m down to the footprint.

    Waves too short for the triangles of the ground show as slopes; those shorter than `GRAIN_M` are grains. The slopes
    are the gradient of the tone rotated by a right angle: if they followed the tone, each bright spot would have a side
    that faces the left camera, and as dusty ground looks brighter at grazing views, the two cameras would see the
    texture shifted against each other by some 0.02 px.

    Args:
        count: Number of hits in use.
        hits: Where the ground was hit.
        bump: Strength of the fine relief.
        shares: Shares of materials.
        seed: Seed of the ground.
        out: Texture of the hits.
    """
    x, y, ranges, footprints = hits.x, hits.y, hits.range, hits.footprint
    tone, sx, sy, grain = out.tone, out.slope_x, out.slope_y, out.grain
    for n in range(count):
        out.sand[n], out.gravel[n], out.rock[n] = materials(x[n], y[n], shares, seed)
    finest = np.inf
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
    """Return the darkness of cracks between plates of bare rock and the tilt of the plate: a warped Voronoi pattern.

    Args:
        x: Metres, DS.
        y: Metres, DS.
        footprint: Size of a pixel on the ground, metres.
        seed: Seed of the ground.

    Returns:
        Darkness 0 to 1, slopes by x and y.
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

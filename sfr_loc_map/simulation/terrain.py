"""The ground as a function of place: height and material anywhere, from the seed alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.config import GroundConfig, TerrainConfig
from sfr_loc_map.simulation.noise import gradient2, hash2, mix, sub_seed, unit, value2

SHORTEST_M = 0.02
"""Shortest wave of the relief that is made as geometry; what is finer shows in shading only."""
CRATER_CLASSES = 4
"""Doublings of crater size, from 1 m across."""
OCTAVE_TURN = 0.6435
"""Angle between the grids of two octaves, radians (of a 3-4-5 triangle), so that no grid direction stands out."""
_HILL, _RELIEF, _RIPPLE, _CRATER, _SAND, _ROCK = (np.uint32(k) for k in (11, 22, 33, 44, 55, 66))


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """A seeded ground.

    Attributes:
        seed: 32 bits.
        values: `(12,)` float64, the numbers of `TerrainConfig` as the compiled code takes them.
        shares: `(2,)` float64, shares of gravel and of bedrock.
    """

    seed: np.uint32
    values: FloatArray
    shares: FloatArray

    @classmethod
    def make(cls, seed: int, terrain: TerrainConfig, ground: GroundConfig) -> Terrain:
        """Return the ground of a configuration."""
        azimuth = math.radians(terrain.ripple_azimuth_deg)
        values = (
            terrain.relief_m,
            terrain.relief_length_m,
            terrain.hurst,
            terrain.hills_m,
            terrain.hills_length_m,
            math.tan(math.radians(terrain.slope_deg)),
            terrain.ripple_height_m,
            2.0 * math.pi * math.cos(azimuth) / terrain.ripple_length_m,
            2.0 * math.pi * math.sin(azimuth) / terrain.ripple_length_m,
            terrain.crater_density,
            terrain.rim_radius_m,
            terrain.rim_x_m,
            terrain.rim_y_m,
        )
        return cls(sub_seed(seed, 1), np.array(values), np.array([ground.gravel, ground.bedrock]))

    def height(self, x: FloatArray, y: FloatArray, spacing: FloatArray) -> FloatArray:
        """Return heights in DS, metres.

        Args:
            x: `(N,)` metres, DS.
            y: `(N,)` metres, DS.
            spacing: `(N,)` metres between the samples there; shorter waves than it can carry are left out.
        """
        out = np.empty(len(x))
        _heights(x, y, spacing, self.values, self.shares, self.seed, out)
        return out


@jit_inline
def smooth_step(low: float, high: float, value: float) -> float:
    """Return 0 below `low`, 1 above `high` and a smooth cubic between."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@jit_inline
def materials(x: float, y: float, shares: FloatArray, seed: np.uint32) -> tuple[float, float, float]:
    """Return the shares of sand, gravel and bedrock at a place; they add up to 1."""
    a = value2(x * 0.23 + 0.11 * y, y * 0.23 - 0.11 * x, seed ^ _SAND)[0]
    b = value2(x * 0.9 - 0.3 * y, y * 0.9 + 0.3 * x, seed ^ _SAND ^ np.uint32(1))[0]
    c = value2(x * 3.7 + 1.3 * y, y * 3.7 - 1.3 * x, seed ^ _SAND ^ np.uint32(2))[0]
    cover = 0.5 + 0.42 * a + 0.30 * b + 0.16 * c
    d = value2(x * 0.31 - 0.2 * y, y * 0.31 + 0.2 * x, seed ^ _ROCK)[0]
    e = value2(x * 1.9 + 0.5 * y, y * 1.9 - 0.5 * x, seed ^ _ROCK ^ np.uint32(1))[0]
    bare = 0.5 + 0.5 * d + 0.18 * e + 0.06 * c
    rock = smooth_step(1.0 - shares[1] - 0.06, 1.0 - shares[1] + 0.06, bare) if shares[1] > 0.0 else 0.0
    gravel = smooth_step(1.0 - shares[0] - 0.15, 1.0 - shares[0] + 0.15, cover)
    return (1.0 - rock) * (1.0 - gravel), (1.0 - rock) * gravel, rock


@jit
def _heights(
    x: FloatArray,
    y: FloatArray,
    spacing: FloatArray,
    values: FloatArray,
    shares: FloatArray,
    seed: np.uint32,
    out: FloatArray,
) -> None:
    for i in range(len(x)):
        z = values[5] * x[i] + _hills(x[i], y[i], values, seed)
        z += _relief(x[i], y[i], spacing[i], values, seed)
        z += _craters(x[i], y[i], values[9], seed)
        if values[10] > 0.0:
            r = math.hypot(x[i] - values[11], y[i] - values[12]) / values[10]
            z += _crater_profile(r, 0.24 * values[10], 0.07 * values[10])
        if spacing[i] < 0.2 and values[6] > 0.0:
            z += _ripples(x[i], y[i], values, shares, seed)
        out[i] = z


@jit
def _hills(x: float, y: float, values: FloatArray, seed: np.uint32) -> float:
    total, scale, amplitude = 0.0, 1.0 / values[4], 2.6 * values[3]
    for k in range(3):
        total += amplitude * gradient2(x * scale + 0.37, y * scale + 0.71, seed ^ _HILL ^ np.uint32(k))[0]
        scale *= 2.1
        amplitude *= 0.42
    return total


@jit
def _relief(x: float, y: float, spacing: float, values: FloatArray, seed: np.uint32) -> float:
    """Fractional Brownian relief: amplitudes go as the wave length to the power of the Hurst exponent."""
    total, length = 0.0, values[1]
    shortest = max(SHORTEST_M, 2.0 * spacing)
    k, c, s = 0, 1.0, 0.0
    ct, st = math.cos(OCTAVE_TURN), math.sin(OCTAVE_TURN)
    while length > shortest:
        fade = min(length / shortest - 1.0, 1.0)
        px, py = (c * x + s * y) / length, (c * y - s * x) / length
        amplitude = 2.2 * values[0] * (length / values[1]) ** values[2]
        total += fade * amplitude * gradient2(px + 0.5 * k, py + 0.3 * k, seed ^ _RELIEF ^ np.uint32(k))[0]
        c, s = c * ct - s * st, s * ct + c * st
        length *= 0.5
        k += 1
    return total


@jit
def _ripples(x: float, y: float, values: FloatArray, shares: FloatArray, seed: np.uint32) -> float:
    sand = materials(x, y, shares, seed)[0]
    if sand <= 0.0:
        return 0.0
    warp = 2.5 * value2(x * 0.5, y * 0.5, seed ^ _RIPPLE)[0] + 0.9 * value2(x * 1.7, y * 1.7, seed ^ _RIPPLE)[0]
    phase = values[7] * x + values[8] * y + 2.0 * warp
    profile = math.sin(phase + 0.45 * math.sin(phase))
    patch = 0.5 + 0.5 * value2(x * 0.7 + 3.0, y * 0.7, seed ^ _RIPPLE ^ np.uint32(7))[0]
    return float(0.5 * values[6] * sand * patch * profile)


@jit
def _crater_profile(r: float, depth: float, rim: float) -> float:
    """Bowl and raised rim of an aged crater, smooth everywhere; `r` in crater radii."""
    if r > 2.2:
        return 0.0
    bowl = math.exp(-((r / 0.72) ** 4))
    edge = (r - 1.02) / (0.22 if r < 1.02 else 0.42)
    return -depth * bowl + rim * math.exp(-edge * edge)


@jit
def _craters(x: float, y: float, density: float, seed: np.uint32) -> float:
    """Small craters: numbers fall with the square of the diameter, depth about a tenth of it (aged)."""
    total, largest = 0.0, 2.0
    for k in range(CRATER_CLASSES):
        cell = 2.4 * largest
        i0, j0 = math.floor(x / cell - 0.5), math.floor(y / cell - 0.5)
        share = density * 0.75 * 4.0 ** (-k) * cell * cell
        for i in range(i0, i0 + 2):
            for j in range(j0, j0 + 2):
                h = hash2(i, j, seed ^ _CRATER ^ np.uint32(k))
                if unit(h) < share:
                    h1 = mix(h ^ np.uint32(1))
                    h2, h3 = mix(h1), mix(h1 ^ np.uint32(3))
                    cx, cy = (i + 0.4 + 0.2 * unit(h1)) * cell, (j + 0.4 + 0.2 * unit(h2)) * cell
                    diameter = largest * 0.5 * (1.0 + unit(h3))
                    age = 0.4 + 0.6 * unit(mix(h3))
                    r = 2.0 * math.hypot(x - cx, y - cy) / diameter
                    total += _crater_profile(r, 0.13 * age * diameter, 0.035 * age * diameter)
        largest *= 2.0
    return total

"""Height and material of the ground as functions of position; docs/simulation.md states the source of each number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.config import GroundConfig, ReliefConfig
from sfr_loc_map.simulation.noise import Stream, gradient2, hash2, mix, sub_seed, unit, value2

SHORTEST_M = 0.02  #: Shortest wavelength of the meshed relief, m; shorter waves appear only in the shading.
SAMPLES_PER_RIPPLE = 2.75  #: Samples per wavelength that resolve the ripples.
CRATER_CLASSES = 4  #: Number of size classes of craters; diameters double from class to class.
SMALLEST_CRATER_M = 1.0  #: Smallest diameter of a crater, m.
CRATER_CELL_DIAMETERS = 2.4  #: Cell size of the grid of a size class, as a multiple of its largest diameter.
CRATERS_PER_CLASS = 0.75  #: Fraction of the craters that have one to two times the smallest diameter: 1 - 1/4.
CRATER_DEPTH = 0.13  #: Ratio of the depth of a crater to its diameter.
CRATER_RIM = 0.035  #: Ratio of the height of the rim of a crater to its diameter.
LARGE_CRATER_DEPTH = 0.24  #: Ratio of the depth of the large crater to its radius.
LARGE_CRATER_RIM = 0.07  #: Ratio of the height of the rim of the large crater to its radius.
CRATER_REACH = 2.2  #: Distance from the centre beyond which a crater has no effect, crater radii.
BOWL_RADIUS = 0.72  #: Distance from the centre at which the bowl has 1/e of its depth, crater radii.
RIM_RADIUS = 1.02  #: Distance of the highest point of the rim from the centre, crater radii.
RIM_WIDTH_INSIDE = 0.22  #: Distance inside the rim at which the rim has 1/e of its height, crater radii.
RIM_WIDTH_OUTSIDE = 0.42  #: Distance outside the rim at which the rim has 1/e of its height, crater radii.
HILL_OCTAVES = 3  #: Number of octaves of the hills.
HILL_AMPLITUDE = 2.6  #: Ratio of the amplitude of the longest hills to the setting `hills_m`.
HILL_LACUNARITY = 2.1  #: Ratio of the wavelengths of successive octaves of the hills.
HILL_GAIN = 0.42  #: Ratio of the amplitudes of successive octaves of the hills.
RELIEF_AMPLITUDE = 2.2  #: Ratio of the amplitude of the longest relief to the setting `relief_m`.
OCTAVE_ANGLE = 0.6435
"""Angle between the noise grids of two octaves, rad, which hides the grid directions (3-4-5 triangle)."""
_HILL = np.uint32(Stream.HILLS)
_RELIEF = np.uint32(Stream.RELIEF)
_RIPPLE = np.uint32(Stream.RIPPLES)
_CRATER = np.uint32(Stream.CRATERS)
_SAND = np.uint32(Stream.SAND)
_ROCK = np.uint32(Stream.BEDROCK)


class TerrainParameters(NamedTuple):
    """Parameters of the ground for kernels."""

    relief_m: float  #: Height scale of the rolling relief.
    relief_length_m: float  #: Longest wavelength of the relief.
    hurst: float  #: Roughness exponent of the relief.
    hills_m: float  #: Height scale of the hills.
    hills_length_m: float  #: Wavelength of the hills.
    ripple_height_m: float  #: Crest height of wind ripples.
    ripple_length_m: float  #: Wavelength of wind ripples.
    ripple_wave_x: float  #: Wave number of the ripples to the east, radians per metre.
    ripple_wave_y: float  #: Wave number of the ripples to the north, radians per metre.
    crater_density: float  #: Craters wider than 1 m, per square metre.
    rim_radius_m: float  #: Radius of one large crater; 0 for none.
    rim_x_m: float  #: East coordinate of the large crater in DS.
    rim_y_m: float  #: North coordinate of the large crater in DS.
    gradient: float  #: Rise per metre to the east.
    gravel: float  #: Fraction of the ground with dense pebbles.
    bedrock: float  #: Fraction of the ground that is bare rock; the rest is sand.
    seed: np.uint32  #: Seed of the ground.


@dataclass(frozen=True, slots=True)
class Terrain:
    """The ground of a seed and a configuration."""

    parameters: TerrainParameters  #: Shape and materials.
    coarseness: float = 1.0  #: Triangle size relative to full detail.

    @classmethod
    def make(cls, seed: int, terrain: ReliefConfig, ground: GroundConfig) -> Terrain:
        """Return the ground of a configuration."""
        azimuth = math.radians(terrain.ripple_azimuth_deg)
        turn = 2.0 * math.pi
        parameters = TerrainParameters(
            relief_m=float(terrain.relief_m),
            relief_length_m=float(terrain.relief_length_m),
            hurst=float(terrain.hurst),
            hills_m=float(terrain.hills_m),
            hills_length_m=float(terrain.hills_length_m),
            ripple_height_m=float(terrain.ripple_height_m),
            ripple_length_m=float(terrain.ripple_length_m),
            ripple_wave_x=turn * math.cos(azimuth) / terrain.ripple_length_m,
            ripple_wave_y=turn * math.sin(azimuth) / terrain.ripple_length_m,
            crater_density=float(terrain.crater_density),
            rim_radius_m=float(terrain.rim_radius_m),
            rim_x_m=float(terrain.rim_x_m),
            rim_y_m=float(terrain.rim_y_m),
            gradient=math.tan(math.radians(terrain.slope_deg)),
            gravel=float(ground.gravel),
            bedrock=float(ground.bedrock),
            seed=sub_seed(seed, Stream.TERRAIN),
        )
        return cls(parameters, float(terrain.coarseness))

    def height(self, x: FloatArray, y: FloatArray, spacing: FloatArray) -> FloatArray:
        """Return heights `(N,)` in DS, metres; waves that the sample spacing does not resolve are omitted."""
        out = np.empty(len(x))
        _heights(x, y, spacing, self.parameters, out)
        return out


@jit_inline
def smooth_step(low: float, high: float, value: float) -> float:
    """Return 0 below `low`, 1 above `high` and a smooth cubic between."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@jit_inline
def materials(x: float, y: float, ground: TerrainParameters) -> tuple[float, float, float]:
    """Return the fractions of sand, gravel and bedrock at a position, which sum to 1.

    Patches come from noise with cells of 3.9, 1.1 and 0.26 m (gravel) and 2.7, 0.5 and 0.26 m (rock). The noise grids
    are rotated against each other to hide their directions. A soft threshold converts the noise to fractions.
    """
    bedrock = ground.bedrock
    seed = ground.seed
    a = value2(x * 0.23 + 0.11 * y, y * 0.23 - 0.11 * x, seed ^ _SAND)[0]
    b = value2(x * 0.9 - 0.3 * y, y * 0.9 + 0.3 * x, seed ^ _SAND ^ np.uint32(1))[0]
    c = value2(x * 3.7 + 1.3 * y, y * 3.7 - 1.3 * x, seed ^ _SAND ^ np.uint32(2))[0]
    cover = 0.5 + 0.42 * a + 0.30 * b + 0.16 * c
    d = value2(x * 0.31 - 0.2 * y, y * 0.31 + 0.2 * x, seed ^ _ROCK)[0]
    e = value2(x * 1.9 + 0.5 * y, y * 1.9 - 0.5 * x, seed ^ _ROCK ^ np.uint32(1))[0]
    bare = 0.5 + 0.5 * d + 0.18 * e + 0.06 * c
    rock = smooth_step(1.0 - bedrock - 0.06, 1.0 - bedrock + 0.06, bare) if bedrock > 0.0 else 0.0
    gravel = smooth_step(1.0 - ground.gravel - 0.15, 1.0 - ground.gravel + 0.15, cover)
    return (1.0 - rock) * (1.0 - gravel), (1.0 - rock) * gravel, rock


@jit
def _heights(x: FloatArray, y: FloatArray, spacing: FloatArray, parameters: TerrainParameters, out: FloatArray) -> None:
    """Write the heights `(N,)` at positions with sample spacings `(N,)`, all in metres, DS."""
    for i in range(len(x)):
        z = parameters.gradient * x[i] + _hills(x[i], y[i], parameters)
        z += _relief(x[i], y[i], spacing[i], parameters)
        z += _craters(x[i], y[i], parameters.crater_density, parameters.seed)
        rim = parameters.rim_radius_m
        if rim > 0.0:
            r = math.hypot(x[i] - parameters.rim_x_m, y[i] - parameters.rim_y_m) / rim
            z += _crater_profile(r, LARGE_CRATER_DEPTH * rim, LARGE_CRATER_RIM * rim)
        if SAMPLES_PER_RIPPLE * spacing[i] < parameters.ripple_length_m and parameters.ripple_height_m > 0.0:
            z += _ripples(x[i], y[i], parameters)
        out[i] = z


@jit
def _hills(x: float, y: float, parameters: TerrainParameters) -> float:
    """Return the height of the hills on the horizon. The offsets separate the nodes of the grids of two octaves."""
    total = 0.0
    scale = 1.0 / parameters.hills_length_m
    amplitude = HILL_AMPLITUDE * parameters.hills_m
    for k in range(HILL_OCTAVES):
        total += amplitude * gradient2(x * scale + 0.37, y * scale + 0.71, parameters.seed ^ _HILL ^ np.uint32(k))[0]
        scale *= HILL_LACUNARITY
        amplitude *= HILL_GAIN
    return total


@jit
def _relief(x: float, y: float, spacing: float, parameters: TerrainParameters) -> float:
    """Return the height of fractional Brownian relief: amplitudes are proportional to wavelength ** hurst.

    Waves of less than two samples are absent. Longer waves increase to their full amplitude at four samples.
    """
    total = 0.0
    longest = parameters.relief_length_m
    length = longest
    shortest = max(SHORTEST_M, 2.0 * spacing)
    k = 0
    c, s = 1.0, 0.0  # cosine and sine of the angle of the octave's grid
    ct = math.cos(OCTAVE_ANGLE)
    st = math.sin(OCTAVE_ANGLE)
    while length > shortest:
        fade = min(length / shortest - 1.0, 1.0)
        px = (c * x + s * y) / length
        py = (c * y - s * x) / length
        amplitude = RELIEF_AMPLITUDE * parameters.relief_m * (length / longest) ** parameters.hurst
        key = parameters.seed ^ _RELIEF ^ np.uint32(k)
        total += fade * amplitude * gradient2(px + 0.5 * k, py + 0.3 * k, key)[0]
        c, s = c * ct - s * st, s * ct + c * st
        length *= 0.5
        k += 1
    return total


@jit
def _ripples(x: float, y: float, parameters: TerrainParameters) -> float:
    """Return the height of wind ripples on sand: warped waves with sharpened crests, in patches."""
    seed = parameters.seed
    sand = materials(x, y, parameters)[0]
    if sand <= 0.0:
        return 0.0
    warp = 2.5 * value2(x * 0.5, y * 0.5, seed ^ _RIPPLE)[0] + 0.9 * value2(x * 1.7, y * 1.7, seed ^ _RIPPLE)[0]
    phase = parameters.ripple_wave_x * x + parameters.ripple_wave_y * y + 2.0 * warp
    profile = math.sin(phase + 0.45 * math.sin(phase))
    patch = 0.5 + 0.5 * value2(x * 0.7 + 3.0, y * 0.7, seed ^ _RIPPLE ^ np.uint32(7))[0]
    return float(0.5 * parameters.ripple_height_m * sand * patch * profile)


@jit
def _crater_profile(r: float, depth: float, rim: float) -> float:
    """Return the smooth profile of an aged crater, a bowl with a raised rim; `r` is in crater radii.

    The bowl is nearly flat inside 0.4 radii. The rim is about twice as wide outside as inside.
    """
    if r > CRATER_REACH:
        return 0.0
    bowl = math.exp(-((r / BOWL_RADIUS) ** 4))
    edge = (r - RIM_RADIUS) / (RIM_WIDTH_INSIDE if r < RIM_RADIUS else RIM_WIDTH_OUTSIDE)
    return -depth * bowl + rim * math.exp(-edge * edge)


@jit
def _craters(x: float, y: float, density: float, seed: np.uint32) -> float:
    """Return the height of small aged craters (Pike 1977); their number decreases with the square of the diameter.

    A size class spans a factor of two in diameter. It therefore contains `CRATERS_PER_CLASS` of the craters whose
    diameter is at least the smallest diameter of the class. A grid cell has at most one crater of each class, whose
    centre is in the middle fifth of the cell along each axis.
    """
    total = 0.0
    largest = 2.0 * SMALLEST_CRATER_M
    for k in range(CRATER_CLASSES):
        cell = CRATER_CELL_DIAMETERS * largest
        i0 = math.floor(x / cell - 0.5)
        j0 = math.floor(y / cell - 0.5)
        filled_fraction = density * CRATERS_PER_CLASS * 4.0 ** (-k) * cell * cell
        for i in range(i0, i0 + 2):
            for j in range(j0, j0 + 2):
                h = hash2(i, j, seed ^ _CRATER ^ np.uint32(k))
                if unit(h) < filled_fraction:
                    h1 = mix(h ^ np.uint32(1))
                    h2 = mix(h1)
                    h3 = mix(h1 ^ np.uint32(3))
                    cx = (i + 0.4 + 0.2 * unit(h1)) * cell
                    cy = (j + 0.4 + 0.2 * unit(h2)) * cell
                    diameter = largest * 0.5 * (1.0 + unit(h3))
                    height = 0.4 + 0.6 * unit(mix(h3))  # relative to a fresh crater
                    r = 2.0 * math.hypot(x - cx, y - cy) / diameter
                    total += _crater_profile(r, CRATER_DEPTH * height * diameter, CRATER_RIM * height * diameter)
        largest *= 2.0
    return total

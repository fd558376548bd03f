"""The effect of pebbles on the shading; pebbles are too small and too many to be meshed.

Lengths are in metres, positions in DS. The page docs/simulation.md states the source of each number.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.noise import Stream, hash2, mix, unit
from sfr_loc_map.simulation.terrain import smooth_step

SIZES = 5  #: Number of pebble sizes, each with its own grid.
LARGEST_CELL_M = 0.075  #: Cell size of the grid of the largest pebbles, m; a cell has at most one pebble.
RATIO = 0.56  #: Ratio of the cell sizes of successive grids; the smallest cell is 7 mm.
MIN_FILL = 0.01  #: Density of pebbles below which no pebble is drawn.
MAX_COVER = 0.97  #: Covered fraction of the footprint above which smaller pebbles are hidden and not drawn.
MAX_SHADOW = 0.85  #: Fraction of the sunlight that is blocked in the middle of a pebble's shadow.
RIM_SLOPE = 0.9  #: Slope at the rim of a pebble, which makes the pebble look round.
TILT_SLOPE = 0.8  #: Slope of a pebble's surface per unit of its tilt.
MAX_FILL = 0.95  #: Largest fraction of the cells of a size that have a pebble.
MIN_LEVEL = 1e-6  #: Lower bound of the horizontal component of the direction of the sun, which is a divisor.
MIN_SHADOW_LEVEL = 1e-3  #: Lower bound of the same component for the length of shadows.
_PEBBLE = np.uint32(Stream.PEBBLES)
_LOW_BYTE = np.uint32(255)
_ANGLES = np.arange(256) * (2.0 * np.pi / 255.0)  # indexed by 8 bits of a hash
_COSINES = np.cos(_ANGLES)
_SINES = np.sin(_ANGLES)
PEBBLE = np.dtype([(name, np.float64) for name in (
    "x", "y", "reach", "inverse_b", "px", "py", "qx", "qy", "shadow_p", "shadow_q", "skew", "tone", "tilt_x", "tilt_y",
    "threshold",
)])  # fmt: skip
"""A pebble, with lengths in cells: centre; reach; inverse of the smaller half axis; matrix `(px py; qx qy)` from an
offset to outline coordinates; shift of the shadow in outline coordinates; skew; tone; tilt. The pebble exists if the
fraction of filled cells exceeds the threshold."""


class PebbleField(NamedTuple):
    """Parameters of all pebbles of a world."""

    fill: float  #: Largest density of pebbles on any ground, 0 to 1.
    bump: float  #: Strength of the pebbles' relief.
    seed: np.uint32  #: Seed of the ground.
    sun_x: float  #: East component of the horizontal unit vector towards the sun.
    sun_y: float  #: North component of the horizontal unit vector towards the sun.
    shadow_per_height: float  #: Length of a shadow over the height of the object.

    @classmethod
    def of(cls, fill: float, bump: float, seed: np.uint32, sun: FloatArray) -> PebbleField:
        """Return the field for a unit vector `(3,)` towards the sun, DS."""
        level = math.hypot(sun[0], sun[1])
        divisor = max(level, MIN_LEVEL)
        return cls(
            fill=fill,
            bump=bump,
            seed=seed,
            sun_x=float(sun[0] / divisor),
            sun_y=float(sun[1] / divisor),
            shadow_per_height=float(max(level, MIN_SHADOW_LEVEL) / sun[2]),
        )


class PebbleCache(NamedTuple):
    """Pebbles of each size near the last position, because neighbouring rays mostly hit the same pebbles."""

    cells: FloatArray  #: `(SIZES, 2)` index of the first of four cells; infinite in an empty cache.
    counts: IntArray  #: `(SIZES,)` number of pebbles in the four cells.
    pebbles: NDArray[np.void]  #: `(SIZES, 4)` of `PEBBLE`.


class PebbleCover(NamedTuple):
    """Effect of the pebbles at a position."""

    cover: float  #: Fraction of the footprint that pebbles cover.
    tone: float  #: Logarithm of the ratio of the pebbles' reflectance to the mean.
    slope_x: float  #: Slope of the pebbles' surface to the east.
    slope_y: float  #: Slope of the pebbles' surface to the north.
    shadow: float  #: Fraction of the sunlight that pebbles block on the ground beside the pebbles.


@jit
def pebble_cache() -> PebbleCache:
    """Return an empty cache."""
    return PebbleCache(np.full((SIZES, 2), np.inf), np.zeros(SIZES, np.int64), np.empty((SIZES, 4), PEBBLE))


@jit
def pebbles(x: float, y: float, footprint: float, fill: float, field: PebbleField, cache: PebbleCache) -> PebbleCover:
    """Return the effect of pebbles at a position; larger pebbles are on top of smaller pebbles.

    `footprint` is the size of a pixel across the line of sight, metres, and `fill` the density of pebbles at the
    position, 0 to 1. Pebbles of a size fade in from 1.8 to 3.8 pixels per cell. The cache is updated.
    """
    seen = PebbleCover(0.0, 0.0, 0.0, 0.0, 0.0)
    if fill < MIN_FILL:
        return seen
    cells = 1.0 / LARGEST_CELL_M
    for k in range(SIZES):
        pixel = footprint * cells
        if 0.9 * pixel >= 0.5 or seen.cover > MAX_COVER:
            break
        weight = min(0.5 / pixel - 0.9, 1.0)
        filled_fraction = _filled(fill, k)
        qx = x * cells
        qy = y * cells
        i0 = np.floor(qx - 0.5)
        j0 = np.floor(qy - 0.5)
        if cache.cells[k, 0] != i0 or cache.cells[k, 1] != j0:
            cache.cells[k, 0] = i0
            cache.cells[k, 1] = j0
            cache.counts[k] = _scatter(np.int32(i0), np.int32(j0), k, field, cache.pebbles[k])
        for m in range(cache.counts[k]):
            pebble = cache.pebbles[k, m]
            if pebble.threshold < filled_fraction:
                seen = _with_pebble(seen, pebble, qx - pebble.x, qy - pebble.y, pixel, weight, field.bump)
        cells /= RATIO
    return seen


@jit_inline
def _with_pebble(
    seen: PebbleCover,
    pebble: Any,  # noqa: ANN401 - a record of `PEBBLE`
    dx: float,
    dy: float,
    pixel: float,
    weight: float,
    bump: float,
) -> PebbleCover:
    """Return the effect with one more pebble below the previous pebbles; edges are blurred over a pixel.

    `dx`, `dy` is the offset of the position from the centre of the pebble, and `pixel` the size of a pixel, in cells.
    """
    cover, tone, sx, sy, shadow = seen
    reach = pebble.reach + pixel
    if dx * dx + dy * dy > reach * reach:
        return seen
    p = pebble.px * dx + pebble.py * dy
    q = pebble.qx * dx + pebble.qy * dy
    d = _outline(p, q, pebble.skew)
    soft = pixel * pebble.inverse_b
    inside = weight * (1.0 - smooth_step(1.0 - 0.6 * soft, 1.0 + 0.6 * soft + 1e-3, d))
    if inside > 0.0:
        part = (1.0 - cover) * inside
        cover += part
        keep = part / cover
        rim = RIM_SLOPE * bump * smooth_step(0.5, 1.0, d) / max(math.sqrt(dx * dx + dy * dy), 1e-6)
        tone += keep * (pebble.tone - tone)
        sx += keep * (TILT_SLOPE * bump * pebble.tilt_x - rim * dx - sx)
        sy += keep * (TILT_SLOPE * bump * pebble.tilt_y - rim * dy - sy)
    else:
        e = _outline(p + pebble.shadow_p, q + pebble.shadow_q, pebble.skew)
        dark = weight * (1.0 - smooth_step(0.85 - 0.5 * soft, 1.1 + 0.5 * soft, e))
        shadow = max(shadow, MAX_SHADOW * dark)
    return PebbleCover(cover, tone, sx, sy, shadow)


@jit
def _scatter(i0: np.int32, j0: np.int32, k: int, field: PebbleField, out: NDArray[np.void]) -> int:
    """Write the pebbles of one size in four cells; return the number of pebbles.

    Half axes of 0.16 to 0.42 cells keep each pebble near its cell, so that four cells hold all pebbles that reach a
    position. The xor constants decorrelate the hashes of a pebble. Tones and tilts were chosen by eye.
    """
    count = 0
    key = field.seed ^ _PEBBLE ^ np.uint32(977 * k)
    fill = _filled(field.fill, k)
    for m in range(4):
        i = i0 + m // 2
        j = j0 + m % 2
        h = hash2(i, j, key)
        if unit(h) >= fill:
            continue
        pebble = out[count]
        count += 1
        pebble.threshold = unit(h)
        h1 = mix(h ^ np.uint32(0x51ED27))
        h2 = mix(h ^ np.uint32(0x2F6E2B))
        h3 = mix(h ^ np.uint32(0x6C8E94))
        a = 0.16 + 0.26 * _byte(h1, 2) * _byte(h2, 3)
        b = a * (0.5 + 0.5 * _byte(h1, 3))
        throw = 0.5 * min(0.5 * max(field.shadow_per_height, 0.1) * b, 0.45)
        ca = _COSINES[h2 & _LOW_BYTE]
        sa = _SINES[h2 & _LOW_BYTE]
        skew = 1.3 * (_byte(h2, 1) - 0.5)
        pebble.x = i + 0.25 + 0.5 * _byte(h1, 0)
        pebble.y = j + 0.25 + 0.5 * _byte(h1, 1)
        by_a = 1.0 / a
        by_b = 1.0 / b
        qx = -sa * by_b
        qy = ca * by_b
        px = ca * by_a + 0.5 * skew * qx
        py = sa * by_a + 0.5 * skew * qy
        pebble.reach = 1.6 * a + throw
        pebble.inverse_b = by_b
        pebble.px = px
        pebble.py = py
        pebble.qx = qx
        pebble.qy = qy
        pebble.shadow_p = throw * (px * field.sun_x + py * field.sun_y)
        pebble.shadow_q = throw * (qx * field.sun_x + qy * field.sun_y)
        pebble.skew = skew
        pebble.tone = 0.55 * (_byte(h3, 0) - 0.45) + 0.3 * (_byte(h3, 3) - 0.5)
        pebble.tilt_x = _byte(h3, 1) - 0.5
        pebble.tilt_y = _byte(h3, 2) - 0.5
    return count


@jit_inline
def _filled(fill: float, k: int) -> float:
    """Return the fraction of cells of a size that have a pebble; smaller pebbles are more frequent, as in nature."""
    return min(fill * (0.25 + 0.26 * k), MAX_FILL)


@jit_inline
def _byte(value: np.uint32, which: int) -> float:
    """Return byte `which` of a hash, counted from the lowest, as a number from 0 to 1."""
    return ((value >> np.uint32(8 * which)) & _LOW_BYTE) * (1.0 / 255.0)


@jit_inline
def _outline(p: float, q: float, skew: float) -> float:
    """Return 1 on the outline of a pebble with seven unequal sides, less inside."""
    return max(abs(p), abs(q), 0.74 * (p + q), 0.66 * (p - q), -0.7 * (p + q) * (1.0 + 0.3 * skew))

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
_PEBBLE = np.uint32(Stream.PEBBLES)
_COSINES, _SINES = (f(np.arange(256) * (2.0 * np.pi / 255.0)) for f in (np.cos, np.sin))  # indexed by 8 bits of a hash
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
        sun_x, sun_y = (float(part / max(level, 1e-6)) for part in sun[:2])
        return cls(fill, bump, seed, sun_x, sun_y, float(max(level, 1e-3) / sun[2]))


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
    """Return the effect of pebbles at a position; larger pebbles lie on top of smaller pebbles."""
    seen = PebbleCover(0.0, 0.0, 0.0, 0.0, 0.0)
    if fill < 0.01:
        return seen
    cells = 1.0 / LARGEST_CELL_M
    for k in range(SIZES):
        pixel = footprint * cells
        if 0.9 * pixel >= 0.5 or seen.cover > 0.97:
            break
        weight = min(0.5 / pixel - 0.9, 1.0)
        share = _filled(fill, k)
        qx, qy = x * cells, y * cells
        i0, j0 = np.floor(qx - 0.5), np.floor(qy - 0.5)
        if cache.cells[k, 0] != i0 or cache.cells[k, 1] != j0:
            cache.cells[k, 0], cache.cells[k, 1] = i0, j0
            cache.counts[k] = _scatter(np.int32(i0), np.int32(j0), k, field, cache.pebbles[k])
        for m in range(cache.counts[k]):
            pebble = cache.pebbles[k, m]
            if pebble.threshold < share:
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
    """Return the effect with one more pebble below the previous pebbles.

    Edges are blurred over a pixel. The slope at the rim makes the pebble look round; the factors were chosen by eye.
    """
    cover, tone, sx, sy, shadow = seen
    reach = pebble.reach + pixel
    if dx * dx + dy * dy > reach * reach:
        return seen
    p, q = pebble.px * dx + pebble.py * dy, pebble.qx * dx + pebble.qy * dy
    d = _outline(p, q, pebble.skew)
    soft = pixel * pebble.inverse_b
    inside = weight * (1.0 - smooth_step(1.0 - 0.6 * soft, 1.0 + 0.6 * soft + 1e-3, d))
    if inside > 0.0:
        part = (1.0 - cover) * inside
        cover += part
        keep = part / cover
        rim = 0.9 * bump * smooth_step(0.5, 1.0, d) / max(math.sqrt(dx * dx + dy * dy), 1e-6)
        tone += keep * (pebble.tone - tone)
        sx += keep * (0.8 * bump * pebble.tilt_x - rim * dx - sx)
        sy += keep * (0.8 * bump * pebble.tilt_y - rim * dy - sy)
    else:
        e = _outline(p + pebble.shadow_p, q + pebble.shadow_q, pebble.skew)
        dark = weight * (1.0 - smooth_step(0.85 - 0.5 * soft, 1.1 + 0.5 * soft, e))
        shadow = max(shadow, 0.85 * dark)
    return PebbleCover(cover, tone, sx, sy, shadow)


@jit
def _scatter(i0: np.int32, j0: np.int32, k: int, field: PebbleField, out: NDArray[np.void]) -> int:
    """Write the pebbles of one size in four cells; return the number of pebbles.

    Half axes of 0.16 to 0.42 cells keep each pebble near its cell, so that four cells hold all pebbles that reach a
    position. The xor constants decorrelate the hashes of a pebble. Tones and tilts were chosen by eye.
    """
    count = 0
    key, fill = field.seed ^ _PEBBLE ^ np.uint32(977 * k), _filled(field.fill, k)
    for m in range(4):
        i, j = i0 + m // 2, j0 + m % 2
        h = hash2(i, j, key)
        if unit(h) >= fill:
            continue
        pebble = out[count]
        count += 1
        pebble.threshold = unit(h)
        h1, h2, h3 = mix(h ^ np.uint32(0x51ED27)), mix(h ^ np.uint32(0x2F6E2B)), mix(h ^ np.uint32(0x6C8E94))
        a = 0.16 + 0.26 * _byte(h1, 2) * _byte(h2, 3)
        b = a * (0.5 + 0.5 * _byte(h1, 3))
        throw = 0.5 * min(0.5 * max(field.shadow_per_height, 0.1) * b, 0.45)
        ca, sa = _COSINES[h2 & np.uint32(255)], _SINES[h2 & np.uint32(255)]
        skew = 1.3 * (_byte(h2, 1) - 0.5)
        pebble.x, pebble.y = i + 0.25 + 0.5 * _byte(h1, 0), j + 0.25 + 0.5 * _byte(h1, 1)
        by_a, by_b = 1.0 / a, 1.0 / b
        qx, qy = -sa * by_b, ca * by_b
        px, py = ca * by_a + 0.5 * skew * qx, sa * by_a + 0.5 * skew * qy
        pebble.reach, pebble.inverse_b = 1.6 * a + throw, by_b
        pebble.px, pebble.py, pebble.qx, pebble.qy = px, py, qx, qy
        pebble.shadow_p = throw * (px * field.sun_x + py * field.sun_y)
        pebble.shadow_q = throw * (qx * field.sun_x + qy * field.sun_y)
        pebble.skew = skew
        pebble.tone = 0.55 * (_byte(h3, 0) - 0.45) + 0.3 * (_byte(h3, 3) - 0.5)
        pebble.tilt_x, pebble.tilt_y = _byte(h3, 1) - 0.5, _byte(h3, 2) - 0.5
    return count


@jit_inline
def _filled(fill: float, k: int) -> float:
    """Return the fraction of cells of a size that have a pebble; smaller pebbles are more frequent, as in nature."""
    return min(fill * (0.25 + 0.26 * k), 0.95)


@jit_inline
def _byte(value: np.uint32, which: int) -> float:
    return ((value >> np.uint32(8 * which)) & np.uint32(255)) * (1.0 / 255.0)


@jit_inline
def _outline(p: float, q: float, skew: float) -> float:
    """Return 1 on the outline of a pebble with seven unequal sides, less inside."""
    return max(abs(p), abs(q), 0.74 * (p + q), 0.66 * (p - q), -0.7 * (p + q) * (1.0 + 0.3 * skew))

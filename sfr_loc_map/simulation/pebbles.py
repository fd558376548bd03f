"""Pebbles that are too small to be solids: one to a cell of a grid, five sizes of grid over each other."""

from __future__ import annotations

import math

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit, jit_inline
from sfr_loc_map.simulation.noise import hash2, mix, unit
from sfr_loc_map.simulation.terrain import smooth_step

SIZES = 5
LARGEST_CELL_M = 0.075
RATIO = 0.56
_PEBBLE = np.uint32(101)
_COSINES, _SINES = (f(np.arange(256) * (2.0 * np.pi / 255.0)) for f in (np.cos, np.sin))
_NUMBERS = 15
"""Numbers kept of a pebble, in cells: centre 2, reach, inverse of the smaller half axis, the map from offset to outline
4, shift of the shadow under that map 2, skew, tone, tilt 2, share of the ground from which on it is there."""


def throw_values(sun: FloatArray) -> FloatArray:
    """Return `(3,)` what `pebbles` needs of the sun: direction in plan, and shadow length over height."""
    level = math.hypot(sun[0], sun[1])
    return np.array([sun[0] / max(level, 1e-6), sun[1] / max(level, 1e-6), max(level, 1e-3) / sun[2]])


@jit
def pebble_memory() -> FloatArray:
    """Return room for the pebbles near the last place, of each size; neighbouring rays mostly meet the same ones."""
    return np.full((SIZES, 1 + 4, _NUMBERS), np.inf)


@jit
def pebbles(
    x: float,
    y: float,
    footprint: float,
    full: float,
    fullest: float,
    bump: float,
    throws: FloatArray,
    seed: np.uint32,
    memory: FloatArray,
) -> tuple[float, float, float, float, float]:
    """Return what pebbles do at a place; the larger lie on top of the smaller.

    Args:
        x: Metres, DS.
        y: Metres, DS.
        footprint: Size of a pixel on the ground, metres.
        full: How full the ground is of them, 0 to 1.
        fullest: How full any ground of this world is.
        bump: Strength of their relief.
        throws: From `throw_values`.
        seed: Of the ground.
        memory: From `pebble_memory`; for one seed and sun. It saves time only.

    Returns:
        Share covered, tone, slopes by x and y, and the share of the sun that they block beside them.
    """
    cover, tone, sx, sy, shadow = 0.0, 0.0, 0.0, 0.0, 0.0
    if full < 0.01:
        return cover, tone, sx, sy, shadow
    cells = 1.0 / LARGEST_CELL_M
    for k in range(SIZES):
        pixel = footprint * cells
        if 0.9 * pixel >= 0.5 or cover > 0.97:
            break
        weight = min(0.5 / pixel - 0.9, 1.0)
        share = _share(full, k)
        qx, qy = x * cells, y * cells
        i0, j0 = np.floor(qx - 0.5), np.floor(qy - 0.5)
        if memory[k, 0, 0] != i0 or memory[k, 0, 1] != j0:
            _remember(
                np.int32(i0), np.int32(j0), throws, _share(fullest, k), seed ^ _PEBBLE ^ np.uint32(977 * k), k, memory
            )
        for m in range(1, 1 + int(memory[k, 0, 2])):
            if memory[k, m, 14] >= share:
                continue
            dx, dy = qx - memory[k, m, 0], qy - memory[k, m, 1]
            reach = memory[k, m, 2] + pixel
            if dx * dx + dy * dy > reach * reach:
                continue
            p, q = memory[k, m, 4] * dx + memory[k, m, 5] * dy, memory[k, m, 6] * dx + memory[k, m, 7] * dy
            d = _outline(p, q, memory[k, m, 10])
            soft = pixel * memory[k, m, 3]
            inside = weight * (1.0 - smooth_step(1.0 - 0.6 * soft, 1.0 + 0.6 * soft + 1e-3, d))
            if inside > 0.0:
                part = (1.0 - cover) * inside
                cover += part
                keep = part / cover
                rim = 0.9 * bump * smooth_step(0.5, 1.0, d) / max(math.sqrt(dx * dx + dy * dy), 1e-6)
                tone += keep * (memory[k, m, 11] - tone)
                sx += keep * (0.8 * bump * memory[k, m, 12] - rim * dx - sx)
                sy += keep * (0.8 * bump * memory[k, m, 13] - rim * dy - sy)
            else:
                e = _outline(p + memory[k, m, 8], q + memory[k, m, 9], memory[k, m, 10])
                dark = weight * (1.0 - smooth_step(0.85 - 0.5 * soft, 1.1 + 0.5 * soft, e))
                shadow = max(shadow, 0.85 * dark)
        cells /= RATIO
    return cover, tone, sx, sy, shadow


@jit
def _remember(
    i0: np.int32, j0: np.int32, throws: FloatArray, fullest: float, key: np.uint32, k: int, memory: FloatArray
) -> None:
    """Write the pebbles of four cells; each is there only where the ground is fuller than the share kept last."""
    memory[k, 0, 0], memory[k, 0, 1] = i0, j0
    count = 0
    for m in range(4):
        i, j = i0 + m // 2, j0 + m % 2
        h = hash2(i, j, key)
        if unit(h) >= fullest:
            continue
        count += 1
        memory[k, count, 14] = unit(h)
        h1, h2, h3 = mix(h ^ np.uint32(0x51ED27)), mix(h ^ np.uint32(0x2F6E2B)), mix(h ^ np.uint32(0x6C8E94))
        a = 0.16 + 0.26 * _byte(h1, 2) * _byte(h2, 3)
        b = a * (0.5 + 0.5 * _byte(h1, 3))
        throw = 0.5 * min(0.5 * max(throws[2], 0.1) * b, 0.45)
        ca, sa = _COSINES[h2 & np.uint32(255)], _SINES[h2 & np.uint32(255)]
        skew = 1.3 * (_byte(h2, 1) - 0.5)
        memory[k, count, 0] = i + 0.25 + 0.5 * _byte(h1, 0)
        memory[k, count, 1] = j + 0.25 + 0.5 * _byte(h1, 1)
        by_a, by_b = 1.0 / a, 1.0 / b
        qx, qy = -sa * by_b, ca * by_b
        px, py = ca * by_a + 0.5 * skew * qx, sa * by_a + 0.5 * skew * qy
        memory[k, count, 2], memory[k, count, 3] = 1.6 * a + throw, by_b
        memory[k, count, 4], memory[k, count, 5], memory[k, count, 6], memory[k, count, 7] = px, py, qx, qy
        memory[k, count, 8], memory[k, count, 9] = (
            throw * (px * throws[0] + py * throws[1]),
            throw * (qx * throws[0] + qy * throws[1]),
        )
        memory[k, count, 10] = skew
        memory[k, count, 11] = 0.55 * (_byte(h3, 0) - 0.45) + 0.3 * (_byte(h3, 3) - 0.5)
        memory[k, count, 12], memory[k, count, 13] = _byte(h3, 1) - 0.5, _byte(h3, 2) - 0.5
    memory[k, 0, 2] = count


@jit_inline
def _share(full: float, k: int) -> float:
    """Return how many cells of a size have a pebble."""
    return min(full * (0.25 + 0.26 * k), 0.95)


@jit_inline
def _byte(value: np.uint32, which: int) -> float:
    return ((value >> np.uint32(8 * which)) & np.uint32(255)) * (1.0 / 255.0)


@jit_inline
def _outline(p: float, q: float, skew: float) -> float:
    """Return 1 on the outline of a stone with seven unlike sides, less inside."""
    return max(abs(p), abs(q), 0.74 * (p + q), 0.66 * (p - q), -0.7 * (p + q) * (1.0 + 0.3 * skew))

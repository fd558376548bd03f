"""Pebbles that are too small to be solids: one to a cell of a grid, five sizes of grid over each other."""

from __future__ import annotations

import math

import numpy as np

from sfr_loc_map.simulation.noise import hash2, jit, mix, unit
from sfr_loc_map.simulation.terrain import FloatArray, smooth_step

SIZES = 5
LARGEST_CELL_M = 0.075
RATIO = 0.56
_PEBBLE = np.uint32(101)


@jit
def pebbles(
    x: float, y: float, footprint: float, full: float, bump: float, sun: FloatArray, seed: np.uint32
) -> tuple[float, float, float, float, float]:
    """Return what pebbles do at a place; the larger lie on top of the smaller.

    Args:
        x: Metres, DS.
        y: Metres, DS.
        footprint: Size of a pixel on the ground, metres.
        full: How full the ground is of them, 0 to 1.
        bump: Strength of their relief.
        sun: `(3,)` unit vector towards the sun.
        seed: Of the ground.

    Returns:
        Share covered, tone, slopes by x and y, and the share of the sun that they block beside them.
    """
    cover, tone, sx, sy, shadow = 0.0, 0.0, 0.0, 0.0, 0.0
    if full < 0.01:
        return cover, tone, sx, sy, shadow
    cell = LARGEST_CELL_M
    climb = min(sun[2] / max(math.hypot(sun[0], sun[1]), 1e-3), 10.0)
    away = 1.0 / max(math.hypot(sun[0], sun[1]), 1e-6)
    ux, uy = sun[0] * away, sun[1] * away
    for k in range(SIZES):
        weight = min(max(0.45 * cell / footprint - 0.6, 0.0), 1.0)
        if weight <= 0.0 or cover > 0.97:
            break
        share = min(full * (0.25 + 0.26 * k), 0.95)
        qx, qy = x / cell, y / cell
        i0, j0 = math.floor(qx - 0.5), math.floor(qy - 0.5)
        for i in range(i0, i0 + 2):
            for j in range(j0, j0 + 2):
                h = hash2(i, j, seed ^ _PEBBLE ^ np.uint32(977 * k))
                if unit(h) >= share:
                    continue
                h1 = mix(h ^ np.uint32(0x51ED27))
                dx = qx - (i + 0.5 + 0.5 * (_byte(h1, 0) - 0.5))
                dy = qy - (j + 0.5 + 0.5 * (_byte(h1, 1) - 0.5))
                h2 = mix(h1 ^ np.uint32(0x2F6E2B))
                a = 0.16 + 0.26 * _byte(h1, 2) * _byte(h2, 3)
                b = a * (0.5 + 0.5 * _byte(h1, 3))
                throw = min(0.5 * b / climb, 0.45)
                bound = 1.6 * a + 0.5 * throw + footprint / cell
                if dx * dx + dy * dy > bound * bound:
                    continue
                angle = 6.2831853 * _byte(h2, 0)
                ca, sa = math.cos(angle), math.sin(angle)
                skew = 1.3 * (_byte(h2, 1) - 0.5)
                d = _outline(ca * dx + sa * dy, ca * dy - sa * dx, a, b, skew)
                soft = footprint / (cell * b)
                inside = weight * (1.0 - smooth_step(1.0 - 0.6 * soft, 1.0 + 0.6 * soft + 1e-3, d))
                if inside > 0.0:
                    h3 = mix(h2)
                    part = (1.0 - cover) * inside
                    tilt = 0.8 * bump
                    rim = bump * 0.9 * smooth_step(0.5, 1.0, d)
                    r = 1.0 / max(math.hypot(dx, dy), 1e-6)
                    total = cover + part
                    keep = part / total
                    tone += keep * (0.55 * (_byte(h3, 0) - 0.45) + 0.3 * (_byte(h3, 3) - 0.5) - tone)
                    sx += keep * (tilt * (_byte(h3, 1) - 0.5) - rim * dx * r - sx)
                    sy += keep * (tilt * (_byte(h3, 2) - 0.5) - rim * dy * r - sy)
                    cover = total
                else:
                    ox, oy = dx + 0.5 * throw * ux, dy + 0.5 * throw * uy
                    e = _outline(ca * ox + sa * oy, ca * oy - sa * ox, a, b, skew)
                    dark = weight * (1.0 - smooth_step(0.85 - 0.5 * soft, 1.1 + 0.5 * soft, e))
                    shadow = max(shadow, 0.85 * dark)
        cell *= RATIO
    return cover, tone, sx, sy, shadow


@jit
def _byte(value: np.uint32, which: int) -> float:
    return ((value >> np.uint32(8 * which)) & np.uint32(255)) * (1.0 / 255.0)


@jit
def _outline(u: float, v: float, a: float, b: float, skew: float) -> float:
    """Return 1 on the outline of a stone with seven unlike sides, less inside."""
    p, q = u / a + 0.5 * skew * v / b, v / b
    return max(abs(p), abs(q), 0.74 * (p + q), 0.66 * (p - q), -0.7 * (p + q) * (1.0 + 0.3 * skew))

"""Quaternions in compiled loops: scalar last, tuples of four numbers, in the conventions of `geometry.rotation`.

Row by row, so that the bits of a row do not depend on how many are computed at once.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit

Quat = tuple[float, float, float, float]  #: x, y, z, w of a unit quaternion.
Vector = tuple[float, float, float]


@jit
def row_quat(rows: FloatArray, i: int) -> Quat:
    """Return row i of quaternions `(N, 4)`."""
    return rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]


@jit
def row_difference(a: FloatArray, i: int, b: FloatArray, j: int) -> Vector:
    """Return row i of vectors `(N, 3)` less row j of others."""
    return a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]


@jit
def conjugate(q: Quat) -> Quat:
    """Return the inverse rotation."""
    return -q[0], -q[1], -q[2], q[3]


@jit
def product(a: Quat, b: Quat) -> Quat:
    """Return the Hamilton product `a b`: rotates by b first, then by a."""
    return (
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    )


@jit
def rotated(q: Quat, v: Vector) -> Vector:
    """Return `v` rotated by the unit quaternion `q`."""
    x = 2.0 * (q[1] * v[2] - q[2] * v[1])
    y = 2.0 * (q[2] * v[0] - q[0] * v[2])
    z = 2.0 * (q[0] * v[1] - q[1] * v[0])
    return (
        v[0] + q[3] * x + q[1] * z - q[2] * y,
        v[1] + q[3] * y + q[2] * x - q[0] * z,
        v[2] + q[3] * z + q[0] * y - q[1] * x,
    )


@jit
def unit_quats(quats: FloatArray) -> FloatArray:
    """Return quaternions `(N, 4)` of unit length."""
    out = np.empty((len(quats), 4))
    for i in range(len(quats)):
        x, y, z, w = row_quat(quats, i)
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = x / norm, y / norm, z / norm, w / norm
    return out


@jit
def slerp(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Return unit quaternions on the shortest rotation from `a` to `b` (Shoemake 1985).

    Args:
        a: `(N, 4)` unit quaternions.
        b: `(N, 4)` unit quaternions.
        share: `(N,)`, 0 at `a`, 1 at `b`.
    """
    out = np.empty((len(a), 4))
    for i in range(len(a)):
        dot = a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2] + a[i, 3] * b[i, 3]
        sign = -1.0 if dot < 0.0 else 1.0
        minus, plus = 0.0, 0.0
        for k in range(4):
            minus += (a[i, k] - sign * b[i, k]) ** 2
            plus += (a[i, k] + sign * b[i, k]) ** 2
        angle = 2.0 * np.arctan2(np.sqrt(minus), np.sqrt(plus))
        sine = np.sin(angle)
        wa, wb = 1.0 - share[i], share[i]
        if sine > 1e-6:
            wa, wb = np.sin(wa * angle) / sine, np.sin(wb * angle) / sine
        norm = 0.0
        for k in range(4):
            out[i, k] = wa * a[i, k] + sign * wb * b[i, k]
            norm += out[i, k] * out[i, k]
        norm = np.sqrt(norm)
        for k in range(4):
            out[i, k] /= norm
    return out

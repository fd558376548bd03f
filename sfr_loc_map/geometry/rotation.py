"""Rotations as matrices, scalar-last quaternions and rotation vectors.

All quaternions are `quat_xyzw` (`q = w + x i + y j + z k`), as in ROS messages and as `[q1 q2 q3 q4]` in the source
document [3.1.1]. Shapes `(..., N)` accept one rotation or an array of rotations.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, length

MIN_NORM: Final = 1e-12  #: Smallest norm of a quaternion that can be normalised.
SMALL_SINE: Final = 1e-6  #: Sine of the angle below which `slerp` interpolates linearly, with an error below 1e-12.
SMALL_HALF_SINE: Final = 1e-9  #: Sine of the half angle below which the rotation vector is twice the vector part.
NO_LENGTH: Final = "a quaternion is zero or not finite: four finite numbers, not all zero, are required"


def quat_normalised(quat_xyzw: ArrayLike) -> FloatArray:
    """Return unit quaternions `(..., 4)`; GeometryError if a quaternion is zero or not finite."""
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    norm = np.sqrt(np.sum(quat * quat, axis=-1, keepdims=True))
    if not np.all(np.isfinite(norm)) or np.any(norm < MIN_NORM):
        raise GeometryError(NO_LENGTH)
    return np.asarray(quat / norm)


def unit_quats(quats_xyzw: FloatArray) -> FloatArray:
    """Return unit quaternions `(N, 4)`; NaN for zero quaternions, which are unknown attitudes."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(quats_xyzw / np.sqrt(np.sum(np.square(quats_xyzw), axis=-1, keepdims=True)))


def slerp(a_xyzw: FloatArray, b_xyzw: FloatArray, fraction: FloatArray) -> FloatArray:
    """Return unit quaternions `(N, 4)` at fractions `(N,)` of the shortest rotation from a to b (Shoemake 1985)."""
    nearest = np.where(np.sum(a_xyzw * b_xyzw, axis=1) < 0.0, -1.0, 1.0)[:, None] * b_xyzw  # -q is the rotation q
    chord = np.linalg.norm(a_xyzw - nearest, axis=1)
    angle = 2.0 * np.arctan2(chord, np.linalg.norm(a_xyzw + nearest, axis=1))
    sine = np.sin(angle)
    is_small = ~(sine > SMALL_SINE)
    divisor = np.where(is_small, 1.0, sine)
    weight_a = np.where(is_small, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / divisor)
    weight_b = np.where(is_small, fraction, np.sin(fraction * angle) / divisor)
    return unit_quats(weight_a[:, None] * a_xyzw + weight_b[:, None] * nearest)


def quat_conjugate(quat_xyzw: ArrayLike) -> FloatArray:
    """Return the conjugate `(..., 4)`, the inverse rotation of a unit quaternion; exact, because only signs change."""
    quat = np.array(quat_xyzw, dtype=np.float64)
    quat[..., :3] = -quat[..., :3]
    return quat


def quat_multiply(a_xyzw: ArrayLike, b_xyzw: ArrayLike) -> FloatArray:
    """Return the Hamilton product `a b` `(..., 4)`, which rotates by b first, then by a."""
    a = np.asarray(a_xyzw, dtype=np.float64)
    b = np.asarray(b_xyzw, dtype=np.float64)
    ax, ay, az, aw = (a[..., i] for i in range(4))
    bx, by, bz, bw = (b[..., i] for i in range(4))
    return np.stack(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ),
        axis=-1,
    )


def quat_angle(quat_xyzw: ArrayLike) -> FloatArray:
    """Return the rotation angles `(...)`, rad, 0 to pi, of unit quaternions `(..., 4)`."""
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(quat[..., :3], axis=-1), np.abs(quat[..., 3])))


def rotvecs_from_quats(quats_xyzw: FloatArray) -> FloatArray:
    """Return the rotation vectors `(N, 3)`, radians, angles in [0, pi], of unit quaternions `(N, 4)`."""
    nearest = np.where(quats_xyzw[:, 3:] < 0.0, -quats_xyzw, quats_xyzw)  # -q is the rotation q
    sines = np.linalg.norm(nearest[:, :3], axis=1)
    angles = 2.0 * np.arctan2(sines, nearest[:, 3])
    is_small = sines < SMALL_HALF_SINE
    scales = np.where(is_small, 2.0, angles / np.where(is_small, 1.0, sines))
    return np.asarray(scales[:, None] * nearest[:, :3])


def quat_rotate(quat_xyzw: ArrayLike, vectors: ArrayLike) -> FloatArray:
    """Rotate vectors `(..., 3)` by unit quaternions `(..., 4)`."""
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    vec = np.asarray(vectors, dtype=np.float64)
    axis = quat[..., :3]
    scalar = quat[..., 3:4]
    twice = 2.0 * np.cross(axis, vec)
    return np.asarray(vec + scalar * twice + np.cross(axis, twice))


def matrix_from_quat(quat_xyzw: ArrayLike) -> FloatArray:
    """Return rotation matrices `(..., 3, 3)` of quaternions `(..., 4)`, which are normalised first."""
    x, y, z, w = np.moveaxis(quat_normalised(quat_xyzw), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_from_matrix(matrix: ArrayLike) -> FloatArray:
    """Return unit quaternions `(..., 4)`, scalar >= 0, of rotation matrices `(..., 3, 3)`."""
    m = np.asarray(matrix, dtype=np.float64)
    quats = [_quat_of_rows(rows) for rows in m.reshape(-1, 3, 3).tolist()]
    return np.array(quats, dtype=np.float64).reshape(*m.shape[:-2], 4)


def _quat_of_rows(rows: list[list[float]]) -> tuple[float, float, float, float]:
    """Return the unit quaternion, scalar >= 0, of the rows of one rotation matrix (Shepperd 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    trace = a + e + i
    squares = (a, e, i, trace)
    largest = squares.index(max(squares)) if trace == trace else 3  # NaN
    # each row is the quaternion times 4 x, 4 y, 4 z or 4 w; the row of the largest component is the most accurate
    x, y, z, w = (
        (1.0 + 2.0 * a - trace, d + b, c + g, h - f),
        (d + b, 1.0 + 2.0 * e - trace, h + f, c - g),
        (c + g, h + f, 1.0 + 2.0 * i - trace, d - b),
        (h - f, c - g, d - b, 1.0 + trace),
    )[largest]
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not MIN_NORM <= norm < math.inf:
        raise GeometryError(NO_LENGTH)
    if w / norm < 0:
        norm = -norm
    return x / norm, y / norm, z / norm, w / norm


def matrix_from_rotvec(rotvec: ArrayLike) -> FloatArray:
    """Return the rotation matrix `(3, 3)` of one rotation vector `(3,)`, radians (Rodrigues)."""
    vec = np.asarray(rotvec, dtype=np.float64)
    half = 0.5 * float(np.sqrt(vec @ vec))
    scale = 0.5 * np.sinc(half / np.pi)
    return matrix_from_quat(np.array([*(scale * vec), np.cos(half)]))


def rotvec_from_matrix(matrix: ArrayLike) -> FloatArray:
    """Return the rotation vector `(3,)`, radians, angle in [0, pi], of one rotation matrix `(3, 3)`."""
    quat = np.array(_quat_of_rows(np.asarray(matrix, dtype=np.float64).tolist()))
    axis = quat[:3]  # times the sine of half the angle
    sine = length(axis)
    if sine < SMALL_HALF_SINE:
        return np.asarray(2.0 * axis)
    return np.asarray(axis * (2.0 * float(np.arctan2(sine, quat[3])) / sine))

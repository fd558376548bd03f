"""Rotations as matrices, scalar-last quaternions and rotation vectors.

Quaternions are `quat_xyzw` everywhere (`q = w + x i + y j + z k`), as in ROS messages and as the source document's
`[q1 q2 q3 q4]` [3.1.1]. All functions take one rotation or a stack of them along the first axis.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray

MIN_NORM: Final = 1e-12
NO_LENGTH: Final = "a quaternion has no length or is not finite: a rotation needs four finite numbers, not all zero"


def quat_normalised(quat_xyzw: ArrayLike) -> FloatArray:
    """Return unit quaternions `(..., 4)`; GeometryError if one has no length or is not finite."""
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    norm = np.sqrt(np.sum(quat * quat, axis=-1, keepdims=True))
    if not np.all(np.isfinite(norm)) or np.any(norm < MIN_NORM):
        raise GeometryError(NO_LENGTH)
    return np.asarray(quat / norm)


def quat_conjugate(quat_xyzw: ArrayLike) -> FloatArray:
    """Return the conjugate `(..., 4)`: the inverse rotation of a unit quaternion, without rounding."""
    quat = np.array(quat_xyzw, dtype=np.float64)
    quat[..., :3] = -quat[..., :3]
    return quat


def quat_multiply(a_xyzw: ArrayLike, b_xyzw: ArrayLike) -> FloatArray:
    """Return the Hamilton product `a b` `(..., 4)`: rotates by b first, then by a."""
    a, b = np.asarray(a_xyzw, dtype=np.float64), np.asarray(b_xyzw, dtype=np.float64)
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


def quat_rotate(quat_xyzw: ArrayLike, vectors: ArrayLike) -> FloatArray:
    """Rotate vectors `(..., 3)` by unit quaternions `(..., 4)`."""
    quat, vec = np.asarray(quat_xyzw, dtype=np.float64), np.asarray(vectors, dtype=np.float64)
    axis, scalar = quat[..., :3], quat[..., 3:4]
    twice = 2.0 * np.cross(axis, vec)
    return np.asarray(vec + scalar * twice + np.cross(axis, twice))


def matrix_from_quat(quat_xyzw: ArrayLike) -> FloatArray:
    """Return rotation matrices `(..., 3, 3)` of quaternions `(..., 4)`, normalised first."""
    quat = np.asarray(quat_xyzw, dtype=np.float64)
    norm = np.sqrt(np.sum(quat * quat, axis=-1))
    if not np.all(np.isfinite(norm)) or np.any(norm < MIN_NORM):
        raise GeometryError(NO_LENGTH)
    x, y, z, w = (quat[..., i] / norm for i in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_from_matrix(matrix: ArrayLike) -> FloatArray:
    """Return unit quaternions `(..., 4)` with scalar >= 0 of rotation matrices `(..., 3, 3)`.

    The largest of the four components is found first and the others divided by it (Shepperd 1978), which keeps
    full precision for every angle, 180 degrees too.
    """
    m = np.asarray(matrix, dtype=np.float64)
    if m.ndim == 2:
        return _quat_from_one_matrix(m)
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    squares = np.stack((m[..., 0, 0], m[..., 1, 1], m[..., 2, 2], trace), axis=-1)
    diagonal = 1.0 + 2.0 * squares - trace[..., None]
    diagonal[..., 3] = 1.0 + trace
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    xw, yw, zw = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    rows = np.stack(
        (
            np.stack((diagonal[..., 0], xy, xz, xw), axis=-1),
            np.stack((xy, diagonal[..., 1], yz, yw), axis=-1),
            np.stack((xz, yz, diagonal[..., 2], zw), axis=-1),
            np.stack((xw, yw, zw, diagonal[..., 3]), axis=-1),
        ),
        axis=-2,
    )
    largest = np.argmax(squares, axis=-1)
    quat = quat_normalised(np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :])
    return np.where(quat[..., 3:4] < 0, -quat, quat)


def _quat_from_one_matrix(matrix: FloatArray) -> FloatArray:
    """Return that of one matrix `(3, 3)`, the same to the last digit and without the cost of small arrays."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    trace = a + e + i
    squares = (a, e, i, trace)
    largest = squares.index(max(squares)) if trace == trace else 3  # NaN
    if largest == 3:
        quat = (h - f, c - g, d - b, 1.0 + trace)
    elif largest == 2:
        quat = (c + g, h + f, 1.0 + 2.0 * i - trace, d - b)
    elif largest == 1:
        quat = (d + b, 1.0 + 2.0 * e - trace, h + f, c - g)
    else:
        quat = (1.0 + 2.0 * a - trace, d + b, c + g, h - f)
    x, y, z, w = quat
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not MIN_NORM <= norm < math.inf:
        raise GeometryError(NO_LENGTH)
    if w / norm < 0:
        norm = -norm
    return np.array((x / norm, y / norm, z / norm, w / norm))


def matrix_from_rotvec(rotvec: ArrayLike) -> FloatArray:
    """Return the rotation matrix `(3, 3)` of one rotation vector `(3,)`, radians (Rodrigues)."""
    vec = np.asarray(rotvec, dtype=np.float64)
    angle = float(np.sqrt(vec @ vec))
    half = 0.5 * angle
    scale = 0.5 * np.sinc(half / np.pi)
    return matrix_from_quat(np.array([*(scale * vec), np.cos(half)]))


def rotvec_from_matrix(matrix: ArrayLike) -> FloatArray:
    """Return the rotation vector `(3,)`, radians, angle in [0, pi], of one rotation matrix `(3, 3)`."""
    quat = _quat_from_one_matrix(np.asarray(matrix, dtype=np.float64))
    sine = float(np.sqrt(quat[:3] @ quat[:3]))
    if sine < 1e-9:
        return np.asarray(2.0 * quat[:3])
    return np.asarray(quat[:3] * (2.0 * np.arctan2(sine, quat[3]) / sine))


def skew(vector: ArrayLike) -> FloatArray:
    """Return the matrix `(3, 3)` for which `skew(a) @ b == cross(a, b)`."""
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

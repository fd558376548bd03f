"""Small matrices inside kernels: rotations and positive definite systems, without calls into LAPACK; a median.

Short loops compile in a second where LAPACK's wrappers take ten, and they run faster at these sizes.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit, jit_fast_ir_inline


@jit
def retract(rotation: FloatArray, x: float, y: float, z: float) -> FloatArray:
    """Return `exp([w]x) @ rotation` `(3, 3)` for a small w = (x, y, z), radians (Rodrigues), made orthonormal."""
    angle2 = x * x + y * y + z * z
    angle = np.sqrt(angle2)
    a = 1.0 - angle2 / 6.0 if angle < 1e-4 else np.sin(angle) / angle
    b = 0.5 - angle2 / 24.0 if angle < 1e-4 else (1.0 - np.cos(angle)) / angle2
    out = np.empty((3, 3))
    for c in range(3):
        p, q, r = rotation[0, c], rotation[1, c], rotation[2, c]
        u, v, w = y * r - z * q, z * p - x * r, x * q - y * p
        out[0, c] = p + a * u + b * (y * w - z * v)
        out[1, c] = q + a * v + b * (z * u - x * w)
        out[2, c] = r + a * w + b * (x * v - y * u)
    # one Newton step of the polar decomposition: R (3 I - R^T R) / 2
    result = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            total = 1.5 * out[i, j]
            for k in range(3):
                gram = out[0, k] * out[0, j] + out[1, k] * out[1, j] + out[2, k] * out[2, j]
                total -= 0.5 * out[i, k] * gram
            result[i, j] = total
    return result


@jit
def cholesky(matrix: FloatArray) -> FloatArray:
    """Return the lower factor L `(n, n)` of a symmetric positive definite matrix; tiny pivots are raised."""
    n = len(matrix)
    lower = np.zeros((n, n))
    for j in range(n):
        for i in range(j, n):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                lower[j, j] = np.sqrt(max(total, 1e-300))
            else:
                lower[i, j] = total / lower[j, j]
    return lower


@jit
def solve(matrix: FloatArray, rhs: FloatArray) -> FloatArray:
    """Return x `(n,)` with `matrix @ x = rhs`, for a symmetric positive definite matrix."""
    n = len(rhs)
    lower = cholesky(matrix)
    x = rhs.copy()
    for i in range(n):
        for k in range(i):
            x[i] -= lower[i, k] * x[k]
        x[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= lower[k, i] * x[k]
        x[i] /= lower[i, i]
    return x


@jit_fast_ir_inline
def fill_inverse_3(s: FloatArray, out: FloatArray) -> None:
    """Fill out `(3, 3)` with the inverse of a symmetric positive definite matrix, without arrays.

    With `A` the first 2 x 2, `b` the rest of the last column and `d` its end, `e = A^-1 b` and `r = d - b^T e` it is
    `A^-1 + e e^T / r`, `-e / r`, `1 / r`.
    """
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[0, 1]
    a00, a01, a11 = s[1, 1] / det, -s[0, 1] / det, s[0, 0] / det
    e0, e1 = a00 * s[0, 2] + a01 * s[1, 2], a01 * s[0, 2] + a11 * s[1, 2]
    last = 1.0 / (s[2, 2] - s[0, 2] * e0 - s[1, 2] * e1)
    out[0, 0], out[0, 1], out[1, 1] = a00 + last * e0 * e0, a01 + last * e0 * e1, a11 + last * e1 * e1
    out[0, 2], out[1, 2], out[2, 2] = -last * e0, -last * e1, last
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@jit_fast_ir_inline
def fill_inverse_4(s: FloatArray, out: FloatArray) -> None:
    """Fill out `(4, 4)` with the inverse of a symmetric positive definite matrix, by blocks of 2 x 2, without arrays.

    With `A`, `B`, `D` the blocks, `E = A^-1 B` and `S = D - B^T E` it is `A^-1 + E S^-1 E^T`, `-E S^-1`, `S^-1`.
    """
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[0, 1]
    a00, a01, a11 = s[1, 1] / det, -s[0, 1] / det, s[0, 0] / det
    e00, e01 = a00 * s[0, 2] + a01 * s[1, 2], a00 * s[0, 3] + a01 * s[1, 3]
    e10, e11 = a01 * s[0, 2] + a11 * s[1, 2], a01 * s[0, 3] + a11 * s[1, 3]
    d00 = s[2, 2] - s[0, 2] * e00 - s[1, 2] * e10
    d01 = s[2, 3] - s[0, 2] * e01 - s[1, 2] * e11
    d11 = s[3, 3] - s[0, 3] * e01 - s[1, 3] * e11
    det = d00 * d11 - d01 * d01
    s00, s01, s11 = d11 / det, -d01 / det, d00 / det
    f00, f01, f10, f11 = e00 * s00 + e01 * s01, e00 * s01 + e01 * s11, e10 * s00 + e11 * s01, e10 * s01 + e11 * s11
    out[0, 0], out[0, 1], out[1, 1] = (
        a00 + f00 * e00 + f01 * e01,
        a01 + f00 * e10 + f01 * e11,
        a11 + f10 * e10 + f11 * e11,
    )
    out[0, 2], out[0, 3], out[1, 2], out[1, 3] = -f00, -f01, -f10, -f11
    out[2, 2], out[2, 3], out[3, 3] = s00, s01, s11
    for i in range(4):
        for j in range(i):
            out[i, j] = out[j, i]


@jit
def reorder_to_rank(values: FloatArray, rank: int) -> float:
    """Return the number of a rank, from 0, of numbers `(N,)`, none NaN, and put those below before it."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[rank], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        low = i if j < rank else low
        high = j if rank < i else high
    return float(values[rank])


@jit
def reorder_to_median(values: FloatArray) -> float:
    """Return the median of numbers `(N,)`, at least one and none NaN, in kernels; numba's own takes 2 s to compile."""
    half = len(values) // 2
    middle = reorder_to_rank(values, half)
    if len(values) % 2:
        return middle
    below = values[0]
    for i in range(half):
        below = max(below, values[i])
    return float((below + middle) / 2.0)


@jit
def copy_row(row: FloatArray | FloatImage, out: FloatArray | FloatImage) -> None:
    """Copy numbers `(N,)`. For `out[:] = row` the text of an error message would be compiled too, for 2.5 s."""
    for column in range(len(row)):
        out[column] = row[column]

"""Kernels for small matrices without LAPACK (rotations, positive definite systems), and order statistics.

The loops compile in 1 s, compared with 10 s for calls of LAPACK, and run faster for matrices of these sizes.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit, jit_fast_ir_inline, jit_inline

SMALL_ANGLE = 1e-4  #: Angle, rad, below which series of sine and cosine are used, exact to 1e-16.
MIN_PIVOT = 1e-300  #: Minimum square of a diagonal element of a Cholesky factor, which must be positive.


@jit
def retract(rotation: FloatArray, x: float, y: float, z: float) -> FloatArray:
    """Return `exp([w]x) @ rotation` `(3, 3)` for a rotation vector w = (x, y, z), radians, made orthonormal.

    The exponential is Rodrigues' formula `I + a [w]x + b [w]x^2` with `a = sin |w| / |w|`, `b = (1 - cos |w|) / |w|^2`.
    """
    angle2 = x * x + y * y + z * z
    angle = np.sqrt(angle2)
    a = 1.0 - angle2 / 6.0 if angle < SMALL_ANGLE else np.sin(angle) / angle
    b = 0.5 - angle2 / 24.0 if angle < SMALL_ANGLE else (1.0 - np.cos(angle)) / angle2
    rotated = np.empty((3, 3))
    for c in range(3):
        p = rotation[0, c]
        q = rotation[1, c]
        r = rotation[2, c]
        u = y * r - z * q
        v = z * p - x * r
        w = x * q - y * p
        rotated[0, c] = p + a * u + b * (y * w - z * v)
        rotated[1, c] = q + a * v + b * (z * u - x * w)
        rotated[2, c] = r + a * w + b * (x * v - y * u)
    # One Newton step of the polar decomposition: R (3 I - R^T R) / 2 (Higham 2008, chapter 8).
    orthonormal = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            total = 1.5 * rotated[i, j]
            for k in range(3):
                gram = rotated[0, k] * rotated[0, j] + rotated[1, k] * rotated[1, j] + rotated[2, k] * rotated[2, j]
                total -= 0.5 * rotated[i, k] * gram
            orthonormal[i, j] = total
    return orthonormal


@jit_inline
def _less_factored(matrix: FloatArray, lower: FloatArray, i: int, j: int) -> float:
    """Return an element of a matrix less the product of its factored columns: that of `L L^T` in column j or later."""
    total = matrix[i, j]
    for k in range(j):
        total -= lower[i, k] * lower[j, k]
    return float(total)


@jit
def cholesky(matrix: FloatArray) -> FloatArray:
    """Return the lower factor L `(n, n)` of a symmetric positive definite matrix. Pivots are at least `MIN_PIVOT`."""
    n = len(matrix)
    lower = np.zeros((n, n))
    for j in range(n):
        for i in range(j, n):
            total = _less_factored(matrix, lower, i, j)
            if i == j:
                lower[j, j] = np.sqrt(max(total, MIN_PIVOT))
            else:
                lower[i, j] = total / lower[j, j]
    return lower


@jit
def is_positive_definite(matrix: FloatArray) -> bool:
    """Return whether a symmetric matrix `(n, n)` is finite and positive definite: it has a Cholesky factor."""
    n = len(matrix)
    lower = np.zeros((n, n))
    for j in range(n):
        for i in range(j, n):
            total = _less_factored(matrix, lower, i, j)
            if i > j:
                lower[i, j] = total / lower[j, j]
            elif 0.0 < total < np.inf:  # False for NaN
                lower[j, j] = np.sqrt(total)
            else:
                return False
    return True


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
    """Fill `out` `(3, 3)` with the inverse of a symmetric positive definite matrix, by blocks.

    `A` is the first 2 x 2 block, `b` is the rest of the last column, and `d` is the last element. With `e = A^-1 b` and
    `r = d - b^T e`, the blocks of the inverse are `A^-1 + e e^T / r`, `-e / r` and `1 / r`.
    """
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[0, 1]
    a00 = s[1, 1] / det
    a01 = -s[0, 1] / det
    a11 = s[0, 0] / det
    e0 = a00 * s[0, 2] + a01 * s[1, 2]
    e1 = a01 * s[0, 2] + a11 * s[1, 2]
    last = 1.0 / (s[2, 2] - s[0, 2] * e0 - s[1, 2] * e1)
    out[0, 0] = a00 + last * e0 * e0
    out[0, 1] = a01 + last * e0 * e1
    out[1, 1] = a11 + last * e1 * e1
    out[0, 2] = -last * e0
    out[1, 2] = -last * e1
    out[2, 2] = last
    out[1, 0] = out[0, 1]
    out[2, 0] = out[0, 2]
    out[2, 1] = out[1, 2]


@jit_fast_ir_inline
def fill_inverse_4(s: FloatArray, out: FloatArray) -> None:
    """Fill `out` `(4, 4)` with the inverse of a symmetric positive definite matrix, by blocks of 2 x 2.

    With the blocks `A`, `B`, `D`, `E = A^-1 B` and the Schur complement `S = D - B^T E`, the blocks of the inverse are
    `A^-1 + E S^-1 E^T`, `-E S^-1` and `S^-1`. `F` is `E S^-1`.
    """
    det = s[0, 0] * s[1, 1] - s[0, 1] * s[0, 1]
    a00 = s[1, 1] / det
    a01 = -s[0, 1] / det
    a11 = s[0, 0] / det
    e00 = a00 * s[0, 2] + a01 * s[1, 2]
    e01 = a00 * s[0, 3] + a01 * s[1, 3]
    e10 = a01 * s[0, 2] + a11 * s[1, 2]
    e11 = a01 * s[0, 3] + a11 * s[1, 3]
    d00 = s[2, 2] - s[0, 2] * e00 - s[1, 2] * e10
    d01 = s[2, 3] - s[0, 2] * e01 - s[1, 2] * e11
    d11 = s[3, 3] - s[0, 3] * e01 - s[1, 3] * e11
    det_d = d00 * d11 - d01 * d01
    s00 = d11 / det_d
    s01 = -d01 / det_d
    s11 = d00 / det_d
    f00 = e00 * s00 + e01 * s01
    f01 = e00 * s01 + e01 * s11
    f10 = e10 * s00 + e11 * s01
    f11 = e10 * s01 + e11 * s11
    out[0, 0] = a00 + f00 * e00 + f01 * e01
    out[0, 1] = a01 + f00 * e10 + f01 * e11
    out[1, 1] = a11 + f10 * e10 + f11 * e11
    out[0, 2] = -f00
    out[0, 3] = -f01
    out[1, 2] = -f10
    out[1, 3] = -f11
    out[2, 2] = s00
    out[2, 3] = s01
    out[3, 3] = s11
    for i in range(4):
        for j in range(i):
            out[i, j] = out[j, i]


@jit
def reorder_to_rank(values: FloatArray, rank: int) -> float:
    """Return the value at a rank (0 is the smallest) of numbers `(N,)` without NaN; partition them (Hoare 1961)."""
    low = 0
    high = len(values) - 1
    while low < high:
        pivot = values[rank]
        i = low
        j = high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < rank:
            low = i
        if rank < i:
            high = j
    return float(values[rank])


@jit
def reorder_to_median(values: FloatArray) -> float:
    """Return the median of at least one number `(N,)` without NaN, and reorder the numbers.

    The result equals `geometry.arrays.median`. The median of numba takes 2 s to compile.
    """
    half = len(values) // 2
    middle = reorder_to_rank(values, half)
    if len(values) % 2:
        return middle
    below = values[0]
    for i in range(half):
        below = max(below, values[i])
    return float((below + middle) / 2.0)


@jit
def median_without_nan(values: FloatArray) -> float:
    """Return the median of the numbers `(N,)` that are not NaN; NaN if there are none."""
    numbers = np.empty(len(values))
    count = 0
    for value in values:
        if not np.isnan(value):
            numbers[count] = value
            count += 1
    return reorder_to_median(numbers[:count]) if count else np.nan


@jit
def copy_row(row: FloatArray | FloatImage, out: FloatArray | FloatImage) -> None:
    """Copy numbers `(N,)`. With `out[:] = row`, numba also compiles an error message, which takes 2.5 s."""
    for column in range(len(row)):
        out[column] = row[column]

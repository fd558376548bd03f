"""Interpolation of images along rows and columns."""

from __future__ import annotations

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline


@jit_rows_inline
def linear(p0: np.float32, p1: np.float32, t: np.float32) -> np.float32:
    """Interpolate linearly between p0 (t = 0) and p1 (t = 1)."""
    value: np.float32 = p0 + t * (p1 - p0)
    return value


@jit_rows_inline
def cubic(p0: np.float32, p1: np.float32, p2: np.float32, p3: np.float32, t: np.float32) -> np.float32:
    """Interpolate between p1 (t = 0) and p2 (t = 1) by cubic convolution (Keys 1981, a = -0.5)."""
    third = t * (F(3.0) * (p1 - p2) + p3 - p0)
    second = t * (F(2.0) * p0 - F(5.0) * p1 + F(4.0) * p2 - p3 + third)
    value: np.float32 = p1 + F(0.5) * t * (p2 - p0 + second)
    return value


@jit_rows
def shift_rows(image: FloatImage, shift: FloatImage) -> FloatImage:
    """Return the image at rows `v + shift`, with `shift` `(H, W)` in pixels; the border is repeated."""
    rows, cols = image.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            v = min(max(F(y) + shift[y, x], F(0.0)), F(rows - 1))
            k = int(v)
            p0 = image[max(k - 1, 0), x]
            p1 = image[k, x]
            p2 = image[min(k + 1, rows - 1), x]
            p3 = image[min(k + 2, rows - 1), x]
            out[y, x] = cubic(p0, p1, p2, p3, v - F(k))
    return out

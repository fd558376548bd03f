"""The photometric residual: the warped right image minus the left image, in grey levels."""

from __future__ import annotations

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline


@jit_rows_inline
def cubic(p0: np.float32, p1: np.float32, p2: np.float32, p3: np.float32, t: np.float32) -> np.float32:
    """Interpolate between p1 (t = 0) and p2 (t = 1) by cubic convolution (Keys 1981, a = -0.5)."""
    third = t * (F(3.0) * (p1 - p2) + p3 - p0)
    second = t * (F(2.0) * p0 - F(5.0) * p1 + F(4.0) * p2 - p3 + third)
    value: np.float32 = p1 + F(0.5) * t * (p2 - p0 + second)
    return value


@jit_rows
def photometric_residual(left: FloatImage, right: FloatImage, disparity: FloatImage) -> FloatImage:
    """Return the right image at `u - d` minus the left image `(H, W)`, grey levels; NaN outside the right image.

    The values are gathered before they are interpolated, so that the compiler vectorises the interpolation of a row.
    """
    rows, cols = left.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        shift = disparity[y]
        grey = left[y]
        source = right[y]
        values = out[y]
        parts = np.empty((5, cols), F)
        p0 = parts[0]
        p1 = parts[1]
        p2 = parts[2]
        p3 = parts[3]
        fraction = parts[4]
        whole = np.empty(cols, np.int32)
        padded = np.empty(cols + 3, F)
        padded[0] = source[0]
        for x in range(cols):
            padded[x + 1] = source[x]
        padded[cols + 1] = source[cols - 1]
        padded[cols + 2] = source[cols - 1]
        for x in range(cols):
            u = F(x) - shift[x]
            fraction[x] = u if u >= F(0.0) and u <= F(cols - 1) else F(np.nan)
            whole[x] = np.int32(F(0.0) if np.isnan(fraction[x]) else fraction[x])
            fraction[x] -= F(whole[x])
        for x in range(cols):
            k = np.uint32(whole[x])
            p0[x] = padded[k]
            p1[x] = padded[k + np.uint32(1)]
            p2[x] = padded[k + np.uint32(2)]
            p3[x] = padded[k + np.uint32(3)]
        for x in range(cols):
            values[x] = cubic(p0[x], p1[x], p2[x], p3[x], fraction[x]) - grey[x]
    return out

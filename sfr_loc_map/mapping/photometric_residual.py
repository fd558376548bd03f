"""What the pictures say of the disparity: residuals, brightness, and normal equations."""

from __future__ import annotations

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32

DERIVATIVE_NEAR = F(0.5 * (1.0 - 2.0 * 0.1065))
DERIVATIVE_FAR = F(0.5 * 0.1065)
SMOOTH_SIDE = F(0.1065)
"""Taps of a central difference after a Gaussian of 0.5 pixels, `exp(-2) / (1 + 2 exp(-2))` at one pixel."""


@jit_rows
def residual_of(left: FloatImage, right: FloatImage, disparity: FloatImage) -> FloatImage:
    """Return the right picture at `u - d` (Keys 1981, a = -0.5) minus the left one; NaN outside the right picture."""
    rows, cols = left.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            place = F(x) - disparity[y, x]
            if not (place >= 0 and place <= cols - 1):
                out[y, x] = F(np.nan)
                continue
            k = int(place)
            t = place - F(k)
            p0, p1 = right[y, max(k - 1, 0)], right[y, k]
            p2, p3 = right[y, min(k + 1, cols - 1)], right[y, min(k + 2, cols - 1)]
            cubic = t * (F(3.0) * (p1 - p2) + p3 - p0)
            square = t * (F(2.0) * p0 - F(5.0) * p1 + F(4.0) * p2 - p3 + cubic)
            out[y, x] = p1 + F(0.5) * t * (p2 - p0 + square) - left[y, x]
    return out


@jit_rows
def rows_shifted(image: FloatImage, shift: FloatImage) -> FloatImage:
    """Return the picture at `v + shift` (Keys 1981, a = -0.5), `shift` `(H, W)` in pixels."""
    rows, cols = image.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            place = min(max(F(y) + shift[y, x], F(0.0)), F(rows - 1))
            k = int(place)
            t = place - F(k)
            p0, p1 = image[max(k - 1, 0), x], image[k, x]
            p2, p3 = image[min(k + 1, rows - 1), x], image[min(k + 2, rows - 1), x]
            cubic = t * (F(3.0) * (p1 - p2) + p3 - p0)
            square = t * (F(2.0) * p0 - F(5.0) * p1 + F(4.0) * p2 - p3 + cubic)
            out[y, x] = p1 + F(0.5) * t * (p2 - p0 + square)
    return out


@jit_rows
def cell_means(residual: FloatImage, limit: np.float32) -> FloatImage:
    """Return the mean of each cell's residuals, clipped to `limit`; 0 where there are none."""
    rows, cols = residual.shape[0] // 2, residual.shape[1] // 2
    out = np.empty((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            total, count = F(0.0), F(0.0)
            for k in range(4):
                value = residual[2 * i + k // 2, 2 * j + k % 2]
                if value == value:
                    total += min(max(value, -limit), limit)
                    count += F(1.0)
            out[i, j] = total / max(count, F(1.0))
    return out


@jit_rows
def template_of(left: FloatImage, residual: FloatImage, offset: FloatImage, limit: np.float32) -> FloatImage:
    """Return the mean of the left and the warped right picture, brightness offset removed; left where they differ."""
    rows, cols = left.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            value = residual[y, x] - offset[y // 2, x // 2]
            out[y, x] = left[y, x] + (F(0.5) * value if abs(value) < limit else F(0.0))
    return out


@jit_rows_inline
def _slope(picture: FloatImage, y: int, x: int) -> np.float32:
    near: np.float32 = picture[y, x + 1] - picture[y, x - 1]
    far: np.float32 = picture[y, x + 2] - picture[y, x - 2]
    return DERIVATIVE_NEAR * near + DERIVATIVE_FAR * far


@jit_rows
def normal_equations(
    template: FloatImage,
    residual: FloatImage,
    offset: FloatImage,
    inverse_variance: FloatImage,
    tail: np.float32,
    out: FloatImage,
) -> None:
    """Sum each cell's normal equations of a shift in disparity (Lucas and Kanade 1981), robustly weighted.

    `r(d + s) = r(d) - g s` with g the slope along the row; weight `1 / (1 + tail e^2 / variance)`.

    Args:
        template: `(H, W)`, whose slope is g.
        residual: `(H, W)`, NaN where the partner lies outside.
        offset: `(H/2, W/2)`, brightness offset of the residual.
        inverse_variance: `(H/2, W/2)` of a residual.
        tail: How soon large residuals lose weight.
        out: `(4, H/2, W/2)`, filled: sums of `w g^2 / var`, `w g r / var`, `w r^2 / var` and `w`.
    """
    height, width = template.shape
    for i in prange(height // 2):
        for j in range(width // 2):
            hessian, gradient, square, weight_sum = F(0.0), F(0.0), F(0.0), F(0.0)
            inverse, mean = inverse_variance[i, j], offset[i, j]
            for k in range(4):
                y, x = 2 * i + k // 2, 2 * j + k % 2
                value = residual[y, x] - mean
                if value != value or x < 2 or x >= width - 2:
                    continue
                above, below = max(y - 1, 0), min(y + 1, height - 1)
                slope = (F(1.0) - F(2.0) * SMOOTH_SIDE) * _slope(template, y, x)
                slope += SMOOTH_SIDE * (_slope(template, above, x) + _slope(template, below, x))
                level = value * value * inverse
                weight = F(1.0) / (F(1.0) + tail * level)
                hessian += weight * slope * slope
                gradient += weight * slope * value
                square += weight * level
                weight_sum += weight
            out[0, i, j] = hessian * inverse
            out[1, i, j] = gradient * inverse
            out[2, i, j] = square
            out[3, i, j] = weight_sum

"""The data term of the refinement: means of residuals, slopes, and normal equations."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.jit import jit_rows, jit_rows_inline

SMOOTHING_PX = 0.5  #: Standard deviation of the Gaussian that smooths slopes, pixels.
_SIDE = math.exp(-0.5 / SMOOTHING_PX**2) / (1.0 + 2.0 * math.exp(-0.5 / SMOOTHING_PX**2))
SMOOTHING_SIDE = F(_SIDE)  #: Side tap of that Gaussian over three pixels.
SMOOTHING_CENTRE = F(1.0 - 2.0 * _SIDE)  #: Centre tap of that Gaussian.
DERIVATIVE_NEAR = F(0.5 * (1.0 - 2.0 * _SIDE))  #: Tap at an offset of 1 px: that Gaussian, then a central difference.
DERIVATIVE_FAR = F(0.5 * _SIDE)  #: Tap at an offset of 2 px.
SLOPE_NOISE_GAIN = float(
    (SMOOTHING_CENTRE**2 + 2.0 * SMOOTHING_SIDE**2) * 2.0 * (DERIVATIVE_NEAR**2 + DERIVATIVE_FAR**2)
)
"""Ratio of the variance of a slope to the variance of white noise in the image: the sum of squares of all taps."""
SLOPE_BORDER = 2  #: Number of columns without a slope at either border: the smoothed central difference has five taps.


class NormalEquations(NamedTuple):
    """Normal equations of a change in disparity, `(H/2, W/2)` float32 each; `var` is the variance of a residual."""

    information: FloatImage  #: Sum of `w g^2 / var`, 1 / px^2.
    information_vector: FloatImage  #: Sum of `w g r / var`, 1 / px: information times the least squares change.
    chi2: FloatImage  #: Sum of `w r^2 / var`.
    weight: FloatImage  #: Sum of the robust weights w.


@jit_rows
def cell_means(residual: FloatImage, limit: np.float32) -> FloatImage:
    """Return the mean of each cell's residuals, each clipped to `limit`; 0 without residuals."""
    rows = residual.shape[0] // 2
    cols = residual.shape[1] // 2
    out = np.empty((rows, cols), F)
    for i in prange(rows):
        for j in range(cols):
            total = F(0.0)
            count = F(0.0)
            for k in range(4):
                value = residual[2 * i + k // 2, 2 * j + k % 2]
                if not np.isnan(value):
                    total += min(max(value, -limit), limit)
                    count += F(1.0)
            out[i, j] = total / max(count, F(1.0))
    return out


@jit_rows
def mean_template(left: FloatImage, residual: FloatImage, offset: FloatImage, limit: np.float32) -> FloatImage:
    """Return the mean of the left image and the warped right image without its brightness offset.

    Where the residual without this offset is unknown, or its magnitude is `limit` or larger, the template is the left
    image.
    """
    rows, cols = left.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            value = residual[y, x] - offset[y // 2, x // 2]
            out[y, x] = left[y, x] + (F(0.5) * value if abs(value) < limit else F(0.0))
    return out


@jit_rows_inline
def _slope(row: FloatImage, n: int) -> np.float32:
    """Return the slope of a row at `n + SLOPE_BORDER`."""
    near: np.float32 = row[n + 3] - row[n + 1]
    far: np.float32 = row[n + 4] - row[n]
    return DERIVATIVE_NEAR * near + DERIVATIVE_FAR * far


@jit_rows
def slopes(template: FloatImage) -> FloatImage:
    """Return the slope along rows `(H, W)`, smoothed across rows, grey levels per pixel; 0 in the border columns."""
    rows, cols = template.shape
    out = np.zeros((rows, cols), F)
    for y in prange(rows):
        above = template[max(y - 1, 0)]
        row = template[y]
        below = template[min(y + 1, rows - 1)]
        for n in range(cols - 2 * SLOPE_BORDER):
            slope = SMOOTHING_CENTRE * _slope(row, n)
            out[y, n + SLOPE_BORDER] = slope + SMOOTHING_SIDE * (_slope(above, n) + _slope(below, n))
    return out


@jit_rows
def normal_equations(
    slope: FloatImage, residual: FloatImage, offset: FloatImage, inverse_variance: FloatImage, robust_factor: np.float32
) -> NormalEquations:
    """Return each cell's normal equations of a change in disparity (Lucas and Kanade 1981), robustly weighted.

    `r(d + s) = r(d) - g s` with g the slope along the row. The weight is `1 / (1 + robust_factor r^2 / variance)`.
    Columns without a slope are excluded.

    Slope and residual are `(H, W)`. The brightness offset and the inverse variance of the residual are `(H/2, W/2)`.
    """
    height, width = slope.shape
    information = np.empty((height // 2, width // 2), F)
    information_vector = np.empty_like(information)
    chi2 = np.empty_like(information)
    weights = np.empty_like(information)
    for i in prange(height // 2):
        for j in range(width // 2):
            slope_squares = F(0.0)
            slope_residuals = F(0.0)
            squares = F(0.0)
            weight_sum = F(0.0)
            inverse = inverse_variance[i, j]
            mean = offset[i, j]
            for k in range(4):
                y = 2 * i + k // 2
                x = 2 * j + k % 2
                value = residual[y, x] - mean
                if np.isnan(value) or x < SLOPE_BORDER or x >= width - SLOPE_BORDER:
                    continue
                g = slope[y, x]
                normalised = value * value * inverse
                weight = F(1.0) / (F(1.0) + robust_factor * normalised)
                slope_squares += weight * g * g
                slope_residuals += weight * g * value
                squares += weight * normalised
                weight_sum += weight
            information[i, j] = slope_squares * inverse
            information_vector[i, j] = slope_residuals * inverse
            chi2[i, j] = squares
            weights[i, j] = weight_sum
    return NormalEquations(information, information_vector, chi2, weights)

"""The data term: residuals of the warped right image, their noise, and the normal equations of each cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import FloatImage, IntArray, median
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.filters import MAD_TO_SIGMA, mad_sigma

F = np.float32

DERIVATIVE_NEAR = F(0.5 * (1.0 - 2.0 * 0.1065))
DERIVATIVE_FAR = F(0.5 * 0.1065)
SMOOTH_SIDE = F(0.1065)
"""Taps of a central difference after a Gaussian of 0.5 pixels, `exp(-2) / (1 + 2 exp(-2))` at one pixel."""
ROUNDING_NOISE = 0.3  #: Standard deviation that rounding alone gives a residual, about, in steps of the grey levels.
DEFAULT_VARIANCE = F(25.0)  #: Grey levels squared, where too few residuals are known to measure it.
BINS, MIN_PER_BIN = 8, 50


class NormalEquations(NamedTuple):
    """Normal equations of a change in disparity, `(H/2, W/2)` float32 each."""

    information: FloatImage  # sum of `w g^2 / var`, 1 / pixels^2
    information_vector: FloatImage  # sum of `w g r / var`, 1 / pixels: information times the least squares change
    chi2: FloatImage  # sum of `w r^2 / var`
    weight: FloatImage  # sum of the robust weights w


@jit_rows_inline
def _cubic(p0: np.float32, p1: np.float32, p2: np.float32, p3: np.float32, t: np.float32) -> np.float32:
    """Interpolate at `t` between p1 (0) and p2 (1) (Keys 1981, a = -0.5)."""
    cubic = t * (F(3.0) * (p1 - p2) + p3 - p0)
    square = t * (F(2.0) * p0 - F(5.0) * p1 + F(4.0) * p2 - p3 + cubic)
    value: np.float32 = p1 + F(0.5) * t * (p2 - p0 + square)
    return value


@jit_rows
def photometric_residual(left: FloatImage, right: FloatImage, disparity: FloatImage) -> FloatImage:
    """Return the right image at `u - d` minus the left one `(H, W)`, grey levels; NaN outside the right image.

    What is read from computed places is gathered first, and the pixels of a row are computed side by side then.
    """
    rows, cols = left.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        shift, grey, source, values = disparity[y], left[y], right[y], out[y]
        parts = np.empty((5, cols), F)
        p0, p1, p2, p3, share = parts[0], parts[1], parts[2], parts[3], parts[4]
        before, row = np.empty(cols, np.int32), np.empty(cols + 3, F)
        for x in range(cols):
            row[x + 1] = source[x]
        row[0], row[cols + 1], row[cols + 2] = source[0], source[cols - 1], source[cols - 1]
        for x in range(cols):
            u = F(x) - shift[x]
            share[x] = u if u >= F(0.0) and u <= F(cols - 1) else F(np.nan)
            before[x] = np.int32(share[x] if share[x] == share[x] else F(0.0))
            share[x] -= F(before[x])
        for x in range(cols):
            k = np.uint32(before[x])
            p0[x], p1[x], p2[x], p3[x] = row[k], row[k + np.uint32(1)], row[k + np.uint32(2)], row[k + np.uint32(3)]
        for x in range(cols):
            values[x] = _cubic(p0[x], p1[x], p2[x], p3[x], share[x]) - grey[x]
    return out


@jit_rows
def shift_rows(image: FloatImage, shift: FloatImage) -> FloatImage:
    """Return the image at `v + shift`, `shift` `(H, W)` in pixels; the border is repeated."""
    rows, cols = image.shape
    out = np.empty((rows, cols), F)
    for y in prange(rows):
        for x in range(cols):
            v = min(max(F(y) + shift[y, x], F(0.0)), F(rows - 1))
            k = int(v)
            p0, p1 = image[max(k - 1, 0), x], image[k, x]
            p2, p3 = image[min(k + 1, rows - 1), x], image[min(k + 2, rows - 1), x]
            out[y, x] = _cubic(p0, p1, p2, p3, v - F(k))
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
def mean_template(left: FloatImage, residual: FloatImage, offset: FloatImage, limit: np.float32) -> FloatImage:
    """Return the mean of the left and the warped right image, brightness offset removed.

    It is the left image alone where the two differ by `limit` or more.
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
    near: np.float32 = row[n + 3] - row[n + 1]
    far: np.float32 = row[n + 4] - row[n]
    return DERIVATIVE_NEAR * near + DERIVATIVE_FAR * far


@jit_rows
def slopes(template: FloatImage) -> FloatImage:
    """Return the slope along the row, smoothed across rows `(H, W)`, grey levels a pixel; 0 in two border columns."""
    rows, cols = template.shape
    out = np.zeros((rows, cols), F)
    for y in prange(rows):
        above, row, below = template[max(y - 1, 0)], template[y], template[min(y + 1, rows - 1)]
        for n in range(cols - 4):
            slope = (F(1.0) - F(2.0) * SMOOTH_SIDE) * _slope(row, n)
            out[y, n + 2] = slope + SMOOTH_SIDE * (_slope(above, n) + _slope(below, n))
    return out


@jit_rows
def normal_equations(
    slope: FloatImage, residual: FloatImage, offset: FloatImage, inverse_variance: FloatImage, tail: np.float32
) -> NormalEquations:
    """Return each cell's normal equations of a change in disparity (Lucas and Kanade 1981), robustly weighted.

    `r(d + s) = r(d) - g s` with g the slope along the row; weight `1 / (1 + tail r^2 / variance)`. Two columns at
    either border do not count.

    Slope and residual are `(H, W)`, the residual's brightness offset and inverse variance `(H/2, W/2)`.
    """
    height, width = slope.shape
    information = np.empty((height // 2, width // 2), F)
    information_vector, chi2 = np.empty_like(information), np.empty_like(information)
    weights = np.empty_like(information)
    for i in prange(height // 2):
        for j in range(width // 2):
            hessian, gradient, square, weight_sum = F(0.0), F(0.0), F(0.0), F(0.0)
            inverse, mean = inverse_variance[i, j], offset[i, j]
            for k in range(4):
                y, x = 2 * i + k // 2, 2 * j + k % 2
                value = residual[y, x] - mean
                if value != value or x < 2 or x >= width - 2:
                    continue
                g = slope[y, x]
                level = value * value * inverse
                weight = F(1.0) / (F(1.0) + tail * level)
                hessian += weight * g * g
                gradient += weight * g * value
                square += weight * level
                weight_sum += weight
            information[i, j] = hessian * inverse
            information_vector[i, j] = gradient * inverse
            chi2[i, j] = square
            weights[i, j] = weight_sum
    return NormalEquations(information, information_vector, chi2, weights)


def rounding_noise(image: FloatImage) -> float:
    """Return the standard deviation that the steps between an image's grey levels give a residual, grey levels."""
    steps = np.diff(np.unique(image[::4, ::4]))
    return ROUNDING_NOISE * median(steps) if len(steps) else ROUNDING_NOISE


def overall_noise(residual: FloatImage, least: float) -> float:
    """Return the robust standard deviation of a residual `(H, W)`, grey levels, at least `least`."""
    sample = residual[::8, ::4]
    sample = sample[np.isfinite(sample)]
    return max(mad_sigma(sample - median(sample)), least) if len(sample) else least


def noise_variance(
    grey: FloatImage, order: IntArray, residual: FloatImage, offset: FloatImage, least: float
) -> FloatImage:
    """Return the variance of a residual in each cell `(H/2, W/2)`: the best straight line over the grey level.

    A camera's noise has a constant part and one that grows with the light (photon noise). The grey level is the mean of
    the left image in each cell; the order sorts every second one of every fourth row by it: all residuals of a pair
    share it. The residual `(H, W)` is NaN where unknown, and has a brightness offset `(H/2, W/2)`.
    """
    deviation = np.abs(residual[::8, ::4] - offset[::4, ::2]).ravel()
    order = order[np.isfinite(deviation)[order]]
    level, deviation = grey[::4, ::2].ravel()[order], deviation[order]
    if len(level) < BINS * MIN_PER_BIN:
        return np.full(offset.shape, DEFAULT_VARIANCE, F)
    centre = np.array([part.mean() for part in np.array_split(level, BINS)], np.float64)
    variance = np.array([(MAD_TO_SIGMA * median(part)) ** 2 for part in np.array_split(deviation, BINS)])
    variance = np.maximum(variance, least**2)
    weight = 1.0 / np.square(variance)
    middle = np.average(centre, weights=weight)
    spread = float(np.average(np.square(centre - middle), weights=weight))
    mean = float(np.average(variance, weights=weight))
    slope = float(np.average((centre - middle) * (variance - mean), weights=weight)) / max(spread, 1.0)
    model = grey - F(middle)
    model *= F(slope)
    model += F(mean)
    return np.clip(model, F(variance.min()), F(variance.max()), out=model)

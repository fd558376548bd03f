"""Slopes of the planes of single patches, from the right image.

A plane fitted to neighbours is that of the patch only where they are near. Position and slopes of a patch in the right
image are estimated together, by Gauss-Newton on the difference of the two patches, each normalised to the same mean
and contrast; derivatives are those of the left patch (Baker and Matthews 2004). The plane of the neighbours is a prior:
a patch without texture along one direction keeps its slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.small_linalg import fill_inverse_4
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.patch import (
    MIN_POWER,
    Patch,
    PatchPixels,
    half_width,
    normalise,
    patch_pixels,
    sample,
)

PRIOR_SIGMA = 0.05
"""Standard deviation of a slope as the neighbours give it, pixels of disparity per pixel."""
MIN_SQUARE = 1.0
"""Smallest mean squared residual that counts, grey levels squared: pixels are whole grey levels."""
ITERATIONS = 5
MAX_SHIFT_PX, MAX_SLOPE = 1.0, 0.7
"""A patch that moves farther, or becomes steeper, keeps its slopes."""
FINISHED_PX = 0.01
"""Largest movement of a pixel of the patch below which no further iteration follows."""


class _Plane(NamedTuple):
    """Centre of a patch in the right image, pixels, and its slopes."""

    x: float
    y: float
    along_u: float
    along_v: float


class _Workspace(NamedTuple):
    """Arrays that all patches share.

    Attributes:
        pixels: Pixels of the left patch.
        columns: `(5, S * S)` grey levels and derivatives by the four unknowns.
        normal: `(4, 4)` normal matrix of the derivatives.
        damped: `(4, 4)` the same with the prior.
        inverse: `(4, 4)` its inverse.
        products: `(4,)` products of the derivatives with the right image.
    """

    pixels: PatchPixels
    columns: Patch
    normal: FloatArray
    damped: FloatArray
    inverse: FloatArray
    products: FloatArray


@jit_fast_inline
def _fill_columns(patch: Patch, start: _Plane, work: _Workspace) -> float:
    """Fill grey levels and derivatives; return the power of the grey levels.

    Derivatives are left without their mean and without what a change of contrast explains.
    """
    columns, pixels, size = work.columns, work.pixels, work.pixels.columns.size
    for k in range(size):
        by_x = patch[1, k] / np.float32(1.0 - start.along_u)
        columns[0, k], columns[1, k], columns[2, k] = patch[0, k], by_x, patch[2, k] + np.float32(start.along_v) * by_x
        columns[3, k], columns[4, k] = -pixels.columns[k] * by_x, -pixels.rows[k] * by_x
    power = normalise(columns[0])
    if power < MIN_POWER:
        return float(power)
    for c in range(1, 5):
        normalise(columns[c])
        share = np.float32(0.0)
        for k in range(size):
            share += columns[0, k] * columns[c, k]
        share /= power
        for k in range(size):
            columns[c, k] -= share * columns[0, k]
    return float(power)


@jit_fast_inline
def _fill_normal(work: _Workspace) -> bool:
    """Fill the normal matrix; tell whether it gives a position."""
    columns, normal = work.columns, work.normal
    for a in range(4):
        for b in range(a, 4):
            total = np.float32(0.0)
            for k in range(columns.shape[1]):
                total += columns[1 + a, k] * columns[1 + b, k]
            normal[a, b] = normal[b, a] = total
    det = normal[0, 0] * normal[1, 1] - normal[0, 1] * normal[0, 1]
    return bool(det > 1e-6 * (normal[0, 0] + normal[1, 1]) ** 2)


@jit_fast_inline
def _compare(image: FloatImage, at: _Plane, power: float, work: _Workspace) -> float:
    """Fill the products; return the mean squared residual, grey levels squared, NaN where there is nothing."""
    columns, pixels, products = work.columns, work.pixels, work.products
    size, half = pixels.columns.size, half_width(pixels.columns.size)
    reach, (height, width) = half * (abs(1.0 - at.along_u) + abs(at.along_v)), image.shape
    if at.x < reach or at.x + reach >= width - 1.001 or at.y < half or at.y + half >= height - 1.001:
        return np.nan
    x, y, along_u, along_v = np.float32(at.x), np.float32(at.y), np.float32(1.0 - at.along_u), np.float32(at.along_v)
    level = sample(image, x, y)
    total, squares, grey = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    p0, p1, p2, p3 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(size):
        i, j = pixels.columns[k], pixels.rows[k]
        value = sample(image, x + along_u * i - along_v * j, y + j) - level
        total += value
        squares += value * value
        grey += columns[0, k] * value
        p0 += columns[1, k] * value
        p1 += columns[2, k] * value
        p2 += columns[3, k] * value
        p3 += columns[4, k] * value
    own = squares - total * total / np.float32(size)
    if own < MIN_POWER:
        return np.nan
    gain = np.sqrt(power / own)
    products[0], products[1], products[2], products[3] = gain * p0, gain * p1, gain * p2, gain * p3
    return float(max(2.0 * (power - gain * grey), 0.0) / size)


@jit_fast_inline
def _improved(at: _Plane, start: _Plane, square: float, work: _Workspace) -> _Plane:
    """Return the plane after one step, from the products at it."""
    damped, p, inverse, weight = work.damped, work.products, work.inverse, max(square, MIN_SQUARE) / PRIOR_SIGMA**2
    for a in range(4):
        for b in range(4):
            damped[a, b] = work.normal[a, b]
    damped[2, 2] += weight
    damped[3, 3] += weight
    p[2] += weight * (at.along_u - start.along_u)
    p[3] += weight * (at.along_v - start.along_v)
    fill_inverse_4(damped, inverse)
    dx = inverse[0, 0] * p[0] + inverse[0, 1] * p[1] + inverse[0, 2] * p[2] + inverse[0, 3] * p[3]
    dy = inverse[1, 0] * p[0] + inverse[1, 1] * p[1] + inverse[1, 2] * p[2] + inverse[1, 3] * p[3]
    du = inverse[2, 0] * p[0] + inverse[2, 1] * p[1] + inverse[2, 2] * p[2] + inverse[2, 3] * p[3]
    dv = inverse[3, 0] * p[0] + inverse[3, 1] * p[1] + inverse[3, 2] * p[2] + inverse[3, 3] * p[3]
    return _Plane(at.x - dx, at.y - dy, at.along_u - du, at.along_v - dv)


@jit_fast_inline
def _is_near(at: _Plane, start: _Plane) -> bool:
    """Tell whether a plane is plausible after another one; NaN is not."""
    moved = max(abs(at.x - start.x), abs(at.y - start.y))
    return bool(moved <= MAX_SHIFT_PX and max(abs(at.along_u), abs(at.along_v)) <= MAX_SLOPE)


@jit_fast_inline
def _fit(image: FloatImage, start: _Plane, power: float, work: _Workspace) -> _Plane:
    """Return the plane of a patch, that of its neighbours if it gives none."""
    half = half_width(work.pixels.columns.size)
    at = start
    for _ in range(ITERATIONS):
        square = _compare(image, at, power, work)
        if np.isnan(square):
            return start
        before, at = at, _improved(at, start, square, work)
        if not _is_near(at, start):
            return start
        turned = half * max(abs(at.along_u - before.along_u), abs(at.along_v - before.along_v))
        if max(abs(at.x - before.x), abs(at.y - before.y), turned) < FINISHED_PX:
            break
    return at


@jit_fast
def refine_slopes(image: FloatImage, patches: Patch, right: FloatArray, slope: FloatArray) -> FloatArray:
    """Return the slopes `(N, 2)` of the planes of single patches; those of their neighbours where a patch gives none.

    Args:
        image: `(H, W)` float32, right.
        patches: `(N, 3, S * S)` left patches of `cut_patches`.
        right: `(N, 2)` their centres in the right image, pixels; NaN where not known.
        slope: `(N, 2)` change of the disparity per pixel along u and v, by the neighbours.
    """
    refined, size = slope.copy(), patches.shape[2]
    work = _Workspace(
        patch_pixels(size),
        np.empty((5, size), np.float32),
        np.zeros((4, 4)),
        np.zeros((4, 4)),
        np.zeros((4, 4)),
        np.zeros(4),
    )
    for n in range(len(patches)):
        start = _Plane(right[n, 0], right[n, 1], slope[n, 0], slope[n, 1])
        if np.isnan(start.x):
            continue
        power = _fill_columns(patches[n], start, work)
        if power < MIN_POWER or not _fill_normal(work):
            continue
        found = _fit(image, start, power, work)
        refined[n, 0], refined[n, 1] = found.along_u, found.along_v
    return refined

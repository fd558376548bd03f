"""Slopes of the local disparity plane of a single patch, estimated by least squares over its pixels.

In large images the neighbours of a corner are far away. The plane through them is the prior of the plane of the patch.

Warp: around the centre of a left patch, the disparity is `d + slope_u i + slope_v j` at the offset (i, j). A right
pixel is the left pixel minus the disparity, so that the pixel at this offset is compared with the right pixel

    x = centre_x + (1 - slope_u) i - slope_v j
    y = centre_y + j

The four unknowns are centre_x, centre_y, slope_u and slope_v. With the derivatives T_x and T_y of the left patch, the
derivatives of the right image along x and y are `g_x = T_x / (1 - slope_u)` and `g_y = T_y + slope_v g_x`, by the
inverse transpose of the warp's Jacobian at the initial slopes. The derivatives with respect to the unknowns are
therefore

    (g_x, g_y, -i g_x, -j g_x)

Both patches are normalised to the same mean and contrast. Each Gauss-Newton step solves (N + P) step = J^T r + P p,
with the normal matrix N = J^T J, the residual r (right minus left patch), and for the slopes the information P of the
prior and their deviation p from the prior. The step is subtracted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.neighbour_slopes import MAX_SLOPE
from sfr_loc_map.localisation.frontend.patch import (
    MIN_POWER,
    SAMPLED_PX,
    Patch,
    PatchPixels,
    half_width,
    normalise,
    patch_pixels,
    sample,
)
from sfr_loc_map.localisation.frontend.patch_tracking import FINISHED_PX, MIN_TEXTURE_RATIO
from sfr_loc_map.localisation.small_linalg import copy_row, fill_inverse_4

PRIOR_SIGMA = 0.05
"""Prior standard deviation of the slopes about those of the neighbours' plane, px of disparity per px. Values of 0.015
and 0.03 gave larger attitude errors (measurements/localiser_trials.md)."""
MIN_SQUARE = 1.0  #: Minimum mean squared residual, grey levels squared, because images have whole grey levels.
SLOPE_ITERATIONS = 5
"""Maximum number of iterations. With fewer iterations, large slopes keep an error. With more iterations, patches that
do not converge take longer."""
MAX_SLOPE_SHIFT_PX = 1.0
"""Maximum shift of a patch, px. A patch that moves farther has lost its texture and keeps its initial slopes."""
COLUMNS = 5
"""Number of columns in the fit of a patch: grey levels, and their derivatives with respect to the four unknowns."""


class _Workspace(NamedTuple):
    """Arrays that are reused for each patch.

    A plane `(4,)` holds the four unknowns: centre of the patch in the right image, px, and slopes.
    """

    pixels: PatchPixels  #: Pixels of the left patch.
    start: FloatArray  #: Initial plane, from the neighbours.
    plane: FloatArray  #: Estimated plane of the patch.
    columns: Patch  #: `(COLUMNS, S * S)` grey levels, and their derivatives with respect to the unknowns.
    normal: FloatArray  #: `(4, 4)` normal matrix of the derivatives.
    regularised: FloatArray  #: `(4, 4)` normal matrix with the prior.
    inverse: FloatArray  #: `(4, 4)` inverse of the regularised matrix.
    products: FloatArray  #: `(4,)` products of the derivatives with the right image.


@jit_fast_inline
def _fill_columns(patch: Patch, work: _Workspace) -> float:
    """Fill grey levels and derivatives; return the power of the grey levels.

    The derivatives have zero mean and are orthogonal to the grey levels, because a change of contrast explains the
    parallel part.
    """
    columns = work.columns
    pixels = work.pixels
    size = pixels.columns.size
    scale_u = np.float32(1.0 - work.start[2])
    slope_v = np.float32(work.start[3])
    for k in range(size):
        by_x = patch[1, k] / scale_u
        columns[0, k] = patch[0, k]
        columns[1, k] = by_x
        columns[2, k] = patch[2, k] + slope_v * by_x
        columns[3, k] = -pixels.columns[k] * by_x
        columns[4, k] = -pixels.rows[k] * by_x
    power = normalise(columns[0])
    if power < MIN_POWER:
        return float(power)
    for c in range(1, COLUMNS):
        normalise(columns[c])
        parallel = np.float32(0.0)
        for k in range(size):
            parallel += columns[0, k] * columns[c, k]
        parallel /= power
        for k in range(size):
            columns[c, k] -= parallel * columns[0, k]
    return float(power)


@jit_fast_inline
def _fill_normal(work: _Workspace) -> bool:
    """Fill the normal matrix; return whether the patch has texture in two directions."""
    columns = work.columns
    normal = work.normal
    for a in range(4):
        for b in range(a, 4):
            total = np.float32(0.0)
            for k in range(columns.shape[1]):
                total += columns[1 + a, k] * columns[1 + b, k]
            normal[a, b] = normal[b, a] = total
    determinant = normal[0, 0] * normal[1, 1] - normal[0, 1] * normal[0, 1]
    return bool(determinant > MIN_TEXTURE_RATIO * (normal[0, 0] + normal[1, 1]) ** 2)


@jit_fast_inline
def _compare(image: FloatImage, plane: tuple[float, float, float, float], power: float, work: _Workspace) -> float:
    """Fill the products; return the mean squared residual, grey levels squared.

    The residual is NaN if the patch leaves the image or the image has no texture there.
    """
    columns = work.columns
    pixels = work.pixels
    products = work.products
    centre_x, centre_y, slope_u, slope_v = plane
    size = pixels.columns.size
    half = half_width(pixels.columns.size)
    reach = half * (abs(1.0 - slope_u) + abs(slope_v))
    height, width = image.shape
    if (
        centre_x < reach
        or centre_x + reach >= width - SAMPLED_PX
        or centre_y < half
        or centre_y + half >= height - SAMPLED_PX
    ):
        return np.nan
    x = np.float32(centre_x)
    y = np.float32(centre_y)
    along_u = np.float32(1.0 - slope_u)
    along_v = np.float32(slope_v)
    level = sample(image, x, y)
    total = np.float32(0.0)
    squares = np.float32(0.0)
    with_grey = np.float32(0.0)
    p0 = np.float32(0.0)
    p1 = np.float32(0.0)
    p2 = np.float32(0.0)
    p3 = np.float32(0.0)
    for k in range(size):
        i = pixels.columns[k]
        j = pixels.rows[k]
        value = sample(image, x + along_u * i - along_v * j, y + j) - level
        total += value
        squares += value * value
        with_grey += columns[0, k] * value
        p0 += columns[1, k] * value
        p1 += columns[2, k] * value
        p2 += columns[3, k] * value
        p3 += columns[4, k] * value
    power_of_samples = squares - total * total / np.float32(size)
    if power_of_samples < MIN_POWER:
        return np.nan
    gain = np.sqrt(power / power_of_samples)
    products[0] = gain * p0
    products[1] = gain * p1
    products[2] = gain * p2
    products[3] = gain * p3
    return float(max(2.0 * (power - gain * with_grey), 0.0) / size)


@jit_fast_inline
def _fit(image: FloatImage, power: float, work: _Workspace) -> bool:
    """Fit the plane of a patch with the neighbours' plane as the prior; return whether the result is plausible."""
    start = work.start
    plane = work.plane
    rhs = work.products
    regularised = work.regularised
    inverse = work.inverse
    half = half_width(work.pixels.columns.size)
    copy_row(start, plane)
    for _ in range(SLOPE_ITERATIONS):
        square = _compare(image, (plane[0], plane[1], plane[2], plane[3]), power, work)
        if np.isnan(square):
            return False
        prior = max(square, MIN_SQUARE) / PRIOR_SIGMA**2
        for a in range(4):
            copy_row(work.normal[a], regularised[a])
        for a in range(2, 4):
            regularised[a, a] += prior
            rhs[a] += prior * (plane[a] - start[a])
        fill_inverse_4(regularised, inverse)
        moved_px = 0.0
        for a in range(4):
            step = inverse[a, 0] * rhs[0] + inverse[a, 1] * rhs[1] + inverse[a, 2] * rhs[2] + inverse[a, 3] * rhs[3]
            plane[a] -= step
            moved_px = max(moved_px, abs(step) * (1 if a < 2 else half))
        shift_px = max(abs(plane[0] - start[0]), abs(plane[1] - start[1]))
        slope = max(abs(plane[2]), abs(plane[3]))
        if not (shift_px <= MAX_SLOPE_SHIFT_PX and slope <= MAX_SLOPE):  # also true for NaN
            return False
        if moved_px < FINISHED_PX:
            break
    return True


@jit_fast
def refine_slopes(image: FloatImage, patches: Patch, right: FloatArray, slope: FloatArray) -> FloatArray:
    """Return the slopes `(N, 2)` fitted to single patches. A patch whose fit fails keeps its initial slopes.

    Args:
        image: Right image.
        patches: `(N, 3, S * S)` of the left image, as from `cut_patches`.
        right: `(N, 2)` centres of the patches in the right image; NaN if unknown.
        slope: `(N, 2)` initial slopes, from the planes of the neighbours.
    """
    refined = slope.copy()
    size = patches.shape[2]
    matrices = np.zeros((3, 4, 4))
    vectors = np.zeros((3, 4))
    columns = np.empty((COLUMNS, size), np.float32)
    normal, regularised, inverse = matrices
    start, plane, products = vectors
    work = _Workspace(patch_pixels(size), start, plane, columns, normal, regularised, inverse, products)
    for n in range(len(patches)):
        start[0] = right[n, 0]
        start[1] = right[n, 1]
        start[2] = slope[n, 0]
        start[3] = slope[n, 1]
        if np.isnan(start[0]):
            continue
        power = _fill_columns(patches[n], work)
        if power >= MIN_POWER and _fill_normal(work) and _fit(image, power, work):
            refined[n, 0] = plane[2]
            refined[n, 1] = plane[3]
    return refined

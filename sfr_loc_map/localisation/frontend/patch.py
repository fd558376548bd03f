"""Patches that are cut out of an image with their gradients, warped, and compared with another image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.plane_warp import LocalWarp

HALF = 5
"""Half width of a patch, px. Patches of 9 x 9 and 13 x 13 px were tried: measurements/localiser_trials.md, "What limits
it, and what was tried"."""
SIDE = 2 * HALF + 1  #: Side of a patch, pixels.
MIN_POWER = 1e-3
"""Minimum power (sum of squares about the mean) of a textured patch, grey levels squared. The minimum prevents a
division by zero. Any patch that is not constant after rounding to whole grey levels has more power."""
SAMPLED_PX = 1.001
"""Minimum difference between the width or height of the image and a sampled position, px. Interpolation requires the
next pixel, and rounding to float32 changes a position by less than 0.001 px."""
COARSE_SAMPLED_PX = 1.01
"""`SAMPLED_PX` for the coarse levels, used by the alignment and by the estimate of double exposures. In six runs of the
sample with injected faults, 1.001 px changed only the last digits of poses and no state."""
MIN_WARP_SCALE = 1e-6
"""Minimum ratio of a pixel's depth to the depth at the centre of its patch. The minimum prevents a division by zero."""
POWER, CONTRAST_X, CONTRAST_Y, XX, XY, YY = range(6)
"""Columns of `Templates.moments`: power of the grey levels; coefficients of the grey levels in the parallel parts of
the derivatives along x and y; sums of products of the orthogonal parts of these derivatives."""
Patch = NDArray[np.float32]  #: Values of one patch `(S * S,)` row by row, or of several patches; float32.


class Templates(NamedTuple):
    """N patches to be tracked, with the terms of the comparison that do not depend on the other image.

    The derivatives of a warped patch are linear combinations of the two stored derivatives.
    """

    #: `(N, 3, S * S)` float32: grey levels with zero mean; derivatives along x and y of the host image, with zero mean
    #: and orthogonal to the grey levels, because a change of contrast explains the parallel part.
    values: Patch
    moments: FloatArray  #: `(N, 6)`, columns `POWER` to `YY`.


class PatchPixels(NamedTuple):
    """Pixels of a patch relative to its centre, `(S * S,)` float32."""

    columns: Patch  #: In the host image.
    rows: Patch
    x: Patch  #: In another image.
    y: Patch


class WarpedNormal(NamedTuple):
    """Normal matrix of a warped patch in the target image: sums of products of its derivatives."""

    xx: float
    xy: float
    yy: float
    b00: float  #: Inverse transpose of the warp's Jacobian, which transforms derivatives from the host to the target.
    b01: float
    b10: float
    b11: float


class Products(NamedTuple):
    """Sums over samples with zero mean and a template."""

    power: np.float32  #: Sum of the squared samples.
    grey: np.float32  #: Sum of products with the grey levels of the template.
    x: np.float32  #: Sum of products with the derivative along x.
    y: np.float32  #: Sum of products with the derivative along y.


@jit_fast_ir_inline
def sample(image: FloatImage, x: float | np.float32, y: float | np.float32) -> np.float32:
    """Return the grey level at a position inside an image by bilinear interpolation."""
    # Unsigned indices avoid the test for a negative index at each read.
    left = np.uintp(np.int32(x))
    above = np.uintp(np.int32(y))
    one = np.uintp(1)
    fx = np.float32(x - np.int32(x))
    fy = np.float32(y - np.int32(y))
    top: np.float32 = image[above, left] + fx * (image[above, left + one] - image[above, left])
    below = above + one
    bottom: np.float32 = image[below, left] + fx * (image[below, left + one] - image[below, left])
    return top + fy * (bottom - top)


@jit_fast_inline
def half_width(size: int) -> int:
    """Return the half width of a square patch of `size` pixels."""
    return (int(np.sqrt(size + 0.5)) - 1) // 2


@jit_fast
def cut_patches(image: FloatImage, uv: FloatArray, half: int) -> Patch:
    """Cut patches `(N, 3, S * S)`: grey levels, and their central differences along x and y, grey levels per pixel.

    The centres `(N, 2)`, pixels, are at least half + 2 px from the border.
    """
    side = 2 * half + 1
    patches = np.empty((len(uv), 3, side * side), np.float32)
    grid = np.empty((side + 2, side + 2), np.float32)
    for n in range(len(uv)):
        x = uv[n, 0] - half - 1
        y = uv[n, 1] - half - 1
        column = int(x)
        row = int(y)
        is_whole_pixel = column == x and row == y  # as in keyframes, where no interpolation is needed
        for j in range(side + 2):
            for i in range(side + 2):
                grid[j, i] = image[row + j, column + i] if is_whole_pixel else sample(image, x + i, y + j)
        k = 0
        for j in range(1, side + 1):
            for i in range(1, side + 1):
                patches[n, 0, k] = grid[j, i]
                patches[n, 1, k] = np.float32(0.5) * (grid[j, i + 1] - grid[j, i - 1])
                patches[n, 2, k] = np.float32(0.5) * (grid[j + 1, i] - grid[j - 1, i])
                k += 1
    return patches


@jit_fast_ir_inline
def normalise(values: Patch) -> np.float32:
    """Subtract the mean from values in place; return their power, the sum of their squares."""
    mean = np.float32(0.0)
    for k in range(values.size):
        mean += values[k]
    mean /= np.float32(values.size)
    power = np.float32(0.0)
    for k in range(values.size):
        values[k] -= mean
        power += values[k] * values[k]
    return power


@jit_fast_inline
def patch_pixels(size: int) -> PatchPixels:
    """Return the pixels of a patch of `size` pixels; x and y are not initialised."""
    half = half_width(size)
    columns = np.empty(size, np.float32)
    rows = np.empty(size, np.float32)
    k = 0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            columns[k] = i
            rows[k] = j
            k += 1
    return PatchPixels(columns, rows, np.empty(size, np.float32), np.empty(size, np.float32))


@jit_fast_inline
def warp_pixels(pixels: PatchPixels, by: LocalWarp) -> None:
    """Fill x and y with the warped pixels relative to the warped centre. All pixels must be in front of the camera."""
    xu = np.float32(by.xu)
    xv = np.float32(by.xv)
    yu = np.float32(by.yu)
    yv = np.float32(by.yv)
    wu = np.float32(by.wu)
    wv = np.float32(by.wv)
    for k in range(pixels.x.size):
        i = pixels.columns[k]
        j = pixels.rows[k]
        scale = np.float32(1.0) / max(np.float32(1.0) + wu * i + wv * j, np.float32(MIN_WARP_SCALE))
        pixels.x[k] = scale * (xu * i + xv * j)
        pixels.y[k] = scale * (yu * i + yv * j)


@jit_fast_inline
def warped_normal(by: LocalWarp, det: float, xx: float, xy: float, yy: float) -> WarpedNormal:
    """Return the normal matrix `B N B^T` in the target image, from the matrix N in the host image.

    N has the elements xx, xy, yy. B is the inverse transpose of the warp's Jacobian, whose determinant `det` is not 0.
    """
    b00 = by.yv / det
    b01 = -by.yu / det
    b10 = -by.xv / det
    b11 = by.xu / det
    bn00 = b00 * xx + b01 * xy
    bn01 = b00 * xy + b01 * yy
    bn10 = b10 * xx + b11 * xy
    bn11 = b10 * xy + b11 * yy
    warped_xx = bn00 * b00 + bn01 * b01
    warped_xy = bn00 * b10 + bn01 * b11
    warped_yy = bn10 * b10 + bn11 * b11
    return WarpedNormal(warped_xx, warped_xy, warped_yy, b00, b01, b10, b11)


@jit_fast
def templates_of(patches: Patch) -> Templates:
    """Return the templates of patches `(N, 3, S * S)` from `cut_patches`.

    The patches are modified in place and become the values of the templates. The moments of a textureless patch are 0.
    """
    values = patches
    moments = np.zeros((len(patches), 6))
    for n in range(len(patches)):
        grey = values[n, 0]
        dx = values[n, 1]
        dy = values[n, 2]
        power = normalise(grey)
        normalise(dx)
        normalise(dy)
        if power < MIN_POWER:
            continue
        contrast_x = np.float32(0.0)
        contrast_y = np.float32(0.0)
        for k in range(grey.size):
            contrast_x += grey[k] * dx[k]
            contrast_y += grey[k] * dy[k]
        contrast_x /= power
        contrast_y /= power
        xx = np.float32(0.0)
        xy = np.float32(0.0)
        yy = np.float32(0.0)
        for k in range(grey.size):
            dx[k] -= contrast_x * grey[k]
            dy[k] -= contrast_y * grey[k]
            xx += dx[k] * dx[k]
            xy += dx[k] * dy[k]
            yy += dy[k] * dy[k]
        moments[n, POWER] = power
        moments[n, CONTRAST_X] = contrast_x
        moments[n, CONTRAST_Y] = contrast_y
        moments[n, XX] = xx
        moments[n, XY] = xy
        moments[n, YY] = yy
    return Templates(values, moments)


@jit_fast_inline
def products_with_samples(
    image: FloatImage, x: Patch, y: Patch, shift_x: np.float32, shift_y: np.float32, template: Patch
) -> Products:
    """Compare an image with a template `(3, S * S)` at shifted positions `(S * S,)`, all inside the image.

    Samples are not stored, because the compiler does not vectorise a loop that writes to memory which may overlap the
    image.
    """
    # The template has zero mean, so the samples need not be centred. One sample is subtracted to keep the sums small.
    level = sample(image, x[0] + shift_x, y[0] + shift_y)
    total = np.float32(0.0)
    squares = np.float32(0.0)
    with_grey = np.float32(0.0)
    with_x = np.float32(0.0)
    with_y = np.float32(0.0)
    for k in range(x.size):
        value = sample(image, x[k] + shift_x, y[k] + shift_y) - level
        total += value
        squares += value * value
        with_grey += template[0, k] * value
        with_x += template[1, k] * value
        with_y += template[2, k] * value
    power = squares - total * total / np.float32(x.size)
    return Products(power, with_grey, with_x, with_y)

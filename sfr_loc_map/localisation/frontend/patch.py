"""Patches: cut out of an image with their gradients, normalised, and compared with samples of another image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.homography import LocalWarp

HALF = 5
"""Half width of a patch: 11 x 11 pixels."""
SIDE = 2 * HALF + 1
MIN_POWER = 1e-3
"""Sum of squares about the mean below which a patch has no texture, grey levels squared."""
Patch = NDArray[np.float32]
"""Values of one patch `(S * S,)` row by row, or of several; float32."""


class Templates(NamedTuple):
    """N patches that are sought in other images, with what does not depend on the image.

    A patch that is warped has other derivatives, which are sums of these two.

    Attributes:
        values: `(N, 3, S * S)` float32: grey levels without their mean, and derivatives along x and y of the host
            image without their mean and without what a change of contrast explains.
        moments: `(N, 6)`: sum of the squared grey levels; what a change of contrast explains of the two derivatives,
            as factors of the grey levels; sums of products xx, xy, yy of the derivatives that are left.
    """

    values: Patch
    moments: FloatArray

    def subset(self, kept: Mask | NDArray[np.intp]) -> Templates:
        """Return some of them, a mask `(N,)` or rows."""
        return Templates(self.values[kept], self.moments[kept])


def together(parts: Sequence[tuple[Templates, NDArray[np.intp]]]) -> Templates:
    """Return some rows of several templates one after the other, copied once."""
    count, size = sum(len(rows) for _, rows in parts), parts[-1][0].values.shape[2]
    values, moments = np.empty((count, 3, size), np.float32), np.empty((count, 6))
    first = 0
    for templates, rows in parts:
        place = slice(first, first + len(rows))
        np.take(templates.values, rows, axis=0, out=values[place], mode="clip")  # by "raise" it would copy twice
        moments[place] = templates.moments[rows]
        first += len(rows)
    return Templates(values, moments)


class PatchPixels(NamedTuple):
    """Pixels of a patch from its centre, `(S * S,)` float32: columns and rows in the host; x, y in another image."""

    columns: Patch
    rows: Patch
    x: Patch
    y: Patch


class WarpedNormal(NamedTuple):
    """Products xx, xy, yy of the derivatives of a warped patch, and the matrix b that takes the host's to the target.

    That is the inverse transpose of the warp's derivative.
    """

    xx: float
    xy: float
    yy: float
    b00: float
    b01: float
    b10: float
    b11: float


class Products(NamedTuple):
    """Of samples without their mean: sum of squares, and of products with a template and its x and y derivatives."""

    power: np.float32
    grey: np.float32
    x: np.float32
    y: np.float32


@jit_fast_ir_inline
def sample(image: FloatImage, x: float | np.float32, y: float | np.float32) -> np.float32:
    """Return the bilinear value of an image at a position that is known to lie inside it."""
    # unsigned: for a signed index each read would test whether it counts from the end
    left, above, one = np.uintp(np.int32(x)), np.uintp(np.int32(y)), np.uintp(1)
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
    """Cut patches with their gradients.

    Args:
        image: `(H, W)` float32.
        uv: `(N, 2)` centres, pixels, at least half + 2 from the border.
        half: Half width.

    Returns:
        `(N, 3, S * S)` float32: grey levels and their derivatives along x and y, grey levels per pixel.
    """
    side = 2 * half + 1
    out = np.empty((len(uv), 3, side * side), np.float32)
    grid = np.empty((side + 2, side + 2), np.float32)
    for n in range(len(uv)):
        x, y = uv[n, 0] - half - 1, uv[n, 1] - half - 1
        column, row = int(x), int(y)
        whole = column == x and row == y  # as in all keyframes: nothing to interpolate
        for j in range(side + 2):
            for i in range(side + 2):
                grid[j, i] = image[row + j, column + i] if whole else sample(image, x + i, y + j)
        k = 0
        for j in range(1, side + 1):
            for i in range(1, side + 1):
                out[n, 0, k] = grid[j, i]
                out[n, 1, k] = np.float32(0.5) * (grid[j, i + 1] - grid[j, i - 1])
                out[n, 2, k] = np.float32(0.5) * (grid[j + 1, i] - grid[j - 1, i])
                k += 1
    return out


@jit_fast_ir_inline
def normalise(values: Patch) -> np.float32:
    """Subtract the mean from values in place; return the sum of their squares."""
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
    """Return the pixels of a patch of a size; x and y are to be filled."""
    half = half_width(size)
    columns, rows = np.empty(size, np.float32), np.empty(size, np.float32)
    k = 0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            columns[k], rows[k] = i, j
            k += 1
    return PatchPixels(columns, rows, np.empty(size, np.float32), np.empty(size, np.float32))


@jit_fast_inline
def warp_pixels(pixels: PatchPixels, by: LocalWarp) -> None:
    """Fill x and y: how far from the warped centre the warped pixels are, all in front of the camera."""
    xu, xv, yu, yv = np.float32(by.xu), np.float32(by.xv), np.float32(by.yu), np.float32(by.yv)
    wu, wv = np.float32(by.wu), np.float32(by.wv)
    for k in range(pixels.x.size):
        i, j = pixels.columns[k], pixels.rows[k]
        scale = np.float32(1.0) / max(np.float32(1.0) + wu * i + wv * j, np.float32(1e-6))
        pixels.x[k] = scale * (xu * i + xv * j)
        pixels.y[k] = scale * (yu * i + yv * j)


@jit_fast_inline
def warped_normal(by: LocalWarp, det: float, xx: float, xy: float, yy: float) -> WarpedNormal:
    """Take products of derivatives in the host to the target; `det` is the determinant of the warp, not 0."""
    b00, b01, b10, b11 = by.yv / det, -by.yu / det, -by.xv / det, by.xu / det
    px, py, qx, qy = b00 * xx + b01 * xy, b00 * xy + b01 * yy, b10 * xx + b11 * xy, b10 * xy + b11 * yy
    return WarpedNormal(px * b00 + py * b01, px * b10 + py * b11, qx * b10 + qy * b11, b00, b01, b10, b11)


@jit_fast
def templates_of(patches: Patch) -> Templates:
    """Return the templates of patches `(N, 3, S * S)` of `cut_patches`, which become their values."""
    values, moments = patches, np.zeros((len(patches), 6))
    for n in range(len(patches)):
        grey, dx, dy = values[n, 0], values[n, 1], values[n, 2]
        power = normalise(grey)
        normalise(dx)
        normalise(dy)
        if power < MIN_POWER:
            continue
        x, y = np.float32(0.0), np.float32(0.0)
        for k in range(grey.size):
            x += grey[k] * dx[k]
            y += grey[k] * dy[k]
        x /= power
        y /= power
        xx, xy, yy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(grey.size):
            dx[k] -= x * grey[k]
            dy[k] -= y * grey[k]
            xx += dx[k] * dx[k]
            xy += dx[k] * dy[k]
            yy += dy[k] * dy[k]
        out = moments[n]
        out[0], out[1], out[2], out[3], out[4], out[5] = power, x, y, xx, xy, yy
    return Templates(values, moments)


@jit_fast_inline
def products_with_samples(
    image: FloatImage, x: Patch, y: Patch, shift_x: np.float32, shift_y: np.float32, template: Patch
) -> Products:
    """Compare an image with a template `(3, S * S)` at positions `(S * S,)`, shifted, all inside the image.

    Samples are not stored: memory that may be the image's would keep the loop from being vector code.
    """
    # as the template has no mean that of the samples need not be known before; one of them keeps the sums small
    level = sample(image, x[0] + shift_x, y[0] + shift_y)
    total, squares = np.float32(0.0), np.float32(0.0)
    of_grey, of_x, of_y = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(x.size):
        value = sample(image, x[k] + shift_x, y[k] + shift_y) - level
        total += value
        squares += value * value
        of_grey += template[0, k] * value
        of_x += template[1, k] * value
        of_y += template[2, k] * value
    return Products(squares - total * total / np.float32(x.size), of_grey, of_x, of_y)

"""Image pyramids and patches: cut out with their gradients, warped by the homography of their plane, compared.

A plane in disparity, hence in inverse depth, is one in space, so a patch around a host pixel moves into another image
by a homography (Hartley and Zisserman 2004, section 13.1).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline

SMOOTHING = cv2.getGaussianKernel(3, 0.5, cv2.CV_32F)
"""Along rows and columns: against the errors of bilinear interpolation."""
LEVELS = 4
"""Levels of the pyramid; level l is 2^l times smaller, its pixel centres at `u_l = (u + 0.5) / 2^l - 0.5`."""


class ImageLevel(NamedTuple):
    """One level of a pyramid as a struct for kernels."""

    image: FloatImage  #: `(H, W)` float32.
    scale: float  #: Pixels of full size per pixel, `2^l`.


Pyramid = tuple[ImageLevel, ...]
"""Level 0 is the image smoothed lightly, each next one the mean of 2 x 2 pixels of the one before."""


def build_pyramid(image: GreyImage) -> Pyramid:
    """Return the pyramid of an image `(H, W)` uint8."""
    levels = [cv2.sepFilter2D(image, cv2.CV_32F, SMOOTHING, SMOOTHING)]
    for _ in range(LEVELS - 1):
        height, width = levels[-1].shape
        even = levels[-1][: height // 2 * 2, : width // 2 * 2]
        levels.append(cv2.resize(even, (width // 2, height // 2), interpolation=cv2.INTER_AREA))
    return tuple(ImageLevel(np.ascontiguousarray(level), 2.0**number) for number, level in enumerate(levels))


BEHIND = -1e9  #: Pixel coordinates of what lies behind the camera.


class LocalPlanes(NamedTuple):
    """The planes around N host pixels; inverse depth is linear in the host pixel."""

    hosts: Poses  #: `(N,)` host cameras.
    uv: FloatArray  #: `(N, 2)` host pixels.
    inverse_depth: FloatArray  #: `(N,)` at the host pixels, 1/m.
    slopes: FloatArray  #: `(N, 2)` its change per pixel along u and v, 1/m.


class LocalWarp(NamedTuple):
    """A homography around a pixel: `x + (xu i + xv j) / (1 + wu i + wv j)` for a pixel (i, j) beside, y likewise."""

    x: float  #: Where the pixel itself is; `BEHIND` behind the camera.
    y: float
    xu: float  #: Derivatives there; 0 behind the camera.
    xv: float
    yu: float
    yv: float
    wu: float  #: Change of the depth per pixel over the depth.
    wv: float


@jit_fast
def plane_homographies(target: Pose, planes: LocalPlanes, camera: StereoCamera, offset_x: float) -> FloatArray:
    """Return the homographies `(N, 3, 3)` of local planes, from host pixels to pixels of one image.

    `x' ~ K (R K^-1 (u, v, 1) + t rho(u, v))` with the inverse depth `rho` linear in the host pixel. The target is the
    left camera; the offset is the position of the image's camera along its x: 0 or the baseline, metres.
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    rotation, position, uv, slopes = target.rotation, target.position, planes.uv, planes.slopes
    out = np.empty((len(uv), 3, 3))
    for n in range(len(uv)):
        h, r_wh, p_h = out[n], planes.hosts.rotations[n], planes.hosts.positions[n]
        offset = planes.inverse_depth[n] - slopes[n, 0] * uv[n, 0] - slopes[n, 1] * uv[n, 1]
        d0, d1, d2 = p_h[0] - position[0], p_h[1] - position[1], p_h[2] - position[2]
        for r in range(3):
            r0 = rotation[0, r] * r_wh[0, 0] + rotation[1, r] * r_wh[1, 0] + rotation[2, r] * r_wh[2, 0]
            r1 = rotation[0, r] * r_wh[0, 1] + rotation[1, r] * r_wh[1, 1] + rotation[2, r] * r_wh[2, 1]
            r2 = rotation[0, r] * r_wh[0, 2] + rotation[1, r] * r_wh[1, 2] + rotation[2, r] * r_wh[2, 2]
            t = rotation[0, r] * d0 + rotation[1, r] * d1 + rotation[2, r] * d2
            if r == 0:
                t -= offset_x
            h[r, 0] = r0 / fx + t * slopes[n, 0]
            h[r, 1] = r1 / fy + t * slopes[n, 1]
            h[r, 2] = r2 - r0 * cx / fx - r1 * cy / fy + t * offset
        for c in range(3):
            h[0, c] = fx * h[0, c] + cx * h[2, c]
            h[1, c] = fy * h[1, c] + cy * h[2, c]
    return out


@jit_fast_inline
def local_warp(h: FloatArray, u: float, v: float) -> LocalWarp:
    """Return a homography around a pixel."""
    w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
    if w <= 1e-9:
        return LocalWarp(BEHIND, BEHIND, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    x, y = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w, (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w
    return LocalWarp(
        x,
        y,
        (h[0, 0] - x * h[2, 0]) / w,
        (h[0, 1] - x * h[2, 1]) / w,
        (h[1, 0] - y * h[2, 0]) / w,
        (h[1, 1] - y * h[2, 1]) / w,
        h[2, 0] / w,
        h[2, 1] / w,
    )


HALF = 5  #: Half width of a patch: 11 x 11 pixels.
SIDE = 2 * HALF + 1
MIN_POWER = 1e-3  #: Sum of squares about the mean below which a patch has no texture, grey levels squared.
Patch = NDArray[np.float32]  #: Values of one patch `(S * S,)` row by row, or of several; float32.


class Templates(NamedTuple):
    """N patches that are sought in other images, with what does not depend on the image.

    A patch that is warped has other derivatives, which are sums of these two.
    """

    #: `(N, 3, S * S)` float32: grey levels without their mean, and derivatives along x and y of the host image without
    #: their mean and without what a change of contrast explains.
    values: Patch
    #: `(N, 6)`: sum of the squared grey levels; what a change of contrast explains of the two derivatives, as factors
    #: of the grey levels; sums of products xx, xy, yy of the derivatives that are left.
    moments: FloatArray


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
    """Cut patches `(N, 3, S * S)`: grey levels and their derivatives along x and y, grey levels per pixel.

    Their centres `(N, 2)`, pixels, are at least half + 2 from the border.
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

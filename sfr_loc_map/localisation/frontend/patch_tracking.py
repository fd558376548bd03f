"""Patches that are warped by their local plane and tracked by least squares.

A patch is cut out of its host picture around a pixel. A plane in disparity, hence in inverse depth, is one in space, so
the patch moves into another picture by a homography (Hartley and Zisserman 2004, section 13.1). Only the remaining
shift is then estimated, by Gauss-Newton on the difference of the two patches, each brought to the same mean and
contrast (Lucas and Kanade 1981; Baker and Matthews 2004).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline

HALF = 5
"""Half width of a patch: 11 x 11 pixels."""
SIDE = 2 * HALF + 1
Scalar = float | np.float32


@jit_fast_ir_inline
def sample(image: FloatImage, x: Scalar, y: Scalar) -> np.float32:
    """Return the bilinear value of a picture at a position that is known to lie inside it."""
    xi = int(x)
    yi = int(y)
    fx = np.float32(x - xi)
    fy = np.float32(y - yi)
    top: np.float32 = image[yi, xi] + fx * (image[yi, xi + 1] - image[yi, xi])
    bottom: np.float32 = image[yi + 1, xi] + fx * (image[yi + 1, xi + 1] - image[yi + 1, xi])
    return top + fy * (bottom - top)


@jit_fast
def cut_patches(image: FloatImage, uv: FloatArray, half: int) -> NDArray[np.float32]:
    """Cut patches with their gradients.

    Args:
        image: `(H, W)` float32.
        uv: `(N, 2)` centres, pixels, at least half + 2 from the border.
        half: Half width.

    Returns:
        `(N, 3, S * S)` float32: grey levels and their derivatives along x and y, grey levels a pixel.
    """
    side = 2 * half + 1
    out = np.empty((len(uv), 3, side * side), np.float32)
    grid = np.empty((side + 2, side + 2), np.float32)
    for n in range(len(uv)):
        for j in range(side + 2):
            for i in range(side + 2):
                grid[j, i] = sample(image, uv[n, 0] + i - half - 1, uv[n, 1] + j - half - 1)
        k = 0
        for j in range(1, side + 1):
            for i in range(1, side + 1):
                out[n, 0, k] = grid[j, i]
                out[n, 1, k] = np.float32(0.5) * (grid[j, i + 1] - grid[j, i - 1])
                out[n, 2, k] = np.float32(0.5) * (grid[j + 1, i] - grid[j - 1, i])
                k += 1
    return out


@jit_fast
def plane_homographies(
    rotation: FloatArray,
    position: FloatArray,
    host_rotations: FloatArray,
    host_positions: FloatArray,
    uv: FloatArray,
    rho: FloatArray,
    slopes: FloatArray,
    camera: FloatArray,
    shift: float,
) -> FloatArray:
    """Return the homographies of local planes, from host pixels to pixels of one picture.

    `x' ~ K (R K^-1 (u, v, 1) + t rho(u, v))` with the inverse depth `rho` linear in the host pixel.

    Args:
        rotation: `(3, 3)` target camera to world.
        position: `(3,)` metres.
        host_rotations: `(N, 3, 3)` host cameras to world.
        host_positions: `(N, 3)` metres.
        uv: `(N, 2)` host pixels.
        rho: `(N,)` inverse depths there, 1/m.
        slopes: `(N, 2)` their change a pixel.
        camera: `(4,)` fx, fy, cx, cy.
        shift: Place of the target camera along x of the left one: 0 or the baseline, metres.

    Returns:
        `(N, 3, 3)`.
    """
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    out = np.empty((len(rho), 3, 3))
    for n in range(len(rho)):
        h, r_wh, p_h = out[n], host_rotations[n], host_positions[n]
        offset = rho[n] - slopes[n, 0] * uv[n, 0] - slopes[n, 1] * uv[n, 1]
        d0, d1, d2 = p_h[0] - position[0], p_h[1] - position[1], p_h[2] - position[2]
        for r in range(3):
            r0 = rotation[0, r] * r_wh[0, 0] + rotation[1, r] * r_wh[1, 0] + rotation[2, r] * r_wh[2, 0]
            r1 = rotation[0, r] * r_wh[0, 1] + rotation[1, r] * r_wh[1, 1] + rotation[2, r] * r_wh[2, 1]
            r2 = rotation[0, r] * r_wh[0, 2] + rotation[1, r] * r_wh[1, 2] + rotation[2, r] * r_wh[2, 2]
            t = rotation[0, r] * d0 + rotation[1, r] * d1 + rotation[2, r] * d2
            if r == 0:
                t -= shift
            h[r, 0] = r0 / fx + t * slopes[n, 0]
            h[r, 1] = r1 / fy + t * slopes[n, 1]
            h[r, 2] = r2 - r0 * cx / fx - r1 * cy / fy + t * offset
        for c in range(3):
            h[0, c] = fx * h[0, c] + cx * h[2, c]
            h[1, c] = fy * h[1, c] + cy * h[2, c]
    return out


@jit_fast_ir_inline
def warp(h: FloatArray, u: float, v: float) -> tuple[float, float]:
    """Return where a homography takes a pixel; far outside where that is behind the camera."""
    w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
    if w <= 1e-9:
        return -1e9, -1e9
    return (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w, (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w


@jit_fast_ir_inline
def normalise(values: NDArray[np.float32]) -> np.float32:
    """Take the mean off values in place; return the sum of their squares."""
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
def _prepare(  # noqa: C901 - one loop of machine code
    patch: NDArray[np.float32],
    h: FloatArray,
    u0: float,
    v0: float,
    xs: NDArray[np.float32],
    ys: NDArray[np.float32],
    template: NDArray[np.float32],
    jx: NDArray[np.float32],
    jy: NDArray[np.float32],
) -> tuple[float, float, float, float, np.float32, float, float, float]:
    """Warp the pixels of a patch and turn its gradients; all of it without the shift that is looked for.

    Fills the warped pixels xs, ys, the template without its mean, and its derivatives in the target without what
    a change of mean or contrast explains.

    Returns:
        Box of the warped pixels (x, y, x, y), power of the template, normal matrix (xx, xy, yy); the power is 0 where
        the patch cannot be tracked.
    """
    half = (int(np.sqrt(patch.shape[1] + 0.5)) - 1) // 2
    low_x, high_x, low_y, high_y = 1e9, -1e9, 1e9, -1e9
    k = 0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            x, y = warp(h, u0 + i, v0 + j)
            xs[k], ys[k] = x, y
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
            k += 1
    nothing = (low_x, low_y, high_x, high_y, np.float32(0.0), 0.0, 0.0, 0.0)
    span = 12.0 * half
    if low_x < -1e8 or high_x - low_x > span or high_y - low_y > span:
        return nothing
    # the target's gradients are the patch's, turned by the inverse transpose of the warp's derivative at the centre
    cu, cv = warp(h, u0, v0)
    w = h[2, 0] * u0 + h[2, 1] * v0 + h[2, 2]
    a00, a01 = (h[0, 0] - cu * h[2, 0]) / w, (h[0, 1] - cu * h[2, 1]) / w
    a10, a11 = (h[1, 0] - cv * h[2, 0]) / w, (h[1, 1] - cv * h[2, 1]) / w
    det = a00 * a11 - a01 * a10
    if abs(det) < 0.05:
        return nothing
    for k in range(template.size):
        template[k] = patch[0, k]
    power = normalise(template)
    if power < 1e-3:
        return nothing
    b00, b01 = np.float32(a11 / det), np.float32(-a10 / det)
    b10, b11 = np.float32(-a01 / det), np.float32(a00 / det)
    for k in range(template.size):
        jx[k] = b00 * patch[1, k] + b01 * patch[2, k]
        jy[k] = b10 * patch[1, k] + b11 * patch[2, k]
    normalise(jx)
    normalise(jy)
    tx, ty = np.float32(0.0), np.float32(0.0)
    for k in range(template.size):
        tx += template[k] * jx[k]
        ty += template[k] * jy[k]
    tx /= power
    ty /= power
    hxx, hxy, hyy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(template.size):
        jx[k] -= template[k] * tx
        jy[k] -= template[k] * ty
        hxx += jx[k] * jx[k]
        hxy += jx[k] * jy[k]
        hyy += jy[k] * jy[k]
    if hxx * hyy - hxy * hxy <= 1e-6 * (hxx + hyy) ** 2:
        return nothing
    return low_x, low_y, high_x, high_y, power, float(hxx), float(hxy), float(hyy)


@jit_fast_inline
def _compare(
    image: FloatImage,
    xs: NDArray[np.float32],
    ys: NDArray[np.float32],
    sx: float,
    sy: float,
    template: NDArray[np.float32],
    power: np.float32,
    jx: NDArray[np.float32],
    jy: NDArray[np.float32],
    values: NDArray[np.float32],
) -> tuple[float, float, float, float]:
    """Return the right side (x, y), the residual RMS and the correlation of a patch at a shift."""
    for k in range(values.size):
        values[k] = sample(image, xs[k] + np.float32(sx), ys[k] + np.float32(sy))
    target_power = normalise(values)
    if target_power < 1e-3:
        return 0.0, 0.0, 0.0, -1.0
    # jx and jy are orthogonal to the template, so only the target enters
    gain = np.sqrt(power / target_power)
    bx, by, dot = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(values.size):
        bx += jx[k] * values[k]
        by += jy[k] * values[k]
        dot += values[k] * template[k]
    bx, by = gain * bx, gain * by
    correlation = dot / np.sqrt(power * target_power)
    return bx, by, np.sqrt(max(2.0 * power * (1.0 - correlation), 0.0) / values.size), correlation


@jit_fast
def track_patches(
    image: FloatImage,
    patches: NDArray[np.float32],
    host_uv: FloatArray,
    homographies: FloatArray,
    max_shift: float,
    rounds: int,
) -> FloatArray:
    """Find warped patches in a picture.

    Args:
        image: `(H, W)` float32, the target.
        patches: `(N, 3, S * S)` of `cut_patches`.
        host_uv: `(N, 2)` host pixels of the patch centres.
        homographies: `(N, 3, 3)` from host to target pixels.
        max_shift: Largest shift that is believed, pixels.
        rounds: Most Gauss-Newton rounds.

    Returns:
        `(N, 7)`: position u, v of the patch centre in the target, pixels; the covariance of that position for a
        noise of one grey level (uu, uv, vv, px^2); residual RMS, grey levels of the patch; its correlation with the
        target. NaN where the patch left the picture, has no texture, or did not converge.
    """
    count = len(patches)
    out = np.full((count, 7), np.nan)
    height, width = image.shape
    size = patches.shape[2]
    xs, ys, template = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    jx, jy, values = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    for n in range(count):
        low_x, low_y, high_x, high_y, power, hxx, hxy, hyy = _prepare(
            patches[n], homographies[n], host_uv[n, 0], host_uv[n, 1], xs, ys, template, jx, jy
        )
        if power == 0.0:
            continue
        det = hxx * hyy - hxy * hxy
        sx, sy, residual, correlation = 0.0, 0.0, 0.0, -1.0
        good = False
        for _ in range(rounds):
            good = False
            if max(abs(sx), abs(sy)) > max_shift or low_x + sx < 0.0 or low_y + sy < 0.0:
                break
            if high_x + sx >= width - 1.001 or high_y + sy >= height - 1.001:
                break
            bx, by, residual, correlation = _compare(image, xs, ys, sx, sy, template, power, jx, jy, values)
            if correlation <= -1.0:
                break
            dx, dy = (hyy * bx - hxy * by) / det, (hxx * by - hxy * bx) / det
            step = max(abs(dx), abs(dy))
            limit = 1.5 / step if step > 1.5 else 1.0
            sx -= limit * dx
            sy -= limit * dy
            good = step < 0.03
            if step < 0.004:
                break
        if good:
            u, v = warp(homographies[n], host_uv[n, 0], host_uv[n, 1])
            out[n, 0], out[n, 1] = u + sx, v + sy
            out[n, 2], out[n, 3], out[n, 4] = hyy / det, -hxy / det, hxx / det
            out[n, 5], out[n, 6] = residual, correlation
    return out

"""Coarse pose of a new pair: all patches aligned together on small copies of the picture.

The pose itself is estimated from the differences of the patches (Forster et al. 2014), so weak patches are carried by
the others and a wrong prediction of many pixels is caught on the smallest copy. The patches keep the shape that the
start gives them; their places follow the pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.small_linalg import solve, turned
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.patch_tracking import normalise, sample, warp


@jit_fast_inline
def _shapes(homographies: FloatArray, uv: FloatArray) -> FloatArray:
    """Return the derivatives `(N, 4)` of the warps at the patch centres; zero behind the camera."""
    out = np.zeros((len(uv), 4))
    for n in range(len(uv)):
        h = homographies[n]
        u, v = uv[n, 0], uv[n, 1]
        w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
        if w <= 1e-9:
            continue
        x, y = warp(h, u, v)
        out[n, 0], out[n, 1] = (h[0, 0] - x * h[2, 0]) / w, (h[0, 1] - x * h[2, 1]) / w
        out[n, 2], out[n, 3] = (h[1, 0] - y * h[2, 0]) / w, (h[1, 1] - y * h[2, 1]) / w
    return out


@jit_fast_inline
def _prepare(
    patches: NDArray[np.float32], shapes: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.float32], FloatArray]:
    """Return templates without mean `(N, S)`, target derivatives `(N, 2, S)`, power and normal matrix `(N, 4)`."""
    count, size = patches.shape[0], patches.shape[2]
    templates = patches[:, 0].copy()
    jacobians = np.zeros((count, 2, size), np.float32)
    normal = np.zeros((count, 4))
    for n in range(count):
        a00, a01, a10, a11 = shapes[n, 0], shapes[n, 1], shapes[n, 2], shapes[n, 3]
        det = a00 * a11 - a01 * a10
        power = normalise(templates[n])
        if power < 1e-3 or abs(det) < 0.05 or abs(det) > 20.0:
            continue
        b00, b01 = np.float32(a11 / det), np.float32(-a10 / det)
        b10, b11 = np.float32(-a01 / det), np.float32(a00 / det)
        jx, jy = jacobians[n, 0], jacobians[n, 1]
        for k in range(size):
            jx[k] = b00 * patches[n, 1, k] + b01 * patches[n, 2, k]
            jy[k] = b10 * patches[n, 1, k] + b11 * patches[n, 2, k]
        normalise(jx)
        normalise(jy)
        xx, xy, yy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(size):
            xx += jx[k] * jx[k]
            xy += jx[k] * jy[k]
            yy += jy[k] * jy[k]
        normal[n, 0], normal[n, 1], normal[n, 2], normal[n, 3] = power, xx, xy, yy
    return templates, jacobians, normal


@jit_fast
def align_pose(  # noqa: C901 - one loop of machine code
    image: FloatImage,
    level: int,
    patches: NDArray[np.float32],
    homographies: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    host_rotations: FloatArray,
    host_positions: FloatArray,
    uv: FloatArray,
    rho: FloatArray,
    camera: FloatArray,
    rounds: int,
) -> tuple[FloatArray, FloatArray, float, float]:
    """Align all patches with one level of the left picture.

    Args:
        image: Level of the pyramid.
        level: Its number.
        patches: `(N, 3, S * S)` of the hosts at this level.
        homographies: `(N, 3, 3)` of full size at the start, for the patches' shapes.
        rotation: `(3, 3)` start, camera to world.
        position: `(3,)` start, metres.
        host_rotations: `(N, 3, 3)`.
        host_positions: `(N, 3)` metres.
        uv: `(N, 2)` host pixels at full size.
        rho: `(N,)` 1/m.
        camera: `(4,)` fx, fy, cx, cy at full size.
        rounds: Gauss-Newton rounds.

    Returns:
        Rotation, position, mean correlation of the patches at the best pose met (-1 where too few are in view), and the
        share of the patches in view there.
    """
    scale = 2.0**level
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    depth = 0.0
    for n in range(len(rho)):
        depth += rho[n]
    depth /= len(rho)
    height, width = image.shape
    half = (int(np.sqrt(patches.shape[2] + 0.5)) - 1) // 2
    shapes = _shapes(homographies, uv)
    templates, jacobians, normal = _prepare(patches, shapes)
    values = np.empty(patches.shape[2], np.float32)
    d = np.empty((2, 6))
    best_rotation, best_position, best_score, best_share = rotation.copy(), position.copy(), -1.0, 0.0
    rotation, position = rotation.copy(), position.copy()
    for _ in range(rounds + 1):
        h = np.zeros((6, 6))
        g = np.zeros(6)
        for i in range(6):
            h[i, i] = 1e-6
        seen, total = 0, 0.0
        for n in range(len(rho)):
            power, xx, xy, yy = normal[n, 0], normal[n, 1], normal[n, 2], normal[n, 3]
            if power <= 0.0:
                continue
            rx, ry = (uv[n, 0] - cx) / fx, (uv[n, 1] - cy) / fy
            r_wh, p_h = host_rotations[n], host_positions[n]
            wx = r_wh[0, 0] * rx + r_wh[0, 1] * ry + r_wh[0, 2] + rho[n] * (p_h[0] - position[0])
            wy = r_wh[1, 0] * rx + r_wh[1, 1] * ry + r_wh[1, 2] + rho[n] * (p_h[1] - position[1])
            wz = r_wh[2, 0] * rx + r_wh[2, 1] * ry + r_wh[2, 2] + rho[n] * (p_h[2] - position[2])
            z = rotation[0, 2] * wx + rotation[1, 2] * wy + rotation[2, 2] * wz
            if z < 1e-6:
                continue
            x_n = (rotation[0, 0] * wx + rotation[1, 0] * wy + rotation[2, 0] * wz) / z
            y_n = (rotation[0, 1] * wx + rotation[1, 1] * wy + rotation[2, 1] * wz) / z
            u = (fx * x_n + cx + 0.5) / scale - 0.5
            v = (fy * y_n + cy + 0.5) / scale - 0.5
            a00, a01, a10, a11 = shapes[n, 0], shapes[n, 1], shapes[n, 2], shapes[n, 3]
            reach_x, reach_y = half * (abs(a00) + abs(a01)), half * (abs(a10) + abs(a11))
            if u < reach_x or v < reach_y or u + reach_x >= width - 1.01 or v + reach_y >= height - 1.01:
                continue
            k = 0
            for j in range(-half, half + 1):
                for i in range(-half, half + 1):
                    values[k] = sample(image, np.float32(u + a00 * i + a01 * j), np.float32(v + a10 * i + a11 * j))
                    k += 1
            target = normalise(values)
            if target < 1e-3:
                continue
            dot = np.float32(0.0)
            for k in range(values.size):
                dot += values[k] * templates[n, k]
            correlation = dot / np.sqrt(power * target)
            seen += 1
            total += correlation
            gain = np.float32(np.sqrt(power / target))
            bx, by = np.float32(0.0), np.float32(0.0)
            for k in range(values.size):
                difference = gain * values[k] - templates[n, k]
                bx += jacobians[n, 0, k] * difference
                by += jacobians[n, 1, k] * difference
            # patches that differ much say little: the weight falls with what the warp leaves unexplained
            weight = 1.0 / (4.0 + 2.0 * power * (1.0 - correlation) / values.size)
            for i in range(2):
                f = (fx if i == 0 else fy) / (z * scale)
                s = x_n if i == 0 else y_n
                a = f * (rotation[0, i] - s * rotation[0, 2])
                b = f * (rotation[1, i] - s * rotation[1, 2])
                c = f * (rotation[2, i] - s * rotation[2, 2])
                d[i, 0], d[i, 1], d[i, 2] = -rho[n] * a, -rho[n] * b, -rho[n] * c
                d[i, 3], d[i, 4], d[i, 5] = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
            for i in range(6):
                p, q = weight * (xx * d[0, i] + xy * d[1, i]), weight * (xy * d[0, i] + yy * d[1, i])
                g[i] -= weight * (d[0, i] * bx + d[1, i] * by)
                for j in range(i, 6):
                    h[i, j] += p * d[0, j] + q * d[1, j]
        if seen < 8:
            break
        if total / seen > best_score:
            best_rotation, best_position = rotation, position
            best_score, best_share = total / seen, seen / len(rho)
        for i in range(6):
            for j in range(i):
                h[i, j] = h[j, i]
        update = solve(h, g)
        position = position.copy()
        largest = 0.0
        for i in range(3):
            position[i] += update[i]
            largest = max(largest, abs(update[i]) * depth, abs(update[3 + i]))
        rotation = turned(rotation, update[3], update[4], update[5])
        # a hundredth of a pixel of this level is enough
        if largest * fx < 0.02 * scale:
            break
    return best_rotation, best_position, best_score, best_share

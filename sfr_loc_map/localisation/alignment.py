"""Coarse pose of a new pair: all patches aligned together on small copies of the picture.

The pose itself is estimated from the differences of the patches (Forster et al. 2014), so weak patches are carried by
the others and a wrong prediction of many pixels is caught on the smallest copy.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sfr_loc_map.geometry.rotation import FloatArray
from sfr_loc_map.localisation.images import FloatImage
from sfr_loc_map.localisation.lie import exp_so3, orthonormal
from sfr_loc_map.localisation.patches import homography, patch_systems


@njit(cache=True)
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
    """Return the homographies `(N, 3, 3)` of all patches into one picture.

    Args:
        rotation: `(3, 3)` target camera to world.
        position: `(3,)` metres.
        host_rotations: `(N, 3, 3)`.
        host_positions: `(N, 3)`.
        uv: `(N, 2)` host pixels.
        rho: `(N,)` inverse depths there, 1/m.
        slopes: `(N, 2)` their change a pixel.
        camera: `(4,)` fx, fy, cx, cy.
        shift: Place of the target camera along x of the left one: 0 or the baseline, metres.
    """
    out = np.empty((len(rho), 3, 3))
    r_wc = rotation.T.copy()
    for n in range(len(rho)):
        offset = r_wc @ (host_positions[n] - position)
        offset[0] -= shift
        out[n] = homography(r_wc @ host_rotations[n], offset, camera, uv[n], rho[n], slopes[n])
    return out


@njit(cache=True)
def _scaled(homographies: FloatArray, scale: float) -> FloatArray:
    """Return the homographies between pictures that are `scale` times smaller."""
    down = np.array([[1 / scale, 0.0, 0.5 / scale - 0.5], [0.0, 1 / scale, 0.5 / scale - 0.5], [0.0, 0.0, 1.0]])
    up = np.array([[scale, 0.0, 0.5 * scale - 0.5], [0.0, scale, 0.5 * scale - 0.5], [0.0, 0.0, 1.0]])
    out = np.empty_like(homographies)
    for n in range(len(out)):
        out[n] = down @ homographies[n] @ up
    return out


@njit(cache=True)
def align_pose(
    image: FloatImage,
    level: int,
    patches: NDArray[np.float32],
    rotation: FloatArray,
    position: FloatArray,
    host_rotations: FloatArray,
    host_positions: FloatArray,
    uv: FloatArray,
    rho: FloatArray,
    slopes: FloatArray,
    camera: FloatArray,
    rounds: int,
) -> tuple[FloatArray, FloatArray, float, float]:
    """Align all patches with one level of the left picture.

    Args:
        image: Level of the pyramid.
        level: Its number.
        patches: `(N, 3, S * S)` of the hosts at this level.
        rotation: `(3, 3)` start, camera to world.
        position: `(3,)` start, metres.
        host_rotations: `(N, 3, 3)`.
        host_positions: `(N, 3)` metres.
        uv: `(N, 2)` host pixels at full size.
        rho: `(N,)` 1/m.
        slopes: `(N, 2)` 1/m a pixel.
        camera: `(4,)` at full size.
        rounds: Gauss-Newton rounds.

    Returns:
        Rotation, position, mean correlation of the patches at the best pose met (0 where none is in view), and the
        share of the patches in view.
    """
    scale = 2.0**level
    small = (uv + 0.5) / scale - 0.5
    best_rotation, best_position, best_score, best_share = rotation.copy(), position.copy(), -1.0, 0.0
    rotation, position = rotation.copy(), position.copy()
    for _ in range(rounds + 1):
        full = plane_homographies(rotation, position, host_rotations, host_positions, uv, rho, slopes, camera, 0.0)
        systems = patch_systems(image, patches, small, _scaled(full, scale))
        seen = 0
        total = 0.0
        for n in range(len(rho)):
            if not np.isnan(systems[n, 0]):
                seen += 1
                total += systems[n, 6]
        if seen < 8:
            break
        score = total / seen
        if score > best_score:
            best_rotation, best_position, best_score, best_share = rotation, position, score, seen / len(rho)
        r_wc = rotation.T.copy()
        h = np.eye(6) * 1e-6
        g = np.zeros(6)
        d = np.empty((2, 6))
        for n in range(len(rho)):
            if np.isnan(systems[n, 0]):
                continue
            w = host_rotations[n] @ np.array(
                [(uv[n, 0] - camera[2]) / camera[0], (uv[n, 1] - camera[3]) / camera[1], 1.0]
            ) + rho[n] * (host_positions[n] - position)
            y = r_wc @ w
            for i in range(2):
                f = camera[i] / (y[2] * scale)
                a = f * (r_wc[i, 0] - y[i] / y[2] * r_wc[2, 0])
                b = f * (r_wc[i, 1] - y[i] / y[2] * r_wc[2, 1])
                c = f * (r_wc[i, 2] - y[i] / y[2] * r_wc[2, 2])
                d[i, 0], d[i, 1], d[i, 2] = -rho[n] * a, -rho[n] * b, -rho[n] * c
                d[i, 3], d[i, 4], d[i, 5] = b * w[2] - c * w[1], c * w[0] - a * w[2], a * w[1] - b * w[0]
            # patches that differ much say little: the weight falls with what the warp leaves unexplained
            weight = 1.0 / (4.0 + systems[n, 5] ** 2)
            hxx, hxy, hyy = weight * systems[n, 0], weight * systems[n, 1], weight * systems[n, 2]
            bx, by = weight * systems[n, 3], weight * systems[n, 4]
            for i in range(6):
                g[i] -= d[0, i] * bx + d[1, i] * by
                for j in range(6):
                    h[i, j] += d[0, i] * (hxx * d[0, j] + hxy * d[1, j]) + d[1, i] * (hxy * d[0, j] + hyy * d[1, j])
        update = np.linalg.solve(h, g)
        position = position + update[:3]
        rotation = orthonormal(exp_so3(update[3:]) @ rotation)
    return best_rotation, best_position, best_score, best_share

"""Adjustment of a window of keyframes and landmarks (bundle adjustment with a prior from what left the window).

A landmark is a host pixel and its inverse depth: a stereo measurement is linear in it, and it may be infinitely far.
Landmarks are eliminated by the Schur complement (Triggs et al. 2000); keyframes that leave are marginalised, so that
their information stays (Leutenegger et al. 2015).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from sfr_loc_map.geometry.rotation import FloatArray
from sfr_loc_map.localisation.lie import exp_so3, orthonormal


@njit(cache=True)
def linearise(
    rotations: FloatArray,
    positions: FloatArray,
    host: FloatArray,
    uvrho: FloatArray,
    observed: FloatArray,
    variance: FloatArray,
    camera: FloatArray,
    baseline: float,
    only_host: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Linearise all landmarks and eliminate them.

    Args:
        rotations: `(K, 3, 3)` cameras to world.
        positions: `(K, 3)` metres.
        host: `(N,)` int64, keyframe of each landmark.
        uvrho: `(N, 3)` host pixel and inverse depth.
        observed: `(N, K, 4)` u, v left, u, v right; NaN where not seen.
        variance: `(N, K, 2, 3)` uu, uv, vv, px^2.
        camera: `(4,)` fx, fy, cx, cy.
        baseline: Metres.
        only_host: Take only the landmarks of this keyframe; -1 for all.

    Returns:
        Reduced normal matrix `(6 K, 6 K)` and right side `(6 K,)`; for each landmark the inverse of its own block
        `(N, 3, 3)`, its right side `(N, 3)` and its coupling `(N, 3, 6 K)`; the robust cost.
    """
    count, window = observed.shape[0], observed.shape[1]
    h = np.zeros((6 * window, 6 * window))
    g = np.zeros(6 * window)
    inverse = np.zeros((count, 3, 3))
    right_side = np.zeros((count, 3))
    coupling = np.zeros((count, 3, 6 * window))
    cost = 0.0
    jacobian = np.zeros((2, 15))
    for n in range(count):
        hk = host[n]
        if hk < 0 or (only_host >= 0 and hk != only_host):
            continue
        ll = np.zeros((3, 3))
        # a wish of one pixel for the host pixel keeps a landmark seen only once solvable
        ll[2, 2] += 1e-6
        rl = np.zeros(3)
        cl = np.zeros((3, 6 * window))
        ray = np.array([(uvrho[n, 0] - camera[2]) / camera[0], (uvrho[n, 1] - camera[3]) / camera[1], 1.0])
        rho = uvrho[n, 2]
        turned = rotations[hk] @ ray
        for k in range(window):
            if np.isnan(observed[n, k, 0]) and np.isnan(observed[n, k, 2]):
                continue
            r_wc = rotations[k].T.copy()
            between = positions[hk] - positions[k]
            w = turned + rho * between
            y = r_wc @ w
            if y[2] < 1e-6:
                continue
            relative = r_wc @ rotations[hk]
            offset = r_wc @ between
            for side in range(2):
                if np.isnan(observed[n, k, 2 * side]):
                    continue
                shift = baseline if side == 1 else 0.0
                x_n, y_n = (y[0] - shift * rho) / y[2], y[1] / y[2]
                residual = np.array(
                    [
                        observed[n, k, 2 * side] - (camera[0] * x_n + camera[2]),
                        observed[n, k, 2 * side + 1] - (camera[1] * y_n + camera[3]),
                    ]
                )
                for i in range(2):
                    f = camera[i] / y[2]
                    d = (f, 0.0, -f * x_n) if i == 0 else (0.0, f, -f * y_n)
                    dw = np.zeros(3)
                    for c in range(3):
                        dw[c] = d[0] * r_wc[0, c] + d[1] * r_wc[1, c] + d[2] * r_wc[2, c]
                    # target: position, rotation about the world's axes
                    for c in range(3):
                        jacobian[i, c] = -rho * dw[c]
                        jacobian[i, 6 + c] = rho * dw[c]
                    jacobian[i, 3] = dw[1] * w[2] - dw[2] * w[1]
                    jacobian[i, 4] = dw[2] * w[0] - dw[0] * w[2]
                    jacobian[i, 5] = dw[0] * w[1] - dw[1] * w[0]
                    # host: turning it by theta turns the ray in the world
                    jacobian[i, 9] = dw[2] * turned[1] - dw[1] * turned[2]
                    jacobian[i, 10] = dw[0] * turned[2] - dw[2] * turned[0]
                    jacobian[i, 11] = dw[1] * turned[0] - dw[0] * turned[1]
                    # landmark
                    for c in range(2):
                        jacobian[i, 12 + c] = (
                            d[0] * relative[0, c] + d[1] * relative[1, c] + d[2] * relative[2, c]
                        ) / camera[c]
                    jacobian[i, 14] = d[0] * (offset[0] - shift) + d[1] * offset[1] + d[2] * offset[2]
                uu, uv, vv = variance[n, k, side, 0], variance[n, k, side, 1], variance[n, k, side, 2]
                det = uu * vv - uv * uv
                i00, i01, i11 = vv / det, -uv / det, uu / det
                chi = i00 * residual[0] ** 2 + 2.0 * i01 * residual[0] * residual[1] + i11 * residual[1] ** 2
                weight = 1.0 / (1.0 + chi / 6.0) ** 2
                cost += 6.0 * chi / (6.0 + chi)
                for a in range(15):
                    wa0 = weight * (i00 * jacobian[0, a] + i01 * jacobian[1, a])
                    wa1 = weight * (i01 * jacobian[0, a] + i11 * jacobian[1, a])
                    value = wa0 * residual[0] + wa1 * residual[1]
                    if a >= 12:
                        rl[a - 12] += value
                        for b in range(12, 15):
                            ll[a - 12, b - 12] += wa0 * jacobian[0, b] + wa1 * jacobian[1, b]
                        if k != hk:
                            for b in range(12):
                                column = (6 * k + b) if b < 6 else (6 * hk + b - 6)
                                cl[a - 12, column] += wa0 * jacobian[0, b] + wa1 * jacobian[1, b]
                    elif k != hk:
                        row = (6 * k + a) if a < 6 else (6 * hk + a - 6)
                        g[row] += value
                        for b in range(12):
                            column = (6 * k + b) if b < 6 else (6 * hk + b - 6)
                            h[row, column] += wa0 * jacobian[0, b] + wa1 * jacobian[1, b]
        li = np.linalg.inv(ll)
        inverse[n] = li
        right_side[n] = rl
        coupling[n] = cl
        reduced = li @ cl
        step = li @ rl
        for k in range(window):
            if k != hk and np.isnan(observed[n, k, 0]) and np.isnan(observed[n, k, 2]):
                continue
            for a in range(6 * k, 6 * k + 6):
                for i in range(3):
                    g[a] -= cl[i, a] * step[i]
                for m in range(window):
                    if m != hk and np.isnan(observed[n, m, 0]) and np.isnan(observed[n, m, 2]):
                        continue
                    for b in range(6 * m, 6 * m + 6):
                        h[a, b] -= cl[0, a] * reduced[0, b] + cl[1, a] * reduced[1, b] + cl[2, a] * reduced[2, b]
    return h, g, inverse, right_side, coupling, cost


@njit(cache=True)
def pose_difference(
    rotations: FloatArray, positions: FloatArray, rotations_0: FloatArray, positions_0: FloatArray
) -> FloatArray:
    """Return how far poses are from where a prior was linearised, `(6 K,)`: metres and radians, world axes."""
    count = len(rotations)
    out = np.zeros(6 * count)
    for k in range(count):
        out[6 * k : 6 * k + 3] = positions[k] - positions_0[k]
        turn = rotations[k] @ rotations_0[k].T
        out[6 * k + 3] = 0.5 * (turn[2, 1] - turn[1, 2])
        out[6 * k + 4] = 0.5 * (turn[0, 2] - turn[2, 0])
        out[6 * k + 5] = 0.5 * (turn[1, 0] - turn[0, 1])
    return out


@njit(cache=True)
def adjust(
    rotations: FloatArray,
    positions: FloatArray,
    host: FloatArray,
    uvrho: FloatArray,
    observed: FloatArray,
    variance: FloatArray,
    camera: FloatArray,
    baseline: float,
    prior_h: FloatArray,
    prior_g: FloatArray,
    rotations_0: FloatArray,
    positions_0: FloatArray,
    rounds: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Adjust keyframes and landmarks by Gauss-Newton with robust weights.

    Args: as `linearise`, and the prior's normal matrix `(6 K, 6 K)` and right side `(6 K,)` at the poses with `_0`.

    Returns:
        New rotations, positions, landmarks `(N, 3)`, their covariances given the poses `(N, 3, 3)`, and the
        covariance of all poses `(6 K, 6 K)`.
    """
    rotations, positions, uvrho = rotations.copy(), positions.copy(), uvrho.copy()
    h = prior_h.copy()
    inverse = np.zeros((len(host), 3, 3))
    for _ in range(rounds):
        h, g, inverse, right_side, coupling, _cost = linearise(
            rotations, positions, host, uvrho, observed, variance, camera, baseline, -1
        )
        h += prior_h
        g += prior_g - prior_h @ pose_difference(rotations, positions, rotations_0, positions_0)
        update = np.linalg.solve(h, g)
        for n in range(len(host)):
            if host[n] >= 0:
                uvrho[n] += inverse[n] @ (right_side[n] - coupling[n] @ update)
        for k in range(len(rotations)):
            positions[k] += update[6 * k : 6 * k + 3]
            rotations[k] = orthonormal(exp_so3(update[6 * k + 3 : 6 * k + 6]) @ rotations[k])
        if np.abs(update).max() < 1e-6:
            break
    return rotations, positions, uvrho, inverse, np.linalg.inv(h)

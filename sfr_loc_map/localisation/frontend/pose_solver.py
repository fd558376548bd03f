"""Pose of one stereo pair from landmarks that are known with their uncertainty."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.small_linalg import inverse, solve, turned
from sfr_loc_map.jit import jit_fast
from sfr_loc_map.localisation.backend.projection import linearise_landmark


@jit_fast
def solve_pose(  # noqa: C901 - one loop of machine code
    rotation: FloatArray,
    position: FloatArray,
    host_rotations: FloatArray,
    host_positions: FloatArray,
    rays: FloatArray,
    rho: FloatArray,
    landmark_covariance: FloatArray,
    observed: FloatArray,
    variance: FloatArray,
    camera: FloatArray,
    baseline: float,
    rounds: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Estimate the pose of a pair by robust weighted least squares on both pictures.

    Each landmark's residual (u, v left, u, v right) is weighted by the inverse of `R + J P J^T`: the tracking noise and
    the landmark's own uncertainty, which is the same as estimating the landmark too (marginalisation). Robust by
    Geman-McClure weights whose scale comes down to the residuals' own (graduated).

    Args:
        rotation: `(3, 3)` start, camera to world.
        position: `(3,)` start, metres, camera in world.
        host_rotations: `(N, 3, 3)` host cameras to world.
        host_positions: `(N, 3)` metres.
        rays: `(N, 3)` host rays `K^-1 (u, v, 1)`.
        rho: `(N,)` 1/m.
        landmark_covariance: `(N, 3, 3)` of (u, v, rho) in the host, px and 1/m.
        observed: `(N, 4)` u, v left, u, v right; NaN where not seen.
        variance: `(N, 2, 3)` uu, uv, vv of the left and right positions, px^2.
        camera: `(4,)` fx, fy, cx, cy.
        baseline: Metres.
        rounds: Gauss-Newton rounds.

    Returns:
        Rotation, position, information `(6, 6)` (position and rotation about the fixed axes of the world), and
        `(N,)` squared Mahalanobis residual divided by its degrees of freedom (NaN where not used).
    """
    count = len(rho)
    r_cw, p_c = rotation.copy(), position.copy()
    whitening = np.zeros((count, 4, 4))
    jacobians = np.zeros((count, 4, 6))
    residuals = np.zeros((count, 4))
    chi = np.full(count, np.nan)
    h, g = np.zeros((6, 6)), np.zeros(6)
    s, j_host, j_mark, out, jw = np.zeros((4, 4)), np.zeros((4, 6)), np.zeros((4, 3)), np.zeros(4), np.zeros(4)
    for step in range(rounds):
        for n in range(count):
            chi[n] = np.nan
            left, right = not np.isnan(observed[n, 0]), not np.isnan(observed[n, 2])
            if not (left or right):
                continue
            z = linearise_landmark(
                r_cw,
                p_c,
                host_rotations[n],
                host_positions[n],
                rays[n],
                rho[n],
                camera,
                baseline,
                out,
                jacobians[n],
                j_host,
                j_mark,
            )
            if z <= 0.0:
                continue
            for i in range(4):
                residuals[n, i] = observed[n, i] - out[i] if (left if i < 2 else right) else 0.0
            if step == 0:
                p = landmark_covariance[n]
                for i in range(4):
                    for j in range(4):
                        s[i, j] = 0.0
                        for a in range(3):
                            for b in range(3):
                                s[i, j] += j_mark[i, a] * p[a, b] * j_mark[j, b]
                for side in range(2):
                    i = 2 * side
                    if left if side == 0 else right:
                        s[i, i] += variance[n, side, 0]
                        s[i, i + 1] += variance[n, side, 1]
                        s[i + 1, i] += variance[n, side, 1]
                        s[i + 1, i + 1] += variance[n, side, 2]
                    else:
                        s[i, i] += 1e8
                        s[i + 1, i + 1] += 1e8
                white = inverse(s)
                for i in range(4):
                    for j in range(4):
                        whitening[n, i, j] = white[i, j]
            total = 0.0
            for i in range(4):
                for j in range(4):
                    total += residuals[n, i] * whitening[n, i, j] * residuals[n, j]
            chi[n] = total / ((2.0 if left else 0.0) + (2.0 if right else 0.0))
        used = chi[~np.isnan(chi)]
        if len(used) < 6:
            break
        scale = max(1.0, np.median(used) * 1.5) * (4.0 if step == 0 else 1.0)
        h, g = np.zeros((6, 6)), np.zeros(6)
        for n in range(count):
            if np.isnan(chi[n]):
                continue
            weight = 1.0 / (1.0 + chi[n] / scale) ** 2
            j_n = jacobians[n]
            for a in range(6):
                for i in range(4):
                    jw[i] = 0.0
                    for j in range(4):
                        jw[i] += j_n[j, a] * whitening[n, j, i]
                    jw[i] *= weight
                    g[a] += jw[i] * residuals[n, i]
                for b in range(a, 6):
                    for i in range(4):
                        h[a, b] += jw[i] * j_n[i, b]
        for a in range(6):
            for b in range(a):
                h[a, b] = h[b, a]
        update = solve(h, g)
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(update[i]))
        for i in range(3):
            p_c[i] += update[i]
        r_cw = turned(r_cw, update[3], update[4], update[5])
        if largest < 1e-6:
            break
    return r_cw, p_c, h, chi

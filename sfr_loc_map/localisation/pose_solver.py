"""Pose of one stereo pair from landmarks that are known with their uncertainty."""

from __future__ import annotations

import numpy as np
from numba import njit

from sfr_loc_map.geometry.rotation import FloatArray
from sfr_loc_map.localisation.lie import exp_so3, orthonormal


@njit(cache=True, inline="always")
def project(rotation, translation, ray, rho, camera, baseline, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN201
    """Project a landmark into both pictures: `out[:4]` = u, v left, u, v right; return the scaled depth."""
    x = rotation[0, 0] * ray[0] + rotation[0, 1] * ray[1] + rotation[0, 2] * ray[2] + rho * translation[0]
    y = rotation[1, 0] * ray[0] + rotation[1, 1] * ray[1] + rotation[1, 2] * ray[2] + rho * translation[1]
    z = rotation[2, 0] * ray[0] + rotation[2, 1] * ray[1] + rotation[2, 2] * ray[2] + rho * translation[2]
    if z < 1e-6:
        return 0.0
    out[0] = camera[0] * x / z + camera[2]
    out[1] = camera[1] * y / z + camera[3]
    out[2] = camera[0] * (x - baseline * rho) / z + camera[2]
    out[3] = out[1]
    return z


@njit(cache=True)
def predict(
    rotations: FloatArray,
    translations: FloatArray,
    rays: FloatArray,
    rho: FloatArray,
    camera: FloatArray,
    baseline: float,
) -> FloatArray:
    """Project landmarks.

    Args:
        rotations: `(N, 3, 3)`, host camera to target camera.
        translations: `(N, 3)`, metres, host origin in the target camera.
        rays: `(N, 3)` host rays `K^-1 (u, v, 1)`.
        rho: `(N,)` inverse depths in the host, 1/m.
        camera: `(4,)` fx, fy, cx, cy.
        baseline: Metres.

    Returns:
        `(N, 4)`: u, v left, u, v right, pixels; NaN behind the camera.
    """
    out = np.full((len(rho), 4), np.nan)
    row = np.empty(4)
    for n in range(len(rho)):
        if project(rotations[n], translations[n], rays[n], rho[n], camera, baseline, row) > 0.0:
            out[n] = row
    return out


@njit(cache=True)
def solve_pose(
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
    prior: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Estimate the pose of a pair by robust weighted least squares on both pictures.

    Each landmark's residual (u, v left, u, v right) is weighted by the inverse of `R + J P J^T`: the tracking noise and
    the landmark's own uncertainty, which is the same as estimating the landmark too (marginalisation). Robust by
    Cauchy weights whose scale comes down to the residuals' own (graduated).

    Args:
        rotation: `(3, 3)` start, camera to world.
        position: `(3,)` start, metres, camera in world.
        host_rotations: `(N, 3, 3)` host cameras to world.
        host_positions: `(N, 3)` metres.
        rays: `(N, 3)` host rays.
        rho: `(N,)` 1/m.
        landmark_covariance: `(N, 3, 3)` of (u, v, rho) in the host, px and 1/m.
        observed: `(N, 4)` u, v left, u, v right; NaN where not seen.
        variance: `(N, 2, 3)` uu, uv, vv of the left and right positions, px^2.
        camera: `(4,)` fx, fy, cx, cy.
        baseline: Metres.
        rounds: Gauss-Newton rounds.
        prior: Weight (1/m^2, 1/rad^2) that holds the start: 0 for none.

    Returns:
        Rotation, position, information `(6, 6)` (position and rotation about the fixed axes of the world), and
        `(N,)` squared Mahalanobis residual divided by its degrees of freedom (NaN where not used).
    """
    count = len(rho)
    r_cw = rotation.copy()
    p_c = position.copy()
    whitening = np.zeros((count, 4, 4))
    jacobians = np.zeros((count, 4, 6))
    residuals = np.zeros((count, 4))
    chi = np.full(count, np.nan)
    information = np.zeros((6, 6))
    out = np.empty(4)
    for step in range(rounds):
        r_wc = r_cw.T.copy()
        for n in range(count):
            seen_left, seen_right = not np.isnan(observed[n, 0]), not np.isnan(observed[n, 2])
            chi[n] = np.nan
            if not (seen_left or seen_right):
                continue
            relative = r_wc @ host_rotations[n]
            offset = r_wc @ (host_positions[n] - p_c)
            z = project(relative, offset, rays[n], rho[n], camera, baseline, out)
            if z <= 0.0:
                continue
            for i in range(4):
                seen = seen_left if i < 2 else seen_right
                residuals[n, i] = observed[n, i] - out[i] if seen else 0.0
            x_n = (out[0] - camera[2]) / camera[0]
            y_n = (out[1] - camera[3]) / camera[1]
            xr_n = (out[2] - camera[2]) / camera[0]
            d = np.zeros((4, 3))
            d[0, 0], d[0, 2] = camera[0] / z, -camera[0] * x_n / z
            d[1, 1], d[1, 2] = camera[1] / z, -camera[1] * y_n / z
            d[2, 0], d[2, 2] = camera[0] / z, -camera[0] * xr_n / z
            d[3, 1], d[3, 2] = camera[1] / z, -camera[1] * y_n / z
            d_world = d @ r_wc
            w = host_rotations[n] @ rays[n] + rho[n] * (host_positions[n] - p_c)
            for i in range(4):
                a, b, c = d_world[i, 0], d_world[i, 1], d_world[i, 2]
                jacobians[n, i, 0], jacobians[n, i, 1], jacobians[n, i, 2] = -rho[n] * a, -rho[n] * b, -rho[n] * c
                # y = R_wc w, and turning the camera by theta turns w by -theta: d y = R_wc [w]x theta
                jacobians[n, i, 3] = b * w[2] - c * w[1]
                jacobians[n, i, 4] = c * w[0] - a * w[2]
                jacobians[n, i, 5] = a * w[1] - b * w[0]
            if step == 0:
                j_l = np.empty((4, 3))
                d_host = d @ relative
                j_l[:, 0] = d_host[:, 0] / camera[0]
                j_l[:, 1] = d_host[:, 1] / camera[1]
                for i in range(4):
                    j_l[i, 2] = d[i, 0] * offset[0] + d[i, 1] * offset[1] + d[i, 2] * offset[2]
                j_l[2, 2] -= camera[0] / z * baseline
                s = j_l @ landmark_covariance[n] @ j_l.T
                big = 1e8
                s[0, 0] += variance[n, 0, 0] if seen_left else big
                s[1, 1] += variance[n, 0, 2] if seen_left else big
                s[2, 2] += variance[n, 1, 0] if seen_right else big
                s[3, 3] += variance[n, 1, 2] if seen_right else big
                if seen_left:
                    s[0, 1] += variance[n, 0, 1]
                    s[1, 0] += variance[n, 0, 1]
                if seen_right:
                    s[2, 3] += variance[n, 1, 1]
                    s[3, 2] += variance[n, 1, 1]
                whitening[n] = np.linalg.inv(s)
            freedom = (2.0 if seen_left else 0.0) + (2.0 if seen_right else 0.0)
            chi[n] = residuals[n] @ whitening[n] @ residuals[n] / freedom
        used = chi[~np.isnan(chi)]
        if len(used) < 6:
            break
        scale = max(1.0, np.median(used) * 1.5) * (4.0 if step == 0 else 1.0)
        h = np.eye(6) * prior
        g = np.zeros(6)
        for n in range(count):
            if np.isnan(chi[n]):
                continue
            weight = 1.0 / (1.0 + chi[n] / scale) ** 2
            jw = jacobians[n].T @ whitening[n]
            h += weight * (jw @ jacobians[n])
            g += weight * (jw @ residuals[n])
        information = h
        update = np.linalg.solve(h, g)
        p_c = p_c + update[:3]
        r_cw = orthonormal(exp_so3(update[3:]) @ r_cw)
        if np.abs(update).max() < 1e-7:
            break
    return r_cw, p_c, information, chi

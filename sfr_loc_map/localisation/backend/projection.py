"""Projection of a landmark, a host pixel with its inverse depth, into another stereo pair."""

from __future__ import annotations

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.jit import jit_fast_ir_inline


@jit_fast_ir_inline
def linearise_landmark(
    r_cw: FloatArray,
    p_c: FloatArray,
    r_wh: FloatArray,
    p_h: FloatArray,
    ray: FloatArray,
    rho: float,
    camera: FloatArray,
    baseline: float,
    out: FloatArray,
    j_pose: FloatArray,
    j_host: FloatArray,
    j_mark: FloatArray,
) -> float:
    """Project a landmark into both pictures, with derivatives; return the scaled depth, 0 behind the camera.

    Fills out `(4,)` u, v left, u, v right; j_pose `(4, 6)` by position and rotation about the world's axes of the
    target, j_host `(4, 6)` of the host; j_mark `(4, 3)` by the host pixel and the inverse depth.
    """
    tx = r_wh[0, 0] * ray[0] + r_wh[0, 1] * ray[1] + r_wh[0, 2]
    ty = r_wh[1, 0] * ray[0] + r_wh[1, 1] * ray[1] + r_wh[1, 2]
    tz = r_wh[2, 0] * ray[0] + r_wh[2, 1] * ray[1] + r_wh[2, 2]
    bx, by, bz = p_h[0] - p_c[0], p_h[1] - p_c[1], p_h[2] - p_c[2]
    wx, wy, wz = tx + rho * bx, ty + rho * by, tz + rho * bz
    z: float = r_cw[0, 2] * wx + r_cw[1, 2] * wy + r_cw[2, 2] * wz
    if z < 1e-6:
        return 0.0
    x = (r_cw[0, 0] * wx + r_cw[1, 0] * wy + r_cw[2, 0] * wz) / z
    y = (r_cw[0, 1] * wx + r_cw[1, 1] * wy + r_cw[2, 1] * wz) / z
    for i in range(4):
        axis = i % 2
        f = camera[axis] / z
        s = (x if i == 0 else x - baseline * rho / z) if axis == 0 else y
        out[i] = camera[axis] * s + camera[2 + axis]
        # derivative by the point in world axes
        a = f * (r_cw[0, axis] - s * r_cw[0, 2])
        b = f * (r_cw[1, axis] - s * r_cw[1, 2])
        c = f * (r_cw[2, axis] - s * r_cw[2, 2])
        j_pose[i, 0], j_pose[i, 1], j_pose[i, 2] = -rho * a, -rho * b, -rho * c
        # turning the camera by theta turns the point by -theta: d y = R_wc [w]x theta
        j_pose[i, 3], j_pose[i, 4], j_pose[i, 5] = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
        j_host[i, 0], j_host[i, 1], j_host[i, 2] = rho * a, rho * b, rho * c
        j_host[i, 3], j_host[i, 4], j_host[i, 5] = c * ty - b * tz, a * tz - c * tx, b * tx - a * ty
        j_mark[i, 0] = (a * r_wh[0, 0] + b * r_wh[1, 0] + c * r_wh[2, 0]) / camera[0]
        j_mark[i, 1] = (a * r_wh[0, 1] + b * r_wh[1, 1] + c * r_wh[2, 1]) / camera[1]
        j_mark[i, 2] = a * bx + b * by + c * bz
        if i == 2:
            j_mark[i, 2] -= f * baseline
    return z

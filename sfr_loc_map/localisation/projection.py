"""Projection of a landmark, a host pixel with an inverse depth, into another stereo pair."""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast_ir_inline

TARGET, HOST, LANDMARK, UNKNOWNS = 0, 6, 12, 15
"""Columns of the Jacobian of a projection."""


class Projection(NamedTuple):
    """A projected landmark with its Jacobians; rows are u, v in the left image, u, v in the right image.

    A rotation is about the fixed axes of the world: `R <- exp([w]x) R`.

    Attributes:
        uv: `(4,)` pixels.
        jacobian: `(4, 15)`: from column `TARGET` on by position and rotation of the target camera, from `HOST` on by
            those of the host camera, from `LANDMARK` on by host pixel u, v and inverse depth.
    """

    uv: FloatArray
    jacobian: FloatArray


@jit_fast_ir_inline
def linearise_landmark(
    target: Pose, hosts: Poses, k: int, ray: FloatArray, inverse_depth: float, camera: StereoCamera, out: Projection
) -> float:
    """Project a landmark into both images, with Jacobians.

    The target is the left camera of the pair, `hosts[k]` that of the keyframe with the landmark, whose host ray
    `K^-1 (u, v, 1)` is `(3,)` and whose inverse depth is in 1/m. The projection is filled.

    Returns:
        Depth in the target camera times the inverse depth; 0, with `out` untouched, behind the camera.
    """
    r_cw, r_wh, p_h = target.rotation, hosts.rotations[k], hosts.positions[k]
    tx = r_wh[0, 0] * ray[0] + r_wh[0, 1] * ray[1] + r_wh[0, 2]
    ty = r_wh[1, 0] * ray[0] + r_wh[1, 1] * ray[1] + r_wh[1, 2]
    tz = r_wh[2, 0] * ray[0] + r_wh[2, 1] * ray[1] + r_wh[2, 2]
    p_c = target.position
    bx, by, bz = p_h[0] - p_c[0], p_h[1] - p_c[1], p_h[2] - p_c[2]
    wx, wy, wz = tx + inverse_depth * bx, ty + inverse_depth * by, tz + inverse_depth * bz
    z: float = r_cw[0, 2] * wx + r_cw[1, 2] * wy + r_cw[2, 2] * wz
    if z < 1e-6:
        return 0.0
    x = (r_cw[0, 0] * wx + r_cw[1, 0] * wy + r_cw[2, 0] * wz) / z
    y = (r_cw[0, 1] * wx + r_cw[1, 1] * wy + r_cw[2, 1] * wz) / z
    uv, j = out.uv, out.jacobian
    for i in range(4):
        axis = i % 2
        focal, centre = (camera.fx, camera.cx) if axis == 0 else (camera.fy, camera.cy)
        f = focal / z
        s = (x if i == 0 else x - camera.baseline_m * inverse_depth / z) if axis == 0 else y
        uv[i] = focal * s + centre
        # derivative by the point in world axes
        a = f * (r_cw[0, axis] - s * r_cw[0, 2])
        b = f * (r_cw[1, axis] - s * r_cw[1, 2])
        c = f * (r_cw[2, axis] - s * r_cw[2, 2])
        j[i, TARGET + 0], j[i, TARGET + 1], j[i, TARGET + 2] = (
            -inverse_depth * a,
            -inverse_depth * b,
            -inverse_depth * c,
        )
        # rotating the camera by theta rotates the point by -theta: d y = R_wc [w]x theta
        j[i, TARGET + 3], j[i, TARGET + 4], j[i, TARGET + 5] = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
        j[i, HOST + 0], j[i, HOST + 1], j[i, HOST + 2] = inverse_depth * a, inverse_depth * b, inverse_depth * c
        j[i, HOST + 3], j[i, HOST + 4], j[i, HOST + 5] = c * ty - b * tz, a * tz - c * tx, b * tx - a * ty
        j[i, LANDMARK + 0] = (a * r_wh[0, 0] + b * r_wh[1, 0] + c * r_wh[2, 0]) / camera.fx
        j[i, LANDMARK + 1] = (a * r_wh[0, 1] + b * r_wh[1, 1] + c * r_wh[2, 1]) / camera.fy
        j[i, LANDMARK + 2] = a * bx + b * by + c * bz
        if i == 2:
            j[i, LANDMARK + 2] -= f * camera.baseline_m
    return z

"""Projection of a landmark, a host pixel with an inverse depth, into another stereo pair."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast_ir_inline


class Projection(NamedTuple):
    """A projected landmark with its Jacobians; rows are u, v in the left image, u, v in the right image.

    A rotation is about the fixed axes of the world: `R <- exp([w]x) R`.

    Attributes:
        uv: `(4,)` pixels.
        by_target: `(4, 6)` derivative by position and rotation of the target camera.
        by_landmark: `(4, 3)` by host pixel u, v and inverse depth.
    """

    uv: FloatArray
    by_target: FloatArray
    by_landmark: FloatArray


class Intrinsics(NamedTuple):
    """Camera of both images, in arrays by axis (u, v).

    What is read from an array is a value of its own for the compiler, which sums in any order: with the scalars of
    `StereoCamera` in their place the results would differ by rounding.

    Attributes:
        focal: `(2,)` focal lengths, pixels.
        centre: `(2,)` principal point, pixels.
        baseline_m: Distance between the optical centres, metres.
    """

    focal: FloatArray
    centre: FloatArray
    baseline_m: float


@jit_fast_ir_inline
def intrinsics(camera: StereoCamera) -> Intrinsics:
    """Return the intrinsics of a camera."""
    return Intrinsics(np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy]), camera.baseline_m)


@jit_fast_ir_inline
def new_projection() -> Projection:
    """Return a projection to be filled."""
    return Projection(np.zeros(4), np.zeros((4, 6)), np.zeros((4, 3)))


@jit_fast_ir_inline
def linearise_in_host(landmark: FloatArray, camera: Intrinsics, out: Projection) -> None:
    """Project a landmark, `(3,)` u, v, px, and inverse depth, 1/m, into its own pair; `by_target` stays as it is."""
    uv, j_mark, per_depth = out.uv, out.by_landmark, camera.focal[0] * camera.baseline_m
    for i in range(4):
        uv[i] = landmark[i % 2]
        for b in range(3):
            j_mark[i, b] = 1.0 if b == i % 2 else 0.0
    uv[2] -= per_depth * landmark[2]
    j_mark[2, 2] = -per_depth


@jit_fast_ir_inline
def linearise_landmark(
    target: Pose, hosts: Poses, k: int, ray: FloatArray, inverse_depth: float, camera: Intrinsics, out: Projection
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
    focal, centre, baseline = camera.focal, camera.centre, camera.baseline_m
    uv, j_pose, j_mark = out.uv, out.by_target, out.by_landmark
    for i in range(4):
        axis = i % 2
        f = focal[axis] / z
        s = (x if i == 0 else x - baseline * inverse_depth / z) if axis == 0 else y
        uv[i] = focal[axis] * s + centre[axis]
        # derivative by the point in world axes
        a = f * (r_cw[0, axis] - s * r_cw[0, 2])
        b = f * (r_cw[1, axis] - s * r_cw[1, 2])
        c = f * (r_cw[2, axis] - s * r_cw[2, 2])
        j_pose[i, 0], j_pose[i, 1], j_pose[i, 2] = -inverse_depth * a, -inverse_depth * b, -inverse_depth * c
        # rotating the camera by theta rotates the point by -theta: d y = R_wc [w]x theta
        j_pose[i, 3], j_pose[i, 4], j_pose[i, 5] = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx
        j_mark[i, 0] = (a * r_wh[0, 0] + b * r_wh[1, 0] + c * r_wh[2, 0]) / focal[0]
        j_mark[i, 1] = (a * r_wh[0, 1] + b * r_wh[1, 1] + c * r_wh[2, 1]) / focal[1]
        j_mark[i, 2] = a * bx + b * by + c * bz
        if i == 2:
            j_mark[i, 2] -= f * baseline
    return z

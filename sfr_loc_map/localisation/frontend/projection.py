"""Projection of a landmark into the images of a stereo pair, with its Jacobians.

A landmark is a pixel (u, v) of its host image with an inverse depth rho (Civera et al. 2008). Its host ray is
`r = K^-1 (u, v, 1)`. The pose of the host camera is `R_wh, p_h`, and the pose of the target camera is `R_wc, p_c`. The
vector from the target camera to the landmark, multiplied by rho, is

    d = R_wh r + rho (p_h - p_c)    along the axes of the world,
    q = R_wc^T d                    along the axes of the target camera.

The vector is finite for a landmark at infinity. The left pixel is `u = fx q_x / q_z + cx`, `v = fy q_y / q_z + cy`. In
the right image, u is smaller by `fx b rho / q_z` with the baseline b. Rotations w are about the fixed axes of the
world: `R <- exp([w]x) R`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast_ir_inline

MIN_SCALED_DEPTH = 1e-6  #: Depth times inverse depth, no unit, below which a landmark counts as behind the camera.


class Vector(NamedTuple):
    """A vector along the axes of the world."""

    x: float
    y: float
    z: float


class StereoProjection(NamedTuple):
    """A projected landmark with its Jacobians; rows are u, v in the left image, u, v in the right image."""

    uv: FloatArray  #: `(4,)` pixels.
    by_target: FloatArray  #: `(4, 6)` Jacobian with respect to position and rotation of the target camera.
    by_landmark: FloatArray  #: `(4, 3)` Jacobian with respect to host pixel u, v and inverse depth.


class Intrinsics(NamedTuple):
    """Intrinsics of both cameras, in arrays by axis (u, v).

    The compiler may reorder sums, and the order depends on which values are read from arrays. With the scalars of
    `StereoCamera` in place of these arrays, results would differ by rounding.
    """

    focal: FloatArray  #: `(2,)` focal lengths, pixels.
    centre: FloatArray  #: `(2,)` principal point, pixels.
    baseline_m: float  #: Distance between the optical centres, metres.


@jit_fast_ir_inline
def intrinsics(camera: StereoCamera) -> Intrinsics:
    """Return the intrinsics of a camera."""
    return Intrinsics(np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy]), camera.baseline_m)


@jit_fast_ir_inline
def new_projection() -> StereoProjection:
    """Return an empty projection."""
    return StereoProjection(np.zeros(4), np.zeros((4, 6)), np.zeros((4, 3)))


@jit_fast_ir_inline
def rotated_ray(rotation: FloatArray, x: float, y: float) -> Vector:
    """Return the ray `(x, y, 1)` of a camera with a given rotation, along the axes of the world."""
    world_x = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
    world_y = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
    world_z = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
    return Vector(world_x, world_y, world_z)


@jit_fast_ir_inline
def difference(a: FloatArray, b: FloatArray) -> Vector:
    """Return the difference `a - b` of positions `(3,)`, metres."""
    return Vector(a[0] - b[0], a[1] - b[1], a[2] - b[2])


@jit_fast_ir_inline
def scaled_point(ray: Vector, host_offset: Vector, inverse_depth: float) -> Vector:
    """Return the vector d from a camera to a landmark, multiplied by the landmark's inverse depth.

    The ray is the host ray. The host offset is the position of the host camera relative to the camera, metres. The
    inverse depth is in 1/m.
    """
    x = ray.x + inverse_depth * host_offset.x
    y = ray.y + inverse_depth * host_offset.y
    z = ray.z + inverse_depth * host_offset.z
    return Vector(x, y, z)


@jit_fast_ir_inline
def point_from(target: Pose, hosts: Poses, k: int, ray_x: float, ray_y: float, inverse_depth: float) -> Vector:
    """Return the `scaled_point` from the target camera of a landmark with the ray `(ray_x, ray_y, 1)` in `hosts[k]`."""
    host_ray = rotated_ray(hosts.rotations[k], ray_x, ray_y)
    return scaled_point(host_ray, difference(hosts.positions[k], target.position), inverse_depth)


@jit_fast_ir_inline
def component(rotation: FloatArray, axis: int, vector: Vector) -> float:
    """Return the component of a vector along an axis of a camera: `(R_wc^T d)[axis]`."""
    along: float = rotation[0, axis] * vector.x + rotation[1, axis] * vector.y + rotation[2, axis] * vector.z
    return along


@jit_fast_ir_inline
def gradient(focal_per_depth: float, coordinate: float, image_axis: float, optical_axis: float) -> float:
    """Return the derivative of a pixel coordinate with respect to the scaled point d along one world axis, pixels.

    The derivative is `f / q_z (e - s e_z)` for the normalised coordinate s. Along the world axis, e is the component of
    the camera axis of the coordinate, and e_z is the component of the optical axis.
    """
    return focal_per_depth * (image_axis - coordinate * optical_axis)


@jit_fast_ir_inline
def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product `a x b`."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@jit_fast_ir_inline
def linearise_in_host(landmark: FloatArray, camera: Intrinsics, out: StereoProjection) -> None:
    """Project a landmark `(3,)` into its host pair; `by_target` is unchanged.

    The elements of the landmark are u and v, px, and inverse depth, 1/m.
    """
    uv = out.uv
    by_landmark = out.by_landmark
    disparity_per_inverse_depth = camera.focal[0] * camera.baseline_m
    for i in range(4):
        uv[i] = landmark[i % 2]
        for b in range(3):
            by_landmark[i, b] = 1.0 if b == i % 2 else 0.0
    uv[2] -= disparity_per_inverse_depth * landmark[2]
    by_landmark[2, 2] = -disparity_per_inverse_depth


@jit_fast_ir_inline
def linearise_landmark(
    target: Pose, hosts: Poses, k: int, ray: FloatArray, inverse_depth: float, camera: Intrinsics, out: StereoProjection
) -> float:
    """Project a landmark into both images and fill the projection with its Jacobians.

    The target is the left camera of the pair, `hosts[k]` the left camera of the landmark's host keyframe. The host ray
    `K^-1 (u, v, 1)` is `(3,)`, the inverse depth in 1/m.

    Returns:
        Depth in the target camera times the inverse depth. If the landmark is behind the camera, the result is 0 and
        `out` is unchanged.
    """
    r_wc = target.rotation
    r_wh = hosts.rotations[k]
    host_ray = rotated_ray(r_wh, ray[0], ray[1])
    host_offset = difference(hosts.positions[k], target.position)
    point = scaled_point(host_ray, host_offset, inverse_depth)
    depth = component(r_wc, 2, point)
    if depth < MIN_SCALED_DEPTH:
        return 0.0
    x = component(r_wc, 0, point) / depth
    y = component(r_wc, 1, point) / depth
    uv = out.uv
    by_target = out.by_target
    by_landmark = out.by_landmark
    focal = camera.focal
    centre = camera.centre
    baseline = camera.baseline_m
    for i in range(4):
        axis = i % 2
        focal_per_depth = focal[axis] / depth
        if axis == 1:
            s = y
        elif i == 0:
            s = x
        else:
            s = x - baseline * inverse_depth / depth
        uv[i] = focal[axis] * s + centre[axis]
        gx = gradient(focal_per_depth, s, r_wc[0, axis], r_wc[0, 2])
        gy = gradient(focal_per_depth, s, r_wc[1, axis], r_wc[1, 2])
        gz = gradient(focal_per_depth, s, r_wc[2, axis], r_wc[2, 2])
        # d changes by -rho times the motion of the camera; a rotation w changes the pixel by (g x d) . w.
        by_rotation = cross(Vector(gx, gy, gz), point)
        by_target[i, 0] = -inverse_depth * gx
        by_target[i, 1] = -inverse_depth * gy
        by_target[i, 2] = -inverse_depth * gz
        by_target[i, 3] = by_rotation.x
        by_target[i, 4] = by_rotation.y
        by_target[i, 5] = by_rotation.z
        by_landmark[i, 0] = (gx * r_wh[0, 0] + gy * r_wh[1, 0] + gz * r_wh[2, 0]) / focal[0]
        by_landmark[i, 1] = (gx * r_wh[0, 1] + gy * r_wh[1, 1] + gz * r_wh[2, 1]) / focal[1]
        by_landmark[i, 2] = gx * host_offset.x + gy * host_offset.y + gz * host_offset.z
        if i == 2:
            by_landmark[i, 2] -= focal_per_depth * baseline
    return depth

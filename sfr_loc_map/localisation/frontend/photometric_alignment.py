"""Coarse pose of a new pair: all patches aligned together with one level of the image pyramid.

The pose itself is estimated from the differences of the patches (Forster et al. 2014), so weak patches are carried by
the others and a prediction wrong by many pixels is corrected on the coarsest level. The patches keep the shape that the
start gives them; their positions follow the pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.small_linalg import retract, solve
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.patch import (
    MIN_POWER,
    ImageLevel,
    LocalPlanes,
    LocalWarp,
    PatchPixels,
    Templates,
    half_width,
    local_warp,
    patch_pixels,
    products_with_samples,
    warp_pixels,
    warped_normal,
)
from sfr_loc_map.localisation.frontend.patch_tracking import MIN_DETERMINANT

MAX_DETERMINANT = 20.0  #: Largest area to which a warp may stretch a pixel, pixels.
MIN_PATCHES = 8  #: Minimum number of patches in view.
RESIDUAL_FLOOR = 4.0  #: Variance of a grey level that is added to what the warp leaves unexplained.


class PoseAlignment(NamedTuple):
    """Best pose met, and the mean correlation of the patches there; -1 where too few are in view."""

    pose: Pose
    correlation: float


class _Patches(NamedTuple):
    """Templates of N patches with their warps at the centres, and pixels of one of them."""

    templates: Templates
    shapes: FloatArray  #: `(N, 4)` derivatives of the warps, xu, xv, yu, yv; 0 behind the camera.
    #: `(N, 4)` inverse transposes of these, which take derivatives of the grey level to the target.
    gradients: FloatArray
    normal: FloatArray  #: `(N, 3)` normal matrix xx, xy, yy in the target; 0 where a patch cannot be aligned.
    pixels: PatchPixels


class _Match(NamedTuple):
    """Right-hand side x, y, weight and correlation of a patch at its projected position; weight 0 if not seen."""

    x: float
    y: float
    weight: float
    correlation: float


class _Point(NamedTuple):
    """A landmark in the target: point in world axes and depth, both times the inverse depth; image coordinates."""

    wx: float
    wy: float
    wz: float
    z: float
    x: float
    y: float


@jit_fast_inline
def _warped(templates: Templates, homographies: FloatArray, uv: FloatArray) -> _Patches:
    """Return the patches with the warps that homographies `(N, 3, 3)` have at their centres `(N, 2)`."""
    moments, count = templates.moments, len(uv)
    shapes, gradients, normal = np.zeros((count, 4)), np.zeros((count, 4)), np.zeros((count, 3))
    for n in range(count):
        by = local_warp(homographies[n], uv[n, 0], uv[n, 1])
        shapes[n, 0], shapes[n, 1], shapes[n, 2], shapes[n, 3] = by.xu, by.xv, by.yu, by.yv
        det = by.xu * by.yv - by.xv * by.yu
        power, x, y = moments[n, 0], moments[n, 1], moments[n, 2]
        if power == 0.0 or abs(det) < MIN_DETERMINANT or abs(det) > MAX_DETERMINANT:
            continue
        # derivatives with what a change of contrast explains: the gain is not estimated with the pose
        xx, xy, yy = moments[n, 3] + x * x * power, moments[n, 4] + x * y * power, moments[n, 5] + y * y * power
        found = warped_normal(by, det, xx, xy, yy)
        gradients[n, 0], gradients[n, 1], gradients[n, 2], gradients[n, 3] = found.b00, found.b01, found.b10, found.b11
        normal[n, 0], normal[n, 1], normal[n, 2] = found.xx, found.xy, found.yy
    return _Patches(templates, shapes, gradients, normal, patch_pixels(templates.values.shape[2]))


@jit_fast_ir_inline
def _project(planes: LocalPlanes, n: int, pose: Pose, camera: StereoCamera) -> _Point:
    """Project the centre of a patch; the scaled depth is 0 behind the camera."""
    rotation, position, rho = pose.rotation, pose.position, planes.inverse_depth
    rx, ry = (planes.uv[n, 0] - camera.cx) / camera.fx, (planes.uv[n, 1] - camera.cy) / camera.fy
    r_wh, p_h = planes.hosts.rotations[n], planes.hosts.positions[n]
    wx = r_wh[0, 0] * rx + r_wh[0, 1] * ry + r_wh[0, 2] + rho[n] * (p_h[0] - position[0])
    wy = r_wh[1, 0] * rx + r_wh[1, 1] * ry + r_wh[1, 2] + rho[n] * (p_h[1] - position[1])
    wz = r_wh[2, 0] * rx + r_wh[2, 1] * ry + r_wh[2, 2] + rho[n] * (p_h[2] - position[2])
    z = rotation[0, 2] * wx + rotation[1, 2] * wy + rotation[2, 2] * wz
    if z < 1e-6:
        return _Point(wx, wy, wz, 0.0, 0.0, 0.0)
    x = (rotation[0, 0] * wx + rotation[1, 0] * wy + rotation[2, 0] * wz) / z
    y = (rotation[0, 1] * wx + rotation[1, 1] * wy + rotation[2, 1] * wz) / z
    return _Point(wx, wy, wz, z, x, y)


@jit_fast_ir_inline
def _compare(image: FloatImage, u: float, v: float, patches: _Patches, n: int) -> _Match:
    """Compare a patch with an image around a pixel."""
    templates, shape, b, at = patches.templates, patches.shapes[n], patches.gradients[n], patches.pixels
    height, width = image.shape
    nothing = _Match(0.0, 0.0, 0.0, 0.0)
    a00, a01, a10, a11 = shape[0], shape[1], shape[2], shape[3]
    half = half_width(at.x.size)
    reach_x, reach_y = half * (abs(a00) + abs(a01)), half * (abs(a10) + abs(a11))
    if u < reach_x or v < reach_y or u + reach_x >= width - 1.01 or v + reach_y >= height - 1.01:
        return nothing
    warp_pixels(at, LocalWarp(u, v, a00, a01, a10, a11, 0.0, 0.0))
    found = products_with_samples(image, at.x, at.y, np.float32(u), np.float32(v), templates.values[n])
    if found.power < MIN_POWER:
        return nothing
    power, along_x, along_y = templates.moments[n, 0], templates.moments[n, 1], templates.moments[n, 2]
    correlation = found.grey / np.sqrt(power * found.power)
    gain = np.sqrt(power / found.power)
    # products of the derivatives with the difference of both patches
    difference = gain * found.grey - power
    x, y = gain * found.x + along_x * difference, gain * found.y + along_y * difference
    # patches that differ much say little: the weight falls with what the warp leaves unexplained
    weight = 1.0 / (RESIDUAL_FLOOR + 2.0 * power * (1.0 - correlation) / at.x.size)
    return _Match(b[0] * x + b[1] * y, b[2] * x + b[3] * y, weight, correlation)


@jit_fast_ir_inline
def _fill_jacobian(
    point: _Point, inverse_depth: float, rotation: FloatArray, camera: StereoCamera, scale: float, d: FloatArray
) -> None:
    """Fill d `(2, 6)` with the derivatives of the pixel by position and rotation of the pose about the world's axes."""
    wx, wy, wz = point.wx, point.wy, point.wz
    for i in range(2):
        f = (camera.fx if i == 0 else camera.fy) / (point.z * scale)
        s = point.x if i == 0 else point.y
        a = f * (rotation[0, i] - s * rotation[0, 2])
        b = f * (rotation[1, i] - s * rotation[1, 2])
        c = f * (rotation[2, i] - s * rotation[2, 2])
        d[i, 0], d[i, 1], d[i, 2] = -inverse_depth * a, -inverse_depth * b, -inverse_depth * c
        d[i, 3], d[i, 4], d[i, 5] = b * wz - c * wy, c * wx - a * wz, a * wy - b * wx


@jit_fast_ir_inline
def _linearise(
    level: ImageLevel,
    patches: _Patches,
    planes: LocalPlanes,
    pose: Pose,
    camera: StereoCamera,
    h: FloatArray,
    g: FloatArray,
    d: FloatArray,
) -> tuple[int, float]:
    """Add to the normal equations `(6, 6)`, `(6,)` at a pose; `d` `(2, 6)` has room for a Jacobian.

    Returns the number of patches in view and their summed correlation.
    """
    fx, fy, cx, cy, scale = camera.fx, camera.fy, camera.cx, camera.cy, level.scale
    rho, normal = planes.inverse_depth, patches.normal
    seen, total = 0, 0.0
    for n in range(len(rho)):
        xx, xy, yy = normal[n, 0], normal[n, 1], normal[n, 2]
        if xx + yy <= 0.0:
            continue
        point = _project(planes, n, pose, camera)
        if point.z < 1e-6:
            continue
        u = (fx * point.x + cx + 0.5) / scale - 0.5
        v = (fy * point.y + cy + 0.5) / scale - 0.5
        match = _compare(level.image, u, v, patches, n)
        if match.weight == 0.0:
            continue
        seen += 1
        total += match.correlation
        _fill_jacobian(point, rho[n], pose.rotation, camera, scale, d)
        weight, bx, by = match.weight, match.x, match.y
        for i in range(6):
            p, q = weight * (xx * d[0, i] + xy * d[1, i]), weight * (xy * d[0, i] + yy * d[1, i])
            g[i] -= weight * (d[0, i] * bx + d[1, i] * by)
            for j in range(i, 6):
                h[i, j] += p * d[0, j] + q * d[1, j]
    return seen, total


@jit_fast
def align_patches(
    level: ImageLevel,
    templates: Templates,
    homographies: FloatArray,
    planes: LocalPlanes,
    start: Pose,
    camera: StereoCamera,
    iterations: int,
) -> PoseAlignment:
    """Align N patches of the hosts at one level of the left image, by at most so many Gauss-Newton iterations.

    The homographies `(N, 3, 3)` from host pixels to those that the start gives are the shapes of the patches. Their
    planes and the camera are in pixels of full size.
    """
    depth = 0.0  # 1/m; numba's mean() makes each start load its compiler's array functions, and scipy.linalg
    for i in range(len(planes.inverse_depth)):
        depth += planes.inverse_depth[i] / len(planes.inverse_depth)
    patches, jacobian = _warped(templates, homographies, planes.uv), np.empty((2, 6))
    rotation, position = start.rotation.copy(), start.position.copy()
    best = PoseAlignment(Pose(rotation, position), -1.0)
    for _ in range(iterations + 1):
        h, g = np.zeros((6, 6)), np.zeros(6)
        for i in range(6):
            h[i, i] = 1e-6
        pose = Pose(rotation, position)
        seen, total = _linearise(level, patches, planes, pose, camera, h, g, jacobian)
        if seen < MIN_PATCHES:
            break
        if total / seen > best.correlation:
            best = PoseAlignment(pose, total / seen)
        for i in range(6):
            for j in range(i):
                h[i, j] = h[j, i]
        update = solve(h, g)
        position = position.copy()
        largest = 0.0
        for i in range(3):
            position[i] += update[i]
            largest = max(largest, abs(update[i]) * depth, abs(update[3 + i]))
        rotation = retract(rotation, update[3], update[4], update[5])
        # a hundredth of a pixel of this level is enough
        if largest * camera.fx < 0.02 * level.scale:
            break
    return best

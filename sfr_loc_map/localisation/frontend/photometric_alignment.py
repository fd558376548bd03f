"""Coarse pose of a new pair: all patches aligned together with one level of the image pyramid.

The pose itself is estimated from the differences of the patches (Forster et al. 2014), so weak patches are carried by
the others and a prediction wrong by many pixels is corrected on the coarsest level. The patches keep the shape that the
start gives them; their positions follow the pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.small_linalg import retract, solve
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.homography import (
    LocalPlanes,
    plane_homographies,
    warp,
)
from sfr_loc_map.localisation.frontend.image_pyramid import ImageLevel
from sfr_loc_map.localisation.frontend.patch import Patch, half_width, normalise, sample
from sfr_loc_map.localisation.frontend.patch_tracking import MIN_DETERMINANT, MIN_POWER

MAX_DETERMINANT = 20.0
"""Largest area to which a warp may stretch a pixel, pixels."""
MIN_PATCHES = 8
"""Minimum number of patches in view."""
RESIDUAL_FLOOR = 4.0
"""Variance of a grey level that is added to what the warp leaves unexplained."""


class Alignment(NamedTuple):
    """Best pose met, and the mean correlation of the patches there; -1 where too few are in view."""

    pose: Pose
    correlation: float


class _Templates(NamedTuple):
    """N patches as templates.

    Attributes:
        values: `(N, S * S)` without mean.
        jacobians: `(N, 2, S * S)` derivatives by the position in the target.
        shapes: `(N, 4)` derivatives of the warps at the patch centres: xu, xv, yu, yv.
        normal: `(N, 4)` power and normal matrix xx, xy, yy; power 0 where a patch cannot be aligned.
    """

    values: Patch
    jacobians: NDArray[np.float32]
    shapes: FloatArray
    normal: FloatArray


class _Match(NamedTuple):
    """Right-hand side x, y, weight and correlation of a patch at its projected position."""

    x: np.float32
    y: np.float32
    weight: float
    correlation: float


class _System(NamedTuple):
    """Normal equations of the pose `(6, 6)`, `(6,)`, and workspaces: Jacobian `(2, 6)`, values of a patch."""

    information: FloatArray
    rhs: FloatArray
    jacobian: FloatArray
    values: Patch


class _Point(NamedTuple):
    """A landmark in the target: point in world axes and depth, both times the inverse depth; image coordinates."""

    wx: float
    wy: float
    wz: float
    z: float
    x: float
    y: float


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
def _prepare(patches: Patch, shapes: FloatArray) -> _Templates:
    """Return the templates of patches whose warps have some shapes."""
    count, size = patches.shape[0], patches.shape[2]
    templates = patches[:, 0].copy()
    jacobians = np.zeros((count, 2, size), np.float32)
    normal = np.zeros((count, 4))
    for n in range(count):
        a00, a01, a10, a11 = shapes[n, 0], shapes[n, 1], shapes[n, 2], shapes[n, 3]
        det = a00 * a11 - a01 * a10
        power = normalise(templates[n])
        if power < MIN_POWER or abs(det) < MIN_DETERMINANT or abs(det) > MAX_DETERMINANT:
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
    return _Templates(templates, jacobians, shapes, normal)


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
def _cut(image: FloatImage, u: float, v: float, half: int, shape: FloatArray, values: Patch) -> bool:
    """Fill the values of a patch of a shape `(4,)` around a pixel; return whether it lies inside the image."""
    height, width = image.shape
    a00, a01, a10, a11 = shape[0], shape[1], shape[2], shape[3]
    reach_x, reach_y = half * (abs(a00) + abs(a01)), half * (abs(a10) + abs(a11))
    if u < reach_x or v < reach_y or u + reach_x >= width - 1.01 or v + reach_y >= height - 1.01:
        return False
    k = 0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            values[k] = sample(image, np.float32(u + a00 * i + a01 * j), np.float32(v + a10 * i + a11 * j))
            k += 1
    return True


@jit_fast_ir_inline
def _compare(templates: _Templates, n: int, power: float, target: np.float32, values: Patch) -> _Match:
    """Compare a patch with the values at its position, which are without mean and of power `target`."""
    template, jacobians = templates.values, templates.jacobians
    dot = np.float32(0.0)
    for k in range(values.size):
        dot += values[k] * template[n, k]
    correlation = dot / np.sqrt(power * target)
    gain = np.float32(np.sqrt(power / target))
    bx, by = np.float32(0.0), np.float32(0.0)
    for k in range(values.size):
        difference = gain * values[k] - template[n, k]
        bx += jacobians[n, 0, k] * difference
        by += jacobians[n, 1, k] * difference
    # patches that differ much say little: the weight falls with what the warp leaves unexplained
    weight = 1.0 / (RESIDUAL_FLOOR + 2.0 * power * (1.0 - correlation) / values.size)
    return _Match(bx, by, weight, correlation)


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
    level: ImageLevel, templates: _Templates, planes: LocalPlanes, pose: Pose, camera: StereoCamera, system: _System
) -> tuple[int, float]:
    """Add to the normal equations at a pose; return the number of patches in view and their summed correlation."""
    fx, fy, cx, cy, scale = camera.fx, camera.fy, camera.cx, camera.cy, level.scale
    half, rho, normal = half_width(system.values.size), planes.inverse_depth, templates.normal
    h, g, d = system.information, system.rhs, system.jacobian
    seen, total = 0, 0.0
    for n in range(len(rho)):
        power, xx, xy, yy = normal[n, 0], normal[n, 1], normal[n, 2], normal[n, 3]
        if power <= 0.0:
            continue
        point = _project(planes, n, pose, camera)
        if point.z < 1e-6:
            continue
        u = (fx * point.x + cx + 0.5) / scale - 0.5
        v = (fy * point.y + cy + 0.5) / scale - 0.5
        if not _cut(level.image, u, v, half, templates.shapes[n], system.values):
            continue
        target = normalise(system.values)
        if target < MIN_POWER:
            continue
        match = _compare(templates, n, power, target, system.values)
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
def _align(
    level: ImageLevel,
    patches: Patch,
    homographies: FloatArray,
    planes: LocalPlanes,
    start: Pose,
    camera: StereoCamera,
    iterations: int,
) -> Alignment:
    """Align patches whose shapes are those of homographies `(N, 3, 3)`; arguments as `align_pose`."""
    rho = planes.inverse_depth
    depth = 0.0
    for n in range(len(rho)):
        depth += rho[n]
    depth /= len(rho)
    templates = _prepare(patches, _shapes(homographies, planes.uv))
    values, jacobian = np.empty(patches.shape[2], np.float32), np.empty((2, 6))
    best_rotation, best_position, best = start.rotation.copy(), start.position.copy(), -1.0
    rotation, position = start.rotation.copy(), start.position.copy()
    for _ in range(iterations + 1):
        system = _System(np.zeros((6, 6)), np.zeros(6), jacobian, values)
        h = system.information
        for i in range(6):
            h[i, i] = 1e-6
        seen, total = _linearise(level, templates, planes, Pose(rotation, position), camera, system)
        if seen < MIN_PATCHES:
            break
        if total / seen > best:
            best_rotation, best_position, best = rotation, position, total / seen
        for i in range(6):
            for j in range(i):
                h[i, j] = h[j, i]
        update = solve(h, system.rhs)
        position = position.copy()
        largest = 0.0
        for i in range(3):
            position[i] += update[i]
            largest = max(largest, abs(update[i]) * depth, abs(update[3 + i]))
        rotation = retract(rotation, update[3], update[4], update[5])
        # a hundredth of a pixel of this level is enough
        if largest * camera.fx < 0.02 * level.scale:
            break
    return Alignment(Pose(best_rotation, best_position), best)


def align_pose(
    level: ImageLevel, patches: Patch, planes: LocalPlanes, start: Pose, camera: StereoCamera, iterations: int
) -> Alignment:
    """Align all patches with one level of the left image.

    Args:
        level: Level of the pyramid.
        patches: `(N, 3, S * S)` of the hosts at this level.
        planes: Their planes, in pixels of full size.
        start: Left camera.
        camera: Camera at full size.
        iterations: Most Gauss-Newton iterations.
    """
    homographies = plane_homographies(start, planes, camera, 0.0)
    return _align(level, patches, homographies, planes, start, camera, iterations)

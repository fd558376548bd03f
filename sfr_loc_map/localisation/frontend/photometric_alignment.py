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
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.homography import (
    LocalPlanes,
    WarpDerivative,
    plane_homographies,
    warp_derivative,
)
from sfr_loc_map.localisation.frontend.image_pyramid import ImageLevel
from sfr_loc_map.localisation.frontend.patch import Patch, half_width, normalise, sample
from sfr_loc_map.localisation.frontend.patch_tracking import MIN_DETERMINANT, MIN_POWER, target_gradients

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
    """N patches without mean, their derivatives in the target `(N, S * S)`, shapes, powers and normal matrices."""

    values: Patch
    dx: Patch
    dy: Patch
    shapes: FloatArray
    power: FloatArray
    xx: FloatArray
    xy: FloatArray
    yy: FloatArray


class _Point(NamedTuple):
    """A landmark in the target: direction in world axes, scaled depth, normalised image coordinates."""

    wx: float
    wy: float
    wz: float
    z: float
    x: float
    y: float


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


@jit_fast_inline
def _shape(shapes: FloatArray, n: int) -> WarpDerivative:
    return WarpDerivative(shapes[n, 0, 0], shapes[n, 0, 1], shapes[n, 1, 0], shapes[n, 1, 1])


@jit_fast_inline
def _shapes(homographies: FloatArray, uv: FloatArray) -> FloatArray:
    """Return the derivatives `(N, 2, 2)` of the warps at the patch centres; zero behind the camera."""
    out = np.zeros((len(uv), 2, 2))
    for n in range(len(uv)):
        warped = warp_derivative(homographies[n], uv[n, 0], uv[n, 1])
        out[n, 0, 0], out[n, 0, 1], out[n, 1, 0], out[n, 1, 1] = warped.xu, warped.xv, warped.yu, warped.yv
    return out


@jit_fast_inline
def _prepare(patches: Patch, shapes: FloatArray) -> _Templates:
    """Return the templates; the power is 0 where a patch cannot be aligned."""
    count, size = patches.shape[0], patches.shape[2]
    templates = _Templates(
        patches[:, 0].copy(),
        np.zeros((count, size), np.float32),
        np.zeros((count, size), np.float32),
        shapes,
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
    )
    for n in range(count):
        shape = _shape(shapes, n)
        det = shape.xu * shape.yv - shape.xv * shape.yu
        power = normalise(templates.values[n])
        if power < MIN_POWER or abs(det) < MIN_DETERMINANT or abs(det) > MAX_DETERMINANT:
            continue
        dx, dy = templates.dx[n], templates.dy[n]
        target_gradients(patches[n], shape, dx, dy)
        xx, xy, yy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(size):
            xx += dx[k] * dx[k]
            xy += dx[k] * dy[k]
            yy += dy[k] * dy[k]
        templates.power[n], templates.xx[n], templates.xy[n], templates.yy[n] = power, xx, xy, yy
    return templates


@jit_fast_inline
def _project(planes: LocalPlanes, n: int, pose: Pose, camera: StereoCamera) -> _Point:
    """Project the centre of a patch; the scaled depth is 0 behind the camera."""
    rotation, position, rho = pose.rotation, pose.position, planes.inverse_depth[n]
    rx, ry = (planes.uv[n, 0] - camera.cx) / camera.fx, (planes.uv[n, 1] - camera.cy) / camera.fy
    r_wh, p_h = planes.hosts.rotations[n], planes.hosts.positions[n]
    wx = r_wh[0, 0] * rx + r_wh[0, 1] * ry + r_wh[0, 2] + rho * (p_h[0] - position[0])
    wy = r_wh[1, 0] * rx + r_wh[1, 1] * ry + r_wh[1, 2] + rho * (p_h[1] - position[1])
    wz = r_wh[2, 0] * rx + r_wh[2, 1] * ry + r_wh[2, 2] + rho * (p_h[2] - position[2])
    z = rotation[0, 2] * wx + rotation[1, 2] * wy + rotation[2, 2] * wz
    if z < 1e-6:
        return _Point(wx, wy, wz, 0.0, 0.0, 0.0)
    x = (rotation[0, 0] * wx + rotation[1, 0] * wy + rotation[2, 0] * wz) / z
    y = (rotation[0, 1] * wx + rotation[1, 1] * wy + rotation[2, 1] * wz) / z
    return _Point(wx, wy, wz, z, x, y)


@jit_fast_inline
def _cut(image: FloatImage, u: float, v: float, shape: WarpDerivative, values: Patch) -> bool:
    """Fill the values of a patch of some shape around a pixel; return whether it lies inside the image."""
    height, width = image.shape
    half = half_width(values.size)
    reach_x, reach_y = half * (abs(shape.xu) + abs(shape.xv)), half * (abs(shape.yu) + abs(shape.yv))
    if u < reach_x or v < reach_y or u + reach_x >= width - 1.01 or v + reach_y >= height - 1.01:
        return False
    k = 0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            x, y = np.float32(u + shape.xu * i + shape.xv * j), np.float32(v + shape.yu * i + shape.yv * j)
            values[k] = sample(image, x, y)
            k += 1
    return True


@jit_fast_inline
def _compare(templates: _Templates, n: int, target: np.float32, values: Patch) -> _Match:
    """Compare a patch with the values at its position, which are without mean and of power `target`."""
    power = templates.power[n]
    dot = np.float32(0.0)
    for k in range(values.size):
        dot += values[k] * templates.values[n, k]
    correlation = dot / np.sqrt(power * target)
    gain = np.float32(np.sqrt(power / target))
    bx, by = np.float32(0.0), np.float32(0.0)
    for k in range(values.size):
        difference = gain * values[k] - templates.values[n, k]
        bx += templates.dx[n, k] * difference
        by += templates.dy[n, k] * difference
    # patches that differ much say little: the weight falls with what the warp leaves unexplained
    weight = 1.0 / (RESIDUAL_FLOOR + 2.0 * power * (1.0 - correlation) / values.size)
    return _Match(bx, by, weight, correlation)


@jit_fast_inline
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


@jit_fast_inline
def _accumulate(system: _System, templates: _Templates, n: int, match: _Match) -> None:
    """Add a patch to the upper half of the normal equations."""
    h, g, d, weight = system.information, system.rhs, system.jacobian, match.weight
    xx, xy, yy = templates.xx[n], templates.xy[n], templates.yy[n]
    for i in range(6):
        p, q = weight * (xx * d[0, i] + xy * d[1, i]), weight * (xy * d[0, i] + yy * d[1, i])
        g[i] -= weight * (d[0, i] * match.x + d[1, i] * match.y)
        for j in range(i, 6):
            h[i, j] += p * d[0, j] + q * d[1, j]


@jit_fast_inline
def _linearise(
    level: ImageLevel, templates: _Templates, planes: LocalPlanes, pose: Pose, camera: StereoCamera, system: _System
) -> tuple[int, float]:
    """Fill the normal equations at a pose; return the number of patches in view and their mean correlation."""
    h, g, scale = system.information, system.rhs, level.scale
    h[:], g[:] = 0.0, 0.0
    for i in range(6):
        h[i, i] = 1e-6
    count, total = 0, 0.0
    for n in range(len(planes.uv)):
        if templates.power[n] <= 0.0:
            continue
        point = _project(planes, n, pose, camera)
        if point.z < 1e-6:
            continue
        u = (camera.fx * point.x + camera.cx + 0.5) / scale - 0.5
        v = (camera.fy * point.y + camera.cy + 0.5) / scale - 0.5
        if not _cut(level.image, u, v, _shape(templates.shapes, n), system.values):
            continue
        target = normalise(system.values)
        if target < MIN_POWER:
            continue
        match = _compare(templates, n, target, system.values)
        count += 1
        total += match.correlation
        _fill_jacobian(point, planes.inverse_depth[n], pose.rotation, camera, scale, system.jacobian)
        _accumulate(system, templates, n, match)
    for i in range(6):
        for j in range(i):
            h[i, j] = h[j, i]
    return count, total


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
    count = len(planes.uv)
    depth = 0.0
    for n in range(count):
        depth += planes.inverse_depth[n]
    depth /= count
    templates = _prepare(patches, _shapes(homographies, planes.uv))
    system = _System(np.zeros((6, 6)), np.zeros(6), np.empty((2, 6)), np.empty(patches.shape[2], np.float32))
    rotation, position = start.rotation.copy(), start.position.copy()
    best_rotation, best_position, best = rotation, position, -1.0
    for _ in range(iterations + 1):
        in_view, total = _linearise(level, templates, planes, Pose(rotation, position), camera, system)
        if in_view < MIN_PATCHES:
            break
        if total / in_view > best:
            best_rotation, best_position, best = rotation, position, total / in_view
        update = solve(system.information, system.rhs)
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

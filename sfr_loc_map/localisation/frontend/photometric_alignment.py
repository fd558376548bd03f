"""Coarse pose of a new pair: all patches are aligned together with one level of the image pyramid.

The pose is estimated directly from the grey levels (sparse image alignment: Forster et al. 2014, section IV-A). Patches
with little texture are supported by the others, and prediction errors of many pixels are corrected on the coarsest
level.

Warp: the pixel at the offset (i, j) from the centre of a host patch is compared with the pixel

    (x, y) = centre(pose) + S (i, j)

of the level. The centre is the projection of the patch centre at the estimated pose (`projection`). The shape S is the
Jacobian `(2, 2)` of the plane's homography at the centre (`plane_warp.LocalWarp`). It is computed once, at the initial
pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.patch import (
    COARSE_SAMPLED_PX,
    CONTRAST_X,
    CONTRAST_Y,
    MIN_POWER,
    POWER,
    XX,
    XY,
    YY,
    PatchPixels,
    Templates,
    half_width,
    patch_pixels,
    products_with_samples,
    warp_pixels,
    warped_normal,
)
from sfr_loc_map.localisation.frontend.patch_tracking import MIN_DETERMINANT
from sfr_loc_map.localisation.frontend.plane_warp import LocalPlanes, LocalWarp, local_warp
from sfr_loc_map.localisation.frontend.projection import (
    MIN_SCALED_DEPTH,
    Vector,
    component,
    cross,
    gradient,
    point_from,
)
from sfr_loc_map.localisation.frontend.pyramid import ImageLevel
from sfr_loc_map.localisation.small_linalg import retract, solve

MAX_DETERMINANT = 20.0
"""Maximum determinant of a warp, which is the area, px^2, that a pixel of the host covers in the target. At 20, a patch
of 7 x 7 px covers 31 x 31 px, and its samples skip most of the texture there."""
MIN_PATCHES = 8
"""Minimum number of patches in view. Each patch gives two equations, so 8 patches give more than twice the six
equations that are required."""
RESIDUAL_FLOOR = 4.0
"""Variance added to the residual variance of a patch, grey levels squared: a noise of two grey levels. It prevents a
patch that fits by chance from dominating."""
PRIOR_INFORMATION = 1e-6
"""Value added to the diagonal of the normal matrix to make it positive definite. It is far below the information of one
patch."""
ALIGNED_PX = 0.02
"""Image motion of a step, px of the level, below which the iterations end. A change of the initial pose by 0.02 px
changed the scores by at most 2 % (measurements/localiser_trials.md)."""


class PoseAlignment(NamedTuple):
    """Result of an alignment."""

    pose: Pose  #: Pose with the highest correlation of all iterations.
    correlation: float  #: Mean correlation of the patches at that pose; -1 if too few patches are in view.


class _Patches(NamedTuple):
    """Templates of N patches with their warps at the centres, and a workspace for the pixels of one patch."""

    templates: Templates
    shapes: FloatArray  #: `(N, 4)` derivatives of the warps, xu, xv, yu, yv; 0 behind the camera.
    #: `(N, 4)` inverse transposes of the shapes. They transform derivatives of the grey level to the target.
    gradients: FloatArray
    normal: FloatArray  #: `(N, 3)` normal matrix xx, xy, yy in the target; 0 if a patch cannot be aligned.
    pixels: PatchPixels


class _Match(NamedTuple):
    """Comparison of a patch with the image at its projected position."""

    x: float  #: Right-hand side of the normal equations of a shift along x and y, grey levels squared per pixel.
    y: float
    weight: float  #: Inverse variance of a grey level; 0 if the patch is not in view.
    correlation: float  #: Normalised cross-correlation.


class _Point(NamedTuple):
    """Projection of a patch centre. Lengths are multiplied by the inverse depth of the centre."""

    world: Vector  #: Vector from the camera, along the axes of the world.
    depth: float  #: Depth in the camera; 0 behind the camera.
    x: float  #: Normalised image coordinates X / Z and Y / Z; 0 behind the camera.
    y: float


@jit_fast_inline
def _warped(templates: Templates, homographies: FloatArray, uv: FloatArray) -> _Patches:
    """Return the patches with the warps of homographies `(N, 3, 3)`, linearised at the patch centres `(N, 2)`."""
    moments = templates.moments
    count = len(uv)
    shapes = np.zeros((count, 4))
    gradients = np.zeros((count, 4))
    normal = np.zeros((count, 3))
    for n in range(count):
        by = local_warp(homographies[n], uv[n, 0], uv[n, 1])
        shapes[n, 0] = by.xu
        shapes[n, 1] = by.xv
        shapes[n, 2] = by.yu
        shapes[n, 3] = by.yv
        determinant = by.xu * by.yv - by.xv * by.yu
        power = moments[n, POWER]
        contrast_x = moments[n, CONTRAST_X]
        contrast_y = moments[n, CONTRAST_Y]
        if power == 0.0 or abs(determinant) < MIN_DETERMINANT or abs(determinant) > MAX_DETERMINANT:
            continue
        # The gain is not estimated with the pose, so derivatives keep the part that a change of contrast explains.
        xx = moments[n, XX] + contrast_x * contrast_x * power
        xy = moments[n, XY] + contrast_x * contrast_y * power
        yy = moments[n, YY] + contrast_y * contrast_y * power
        in_target = warped_normal(by, determinant, xx, xy, yy)
        gradients[n, 0] = in_target.b00
        gradients[n, 1] = in_target.b01
        gradients[n, 2] = in_target.b10
        gradients[n, 3] = in_target.b11
        normal[n, 0] = in_target.xx
        normal[n, 1] = in_target.xy
        normal[n, 2] = in_target.yy
    return _Patches(templates, shapes, gradients, normal, patch_pixels(templates.values.shape[2]))


@jit_fast_ir_inline
def _project(planes: LocalPlanes, n: int, pose: Pose, camera: StereoCamera) -> _Point:
    """Project the centre of a patch into the left image."""
    ray_x = (planes.uv[n, 0] - camera.cx) / camera.fx
    ray_y = (planes.uv[n, 1] - camera.cy) / camera.fy
    world = point_from(pose, planes.hosts, n, ray_x, ray_y, planes.inverse_depth[n])
    depth = component(pose.rotation, 2, world)
    if depth < MIN_SCALED_DEPTH:
        return _Point(world, 0.0, 0.0, 0.0)
    x = component(pose.rotation, 0, world) / depth
    y = component(pose.rotation, 1, world) / depth
    return _Point(world, depth, x, y)


@jit_fast_ir_inline
def _compare(image: FloatImage, u: float, v: float, patches: _Patches, n: int) -> _Match:
    """Compare a patch with an image around a pixel."""
    templates = patches.templates
    shape = patches.shapes[n]
    b = patches.gradients[n]
    pixels = patches.pixels
    height, width = image.shape
    not_in_view = _Match(0.0, 0.0, 0.0, 0.0)
    xu, xv, yu, yv = shape[0], shape[1], shape[2], shape[3]
    half = half_width(pixels.x.size)
    reach_x = half * (abs(xu) + abs(xv))
    reach_y = half * (abs(yu) + abs(yv))
    if (
        u < reach_x
        or v < reach_y
        or u + reach_x >= width - COARSE_SAMPLED_PX
        or v + reach_y >= height - COARSE_SAMPLED_PX
    ):
        return not_in_view
    warp_pixels(pixels, LocalWarp(u, v, xu, xv, yu, yv, 0.0, 0.0))
    products = products_with_samples(image, pixels.x, pixels.y, np.float32(u), np.float32(v), templates.values[n])
    if products.power < MIN_POWER:
        return not_in_view
    power = templates.moments[n, POWER]
    contrast_x = templates.moments[n, CONTRAST_X]
    contrast_y = templates.moments[n, CONTRAST_Y]
    correlation = products.grey / np.sqrt(power * products.power)
    gain = np.sqrt(power / products.power)
    # products of the host's derivatives with the difference of both patches
    difference_grey = gain * products.grey - power
    along_x = gain * products.x + contrast_x * difference_grey
    along_y = gain * products.y + contrast_y * difference_grey
    # The weight of a patch decreases with its residual variance.
    weight = 1.0 / (RESIDUAL_FLOOR + 2.0 * power * (1.0 - correlation) / pixels.x.size)
    return _Match(b[0] * along_x + b[1] * along_y, b[2] * along_x + b[3] * along_y, weight, correlation)


@jit_fast_ir_inline
def _fill_jacobian(
    point: _Point, inverse_depth: float, rotation: FloatArray, camera: StereoCamera, scale: float, jacobian: FloatArray
) -> None:
    """Fill the Jacobian `(2, 6)` of a pixel of the level with respect to the camera pose (`projection.py`)."""
    for i in range(2):
        focal_per_depth = (camera.fx if i == 0 else camera.fy) / (point.depth * scale)
        s = point.x if i == 0 else point.y
        gx = gradient(focal_per_depth, s, rotation[0, i], rotation[0, 2])
        gy = gradient(focal_per_depth, s, rotation[1, i], rotation[1, 2])
        gz = gradient(focal_per_depth, s, rotation[2, i], rotation[2, 2])
        by_rotation = cross(Vector(gx, gy, gz), point.world)
        jacobian[i, 0] = -inverse_depth * gx
        jacobian[i, 1] = -inverse_depth * gy
        jacobian[i, 2] = -inverse_depth * gz
        jacobian[i, 3] = by_rotation.x
        jacobian[i, 4] = by_rotation.y
        jacobian[i, 5] = by_rotation.z


@jit_fast_ir_inline
def _add_patches(
    level: ImageLevel,
    patches: _Patches,
    planes: LocalPlanes,
    pose: Pose,
    camera: StereoCamera,
    information: FloatArray,
    rhs: FloatArray,
    jacobian: FloatArray,
) -> tuple[int, float]:
    """Add all patches to the normal equations `(6, 6)`, `(6,)` at a pose; `jacobian` `(2, 6)` is a workspace.

    Returns the number of patches in view and the sum of their correlations.
    """
    scale = level.scale
    inverse_depth = planes.inverse_depth
    normal = patches.normal
    in_view = 0
    total_correlation = 0.0
    for n in range(len(inverse_depth)):
        xx, xy, yy = normal[n, 0], normal[n, 1], normal[n, 2]
        if xx + yy <= 0.0:
            continue
        point = _project(planes, n, pose, camera)
        if point.depth < MIN_SCALED_DEPTH:
            continue
        u = (camera.fx * point.x + camera.cx + 0.5) / scale - 0.5
        v = (camera.fy * point.y + camera.cy + 0.5) / scale - 0.5
        match = _compare(level.image, u, v, patches, n)
        weight = match.weight
        if weight == 0.0:
            continue
        in_view += 1
        total_correlation += match.correlation
        _fill_jacobian(point, inverse_depth[n], pose.rotation, camera, scale, jacobian)
        for i in range(6):
            weighted_u = weight * (xx * jacobian[0, i] + xy * jacobian[1, i])
            weighted_v = weight * (xy * jacobian[0, i] + yy * jacobian[1, i])
            rhs[i] -= weight * (jacobian[0, i] * match.x + jacobian[1, i] * match.y)
            for j in range(i, 6):
                information[i, j] += weighted_u * jacobian[0, j] + weighted_v * jacobian[1, j]
    return in_view, total_correlation


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
    """Align N patches with one level of the left image by Gauss-Newton.

    Args:
        level: Level of the left image.
        templates: Templates of the patches, from the same level of their host images.
        homographies: `(N, 3, 3)` from host pixels to pixels at the initial pose, for the shapes of the patches.
        planes: Planes around the host pixels, pixels of full size.
        start: Initial pose of the left camera.
        camera: Camera, pixels of full size.
        iterations: Maximum number of iterations.
    """
    mean_inverse_depth = 0.0  # numba's mean() would load its compiler's array functions and scipy.linalg
    for i in range(len(planes.inverse_depth)):
        mean_inverse_depth += planes.inverse_depth[i] / len(planes.inverse_depth)
    patches = _warped(templates, homographies, planes.uv)
    jacobian = np.empty((2, 6))
    rotation = start.rotation.copy()
    position = start.position.copy()
    best = PoseAlignment(Pose(rotation, position), -1.0)
    for _ in range(iterations + 1):
        information = np.zeros((6, 6))
        rhs = np.zeros(6)
        for i in range(6):
            information[i, i] = PRIOR_INFORMATION
        pose = Pose(rotation, position)
        in_view, total_correlation = _add_patches(level, patches, planes, pose, camera, information, rhs, jacobian)
        if in_view < MIN_PATCHES:
            break
        correlation = total_correlation / in_view
        if correlation > best.correlation:
            best = PoseAlignment(pose, correlation)
        for i in range(6):
            for j in range(i):
                information[i, j] = information[j, i]
        update = solve(information, rhs)
        position = position.copy()
        largest_angle = 0.0  # rad, motion in the image of a landmark at the mean inverse depth
        for i in range(3):
            position[i] += update[i]
            largest_angle = max(largest_angle, abs(update[i]) * mean_inverse_depth, abs(update[3 + i]))
        rotation = retract(rotation, update[3], update[4], update[5])
        if largest_angle * camera.fx < ALIGNED_PX * level.scale:
            break
    return best

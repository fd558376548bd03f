"""Homographies of local planes.

A plane in disparity, hence in inverse depth, is one in space, so a patch around a host pixel moves into another image
by a homography (Hartley and Zisserman 2004, section 13.1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline

BEHIND = -1e9
"""Pixel coordinates of what lies behind the camera."""


class LocalPlanes(NamedTuple):
    """The planes around N host pixels; inverse depth is linear in the host pixel.

    Attributes:
        hosts: `(N,)` host cameras.
        uv: `(N, 2)` host pixels.
        inverse_depth: `(N,)` at the host pixels, 1/m.
        slopes: `(N, 2)` its change per pixel along u and v, 1/m.
    """

    hosts: Poses
    uv: FloatArray
    inverse_depth: FloatArray
    slopes: FloatArray


class LocalWarp(NamedTuple):
    """A homography around a pixel: `x + (xu i + xv j) / (1 + wu i + wv j)` for a pixel (i, j) beside, y likewise.

    Attributes:
        x, y: Where the pixel itself is; `BEHIND` behind the camera.
        xu, xv, yu, yv: Derivatives there; 0 behind the camera.
        wu, wv: Change of the depth per pixel over the depth.
    """

    x: float
    y: float
    xu: float
    xv: float
    yu: float
    yv: float
    wu: float
    wv: float


@jit_fast
def plane_homographies(target: Pose, planes: LocalPlanes, camera: StereoCamera, offset_x: float) -> FloatArray:
    """Return the homographies `(N, 3, 3)` of local planes, from host pixels to pixels of one image.

    `x' ~ K (R K^-1 (u, v, 1) + t rho(u, v))` with the inverse depth `rho` linear in the host pixel.

    Args:
        target: Left camera of the target pair.
        planes: N planes.
        camera: Camera of all pairs.
        offset_x: Position of the target camera along x of the left one: 0 or the baseline, metres.
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    rotation, position, uv, slopes = target.rotation, target.position, planes.uv, planes.slopes
    out = np.empty((len(uv), 3, 3))
    for n in range(len(uv)):
        h, r_wh, p_h = out[n], planes.hosts.rotations[n], planes.hosts.positions[n]
        offset = planes.inverse_depth[n] - slopes[n, 0] * uv[n, 0] - slopes[n, 1] * uv[n, 1]
        d0, d1, d2 = p_h[0] - position[0], p_h[1] - position[1], p_h[2] - position[2]
        for r in range(3):
            r0 = rotation[0, r] * r_wh[0, 0] + rotation[1, r] * r_wh[1, 0] + rotation[2, r] * r_wh[2, 0]
            r1 = rotation[0, r] * r_wh[0, 1] + rotation[1, r] * r_wh[1, 1] + rotation[2, r] * r_wh[2, 1]
            r2 = rotation[0, r] * r_wh[0, 2] + rotation[1, r] * r_wh[1, 2] + rotation[2, r] * r_wh[2, 2]
            t = rotation[0, r] * d0 + rotation[1, r] * d1 + rotation[2, r] * d2
            if r == 0:
                t -= offset_x
            h[r, 0] = r0 / fx + t * slopes[n, 0]
            h[r, 1] = r1 / fy + t * slopes[n, 1]
            h[r, 2] = r2 - r0 * cx / fx - r1 * cy / fy + t * offset
        for c in range(3):
            h[0, c] = fx * h[0, c] + cx * h[2, c]
            h[1, c] = fy * h[1, c] + cy * h[2, c]
    return out


@jit_fast_inline
def local_warp(h: FloatArray, u: float, v: float) -> LocalWarp:
    """Return a homography around a pixel."""
    w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
    if w <= 1e-9:
        return LocalWarp(BEHIND, BEHIND, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    x, y = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w, (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w
    return LocalWarp(
        x,
        y,
        (h[0, 0] - x * h[2, 0]) / w,
        (h[0, 1] - x * h[2, 1]) / w,
        (h[1, 0] - y * h[2, 0]) / w,
        (h[1, 1] - y * h[2, 1]) / w,
        h[2, 0] / w,
        h[2, 1] / w,
    )

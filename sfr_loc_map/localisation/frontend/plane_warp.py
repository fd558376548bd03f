"""Warp of a local plane from its host image to another image.

Around a host pixel, inverse depth is approximated as a linear function of the pixel, which corresponds to a plane in
space. A plane maps pixels of the host image to pixels of another image by a homography (Hartley and Zisserman 2004,
section 13.1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline

BEHIND = -1e9  #: Pixel coordinate assigned to points behind the camera.
MIN_WARP_DEPTH = 1e-9  #: Depth times inverse depth, no unit, below which a pixel counts as behind the camera.


class LocalPlanes(NamedTuple):
    """Planes around N host pixels. Inverse depth is a linear function of the host pixel."""

    hosts: Poses  #: `(N,)` host cameras.
    uv: FloatArray  #: `(N, 2)` host pixels.
    inverse_depth: FloatArray  #: `(N,)` at the host pixels, 1/m.
    slopes: FloatArray  #: `(N, 2)` derivatives of the inverse depth along u and v, 1/m per pixel.

    def take(self, rows: NDArray[np.intp]) -> LocalPlanes:
        """Return the planes of some rows."""
        uv = self.uv.take(rows, axis=0)
        return LocalPlanes(self.hosts.take(rows), uv, self.inverse_depth[rows], self.slopes.take(rows, axis=0))


class LocalWarp(NamedTuple):
    """A homography around a host pixel (u, v).

    The pixel (u + i, v + j) is mapped to `x + (xu i + xv j) / (1 + wu i + wv j)`, and likewise for y.
    """

    x: float  #: Position to which the host pixel is mapped; `BEHIND` behind the camera.
    y: float
    xu: float  #: Derivatives of x and y with respect to u and v at the host pixel; 0 behind the camera.
    xv: float
    yu: float
    yv: float
    wu: float  #: Relative change of the depth per host pixel along u and v.
    wv: float


@jit_fast
def plane_homographies(target: Pose, planes: LocalPlanes, camera: StereoCamera, offset_x: float) -> FloatArray:
    """Return the homographies `(N, 3, 3)` of local planes, from host pixels to pixels of one image.

    A host pixel of inverse depth `rho(u, v) = offset + slope_u u + slope_v v` is mapped to
    `K (R K^-1 (u, v, 1) + t rho(u, v))`, with the rotation R and the translation t from the host to the target.
    `target` is the pose of the left camera. `offset_x`, metres, is the position of the image's camera along the x axis
    of the left camera: 0 for the left image, the baseline for the right image.
    """
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    rotation = target.rotation
    position = target.position
    uv = planes.uv
    slopes = planes.slopes
    homographies = np.empty((len(uv), 3, 3))
    for n in range(len(uv)):
        h = homographies[n]
        r_wh = planes.hosts.rotations[n]
        p_h = planes.hosts.positions[n]
        offset = planes.inverse_depth[n] - slopes[n, 0] * uv[n, 0] - slopes[n, 1] * uv[n, 1]
        dx = p_h[0] - position[0]
        dy = p_h[1] - position[1]
        dz = p_h[2] - position[2]
        for r in range(3):
            r0 = rotation[0, r] * r_wh[0, 0] + rotation[1, r] * r_wh[1, 0] + rotation[2, r] * r_wh[2, 0]
            r1 = rotation[0, r] * r_wh[0, 1] + rotation[1, r] * r_wh[1, 1] + rotation[2, r] * r_wh[2, 1]
            r2 = rotation[0, r] * r_wh[0, 2] + rotation[1, r] * r_wh[1, 2] + rotation[2, r] * r_wh[2, 2]
            t = rotation[0, r] * dx + rotation[1, r] * dy + rotation[2, r] * dz
            if r == 0:
                t -= offset_x
            h[r, 0] = r0 / fx + t * slopes[n, 0]
            h[r, 1] = r1 / fy + t * slopes[n, 1]
            h[r, 2] = r2 - r0 * cx / fx - r1 * cy / fy + t * offset
        for c in range(3):
            h[0, c] = fx * h[0, c] + cx * h[2, c]
            h[1, c] = fy * h[1, c] + cy * h[2, c]
    return homographies


@jit_fast_inline
def local_warp(h: FloatArray, u: float, v: float) -> LocalWarp:
    """Return the exact homography `h` as a function of the offset from the host pixel (u, v)."""
    w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
    if w <= MIN_WARP_DEPTH:
        return LocalWarp(BEHIND, BEHIND, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    x = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w
    y = (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w
    xu = (h[0, 0] - x * h[2, 0]) / w
    xv = (h[0, 1] - x * h[2, 1]) / w
    yu = (h[1, 0] - y * h[2, 0]) / w
    yv = (h[1, 1] - y * h[2, 1]) / w
    return LocalWarp(x, y, xu, xv, yu, yv, h[2, 0] / w, h[2, 1] / w)

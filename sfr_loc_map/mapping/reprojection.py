"""From a disparity image to points in LM."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage, GreyImage, IntArray
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows


class _Columns(NamedTuple):
    """Columns of a cloud of N points, as `PointCloud` describes them."""

    xyz: NDArray[np.float32]
    sigma: NDArray[np.float32]
    intensity: NDArray[np.float32]
    u: NDArray[np.uint16]
    v: NDArray[np.uint16]


def cloud_from_disparity(
    disparity_px: FloatImage, sigma_px: FloatImage, left: GreyImage, rig: StereoRig, T_lm_left: Transform, index: int
) -> PointCloud:
    """Return the points of all pixels that have a disparity.

    `Z = fx baseline / d`; the ray of pixel (u, v) is `((u - cx) / fx, (v - cy) / fy, 1)` in the left optical frame; to
    first order the standard deviation along the ray is `|ray| Z^2 / (fx baseline) sigma_d`.

    Args:
        disparity_px: `(H, W)` float32, pixels, NaN where none.
        sigma_px: `(H, W)` float32, pixels, its standard deviation.
        left: `(H, W)` uint8.
        rig: Rig of the images.
        T_lm_left: Takes points in the left optical frame to LM.
        index: Number of the pair within its set.
    """
    ends = np.cumsum(np.isfinite(disparity_px).sum(axis=1))
    count = int(ends[-1])
    columns = _Columns(
        np.empty((count, 3), np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.uint16),
        np.empty(count, np.uint16),
    )
    pose = Pose(T_lm_left.rotation, T_lm_left.translation)
    _reproject(disparity_px, sigma_px, left, rig.camera, pose, ends, columns)
    return PointCloud(*columns, np.full(count, index, np.uint8), fused=False)


@jit_rows
def _reproject(
    disparity: FloatImage,
    deviation: FloatImage,
    left: GreyImage,
    camera: StereoCamera,
    pose: Pose,
    ends: IntArray,
    columns: _Columns,
) -> None:
    """Fill the columns of a cloud row by row; `ends` `(H,)` counts the points up to the end of each row."""
    rows, cols = disparity.shape
    rotation, position = pose.rotation, pose.position
    xyz, sigma, intensity, u, v = columns.xyz, columns.sigma, columns.intensity, columns.u, columns.v
    scale = camera.fx * camera.baseline_m
    for i in prange(rows):
        n = ends[i - 1] if i > 0 else 0
        ray_y = (i - camera.cy) / camera.fy
        for j in range(cols):
            if not np.isfinite(disparity[i, j]):
                continue
            depth = scale / np.float64(disparity[i, j])
            ray_x = (j - camera.cx) / camera.fx
            length = np.sqrt(ray_x * ray_x + ray_y * ray_y + 1.0)
            for k in range(3):
                along = rotation[k, 0] * ray_x + rotation[k, 1] * ray_y + rotation[k, 2]
                xyz[n, k] = depth * along + position[k]
            sigma[n] = length * depth * depth / scale * deviation[i, j]
            intensity[n] = left[i, j]
            u[n], v[n] = j, i
            n += 1

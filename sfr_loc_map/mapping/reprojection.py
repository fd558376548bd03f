"""From a disparity map to points in LM."""

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
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.multiview.pair_view import PairView


def view_from_disparity(
    disparity: DisparityMap, min_disparity_px: float, rig: StereoRig, T_lm_left: Transform, index: int
) -> PairView:
    """Return the points of all valid pixels that are not beyond the range of the smallest disparity."""
    is_kept = disparity.valid & (disparity.px >= min_disparity_px)
    disparity_px = np.where(is_kept, disparity.px, np.float32(np.nan))
    cloud = cloud_from_disparity(disparity_px, disparity.sigma_px, disparity.left, rig, T_lm_left, index)
    return PairView(cloud, disparity_px, T_lm_left, disparity.noise_grey)


class PointColumns(NamedTuple):
    """Columns of a cloud of N points, in the order of `PointCloud`."""

    xyz: NDArray[np.float32]  #: `(N, 3)`, metres, LM.
    sigma: NDArray[np.float32]  #: `(N,)`, standard deviation along the ray, metres.
    intensity: NDArray[np.float32]  #: `(N,)`, grey level of the left pixel.
    u: NDArray[np.uint16]  #: `(N,)`, column of the left pixel.
    v: NDArray[np.uint16]  #: `(N,)`, row of the left pixel.


def cloud_from_disparity(
    disparity_px: FloatImage,
    sigma_px: FloatImage,
    left: GreyImage | FloatImage,
    rig: StereoRig,
    T_lm_left: Transform,
    index: int,
) -> PointCloud:
    """Return the points of all pixels that have a disparity; `index` is that of the pair within its set.

    `Z = fx baseline / d`, and the ray of pixel (u, v) is `((u - cx) / fx, (v - cy) / fy, 1)` in the left optical frame.
    To first order the standard deviation along the ray is `|ray| Z^2 / (fx baseline) sigma_d`.

    The disparity `(H, W)` is NaN where it is invalid.
    """
    row_ends = np.cumsum(np.isfinite(disparity_px).sum(axis=1))
    grey = left.astype(np.float32, copy=False)
    columns = _points(disparity_px, sigma_px, grey, rig.camera, Pose.of(T_lm_left), row_ends)
    return PointCloud(*columns, np.full(row_ends[-1], index, np.uint8), fused=False)


@jit_rows
def _points(
    disparity: FloatImage, sigma_px: FloatImage, grey: FloatImage, camera: StereoCamera, pose: Pose, row_ends: IntArray
) -> PointColumns:
    """Return the columns of a cloud, filled row by row; `row_ends` `(H,)` counts the points up to the end of a row."""
    rows, cols = disparity.shape
    count = row_ends[-1]
    xyz = np.empty((count, 3), np.float32)
    sigma = np.empty(count, np.float32)
    intensity = np.empty(count, np.float32)
    u = np.empty(count, np.uint16)
    v = np.empty(count, np.uint16)
    rotation = pose.rotation
    position = pose.position
    scale = camera.fx * camera.baseline_m
    for i in prange(rows):
        n = row_ends[i - 1] if i > 0 else 0
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
            sigma[n] = length * depth * depth / scale * sigma_px[i, j]
            intensity[n] = grey[i, j]
            u[n] = j
            v[n] = i
            n += 1
    return PointColumns(xyz, sigma, intensity, u, v)

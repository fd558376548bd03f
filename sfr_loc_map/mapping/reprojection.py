"""Reprojection of disparities to points in LM."""

from __future__ import annotations

import numpy as np
from numba import prange

from sfr_loc_map.geometry.arrays import F, FloatImage, GreyImage, IntArray
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.pair_view import ViewPoints


def points_from_disparity(
    disparity_px: FloatImage, sigma_px: FloatImage, left: GreyImage | FloatImage, rig: StereoRig, T_lm_left: Transform
) -> ViewPoints:
    """Return the points of all pixels that have a disparity.

    `Z = fx baseline / d`, and the ray of pixel (u, v) is `((u - cx) / fx, (v - cy) / fy, 1)` in the left optical frame.
    To first order the standard deviation along the ray is `|ray| Z^2 / (fx baseline) sigma_d`.

    The disparity `(H, W)` is NaN where invalid.
    """
    row_ends = np.cumsum(np.isfinite(disparity_px).sum(axis=1))
    grey = left.astype(F, copy=False)
    return _points(disparity_px, sigma_px, grey, rig.camera, Pose.of(T_lm_left), row_ends)


@jit_rows
def _points(
    disparity: FloatImage, sigma_px: FloatImage, grey: FloatImage, camera: StereoCamera, pose: Pose, row_ends: IntArray
) -> ViewPoints:
    """Return the points row by row; `row_ends` `(H,)` is the number of points up to the end of each row."""
    rows, cols = disparity.shape
    count = row_ends[-1]
    xyz = np.empty((count, 3), F)
    sigma = np.empty(count, F)
    intensity = np.empty(count, F)
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
    return ViewPoints(xyz, sigma, intensity, u, v)

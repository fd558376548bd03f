"""From disparities to points in LM."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows


def cloud_from_disparity(
    disparity_px: FloatImage, sigma_px: FloatImage, left: GreyImage, rig: StereoRig, T_lm_navsb: Transform, index: int
) -> PointCloud:
    """Return the points of all pixels that have a disparity.

    `Z = fx baseline / d`; the ray of pixel (u, v) is `((u - cx) / fx, (v - cy) / fy, 1)` in the left optical frame; to
    first order the standard deviation along the ray is `|ray| Z^2 / (fx baseline) sigma_d`.

    Args:
        disparity_px: `(H, W)` float32, pixels, NaN where none.
        sigma_px: `(H, W)` float32, pixels, its standard deviation.
        left: `(H, W)` uint8.
        rig: Rig of the pictures.
        T_lm_navsb: Takes points in NAVSB to LM.
        index: Number of the pair within its set.
    """
    T_lm_left = T_lm_navsb @ rig.T_sb_left
    camera = np.array([rig.fx, rig.fy, rig.cx, rig.cy, rig.fx * rig.baseline_m])
    ends = np.cumsum(np.isfinite(disparity_px).sum(axis=1))
    count = int(ends[-1])
    xyz, sigma, intensity = np.empty((count, 3), np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    u, v = np.empty(count, np.uint16), np.empty(count, np.uint16)
    fields = (xyz, sigma, intensity, u, v)
    _fill(disparity_px, sigma_px, left, camera, T_lm_left.rotation, T_lm_left.translation, ends, *fields)
    return PointCloud(xyz, sigma, intensity, u, v, np.full(count, index, np.uint8))


@jit_rows
def _fill(
    disparity: FloatImage,
    deviation: FloatImage,
    left: GreyImage,
    camera: FloatArray,
    rotation: FloatArray,
    translation: FloatArray,
    ends: NDArray[np.int64],
    xyz: FloatImage,
    sigma: FloatImage,
    intensity: FloatImage,
    u: NDArray[np.uint16],
    v: NDArray[np.uint16],
) -> None:
    """Fill the fields of a cloud row by row; `ends` `(H,)` counts the points up to the end of each row."""
    rows, cols = disparity.shape
    fx, fy, cx, cy, scale = camera
    for i in prange(rows):
        n = ends[i - 1] if i > 0 else 0
        ray_y = (i - cy) / fy
        for j in range(cols):
            if not np.isfinite(disparity[i, j]):
                continue
            depth = scale / np.float64(disparity[i, j])
            ray_x = (j - cx) / fx
            length = np.sqrt(ray_x * ray_x + ray_y * ray_y + 1.0)
            for k in range(3):
                along = rotation[k, 0] * ray_x + rotation[k, 1] * ray_y + rotation[k, 2]
                xyz[n, k] = depth * along + translation[k]
            sigma[n] = length * depth * depth / scale * deviation[i, j]
            intensity[n] = left[i, j]
            u[n], v[n] = j, i
            n += 1

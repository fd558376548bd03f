"""From disparities to points in LM."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import GreyImage, StereoRig
from sfr_loc_map.geometry.transform import Transform

FloatImage = NDArray[np.float32]


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
    v, u = np.nonzero(np.isfinite(disparity_px))
    disparity = disparity_px[v, u].astype(np.float64)
    scale = rig.fx * rig.baseline_m
    depth = scale / disparity
    T_lm_left = T_lm_navsb @ rig.T_sb_left
    rays = np.column_stack(((u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy, np.ones(len(u))))
    xyz = T_lm_left.apply(rays * depth[:, None])
    length = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    sigma = length * depth * depth / scale * sigma_px[v, u]
    return PointCloud(
        xyz.astype(np.float32),
        sigma.astype(np.float32),
        left[v, u].astype(np.float32),
        u.astype(np.uint16),
        v.astype(np.uint16),
        np.full(len(u), index, np.uint8),
    )

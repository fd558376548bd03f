"""A textured wall in front of a camera, rendered from any pose."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose, StereoCamera


def wall_view(texture: np.ndarray, camera: StereoCamera, depth_m: float, pose: Pose) -> FloatArray:
    """Return the image `(H, W)` at a pose of the left camera; the texture is the image at the origin."""
    height, width = texture.shape
    v, u = np.mgrid[0:height, 0:width]
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(float)
    rays = np.column_stack((camera.normalised(pixels), np.ones(len(pixels)))) @ pose.rotation.T
    points = pose.position + rays * ((depth_m - pose.position[2]) / rays[:, 2])[:, None]
    x = camera.fx * points[:, 0] / depth_m + camera.cx
    y = camera.fy * points[:, 1] / depth_m + camera.cy
    return np.asarray(map_coordinates(texture, [y, x], order=3, mode="nearest").reshape(height, width))

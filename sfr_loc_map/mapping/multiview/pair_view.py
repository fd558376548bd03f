"""One stereo pair as registration and fusion see it, and what it says of the points of another pair."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatImage
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32

FEATHER_PX = 48.0  #: Distance from the border of an image from which on its points have full weight.
JUMP_PX = F(1.0)  #: Nothing is interpolated between disparities that differ by this or more.
SHIFT_PX = 8
"""Grey levels are compared with those so far away along both axes as well: what a wrong pose would show."""
MIN_DEPTH_M = 1e-3


class ViewImages(NamedTuple):
    """What a view holds at each pixel, `(H, W)` float32 each."""

    disparity: FloatImage  # pixels, NaN where none
    weight: FloatImage  # 1 / m^2, 0 where there is no point
    grey: FloatImage  # grey level, NaN where there is no point


@dataclass(frozen=True, eq=False)
class PairView:
    """Points of one stereo pair with the disparity image and the pose that they come from."""

    cloud: PointCloud  #: Its points in LM.
    disparity_px: FloatImage  #: `(H, W)` float32, pixels, NaN where none.
    T_lm_left: Transform  #: Takes points in its left optical frame to LM.
    noise_grey: float  #: Standard deviation of the difference of two images of the same ground, grey levels.

    def with_pose(self, T_lm_left: Transform) -> PairView:
        """Return the view at another pose, its points moved along."""
        xyz = (T_lm_left @ self.T_lm_left.inverse()).apply(self.cloud.xyz).astype(F)
        return replace(self, cloud=replace(self.cloud, xyz=xyz), T_lm_left=T_lm_left)

    def numbered(self, number: int) -> PairView:
        """Return the view as that of a pair of another number."""
        return replace(self, cloud=replace(self.cloud, pair=np.full(len(self.cloud), number, np.uint8)))

    @cached_property
    def images(self) -> ViewImages:
        """What is known of each pixel.

        The weight is `feather / sigma^2`: it decreases towards the border, so that no seam shows where the image ends.
        """
        height, width = self.disparity_px.shape
        sigma = np.full((height, width), np.inf, F)
        sigma[self.cloud.v, self.cloud.u] = self.cloud.sigma
        y, x = np.arange(height, dtype=F), np.arange(width, dtype=F)
        edge_y, edge_x = np.minimum(y, height - 1 - y) + F(1.0), np.minimum(x, width - 1 - x) + F(1.0)
        feather = np.minimum(np.minimum(edge_y[:, None], edge_x[None]) / F(FEATHER_PX), F(1.0))
        return ViewImages(self.disparity_px, np.asarray(feather / np.square(sigma), F), self.grey_image())

    def grey_image(self, blur_px: float = 0.0) -> FloatImage:
        """Return the left image `(H, W)` where there are points, smoothed over these by a Gaussian; NaN elsewhere."""
        known = np.zeros(self.disparity_px.shape, F)
        grey = np.zeros_like(known)
        known[self.cloud.v, self.cloud.u] = 1.0
        grey[self.cloud.v, self.cloud.u] = self.cloud.intensity
        if blur_px > 0.0:
            total, share = (cv2.GaussianBlur(image, (0, 0), blur_px) for image in (grey, known))
            grey = np.asarray(total / np.maximum(share, F(1e-3)), F)
        grey[known == 0.0] = np.nan
        return grey


@dataclass(frozen=True, slots=True, eq=False)
class ReprojectedPoints:
    """What another view says of the M points that it sees too, `(M,)` float32 each."""

    index: NDArray[np.intp]  #: Numbers of the points in their cloud.
    difference: FloatImage  #: How much farther along the view's ray it sees them, metres.
    deviation: FloatImage  #: Standard deviation of its range, metres.
    weight: FloatImage  #: Its weight, 1 / m^2.
    grey_difference: FloatImage  #: Its grey level minus the point's; NaN where it has no point.
    grey_difference_shifted: FloatImage  #: The same at `SHIFT_PX` to the right and below.
    offset_px: FloatImage  #: Distance from its nearest sample.


def reproject_into_view(
    cloud: PointCloud, T_lm_left: Transform, images: ViewImages, rig: StereoRig
) -> ReprojectedPoints:
    """Return what a view, whose left camera has a pose, says of the points in LM that it sees too."""
    samples = _sample_view(cloud.xyz, Pose.of(T_lm_left.inverse()), rig.camera, images)
    index = np.flatnonzero(np.isfinite(samples[0]))
    difference, weight, grey, grey_shifted, offset_px = (values[index] for values in samples)
    own = cloud.intensity[index]
    deviation = np.asarray(F(1.0) / np.sqrt(weight), F)
    return ReprojectedPoints(index, difference, deviation, weight, grey - own, grey_shifted - own, offset_px)


@jit_rows_inline
def _bilinear(image: FloatImage, i: int, j: int, t: float, s: float) -> float:
    """Interpolate at row `i + t` and column `j + s`, t and s from 0 to 1."""
    upper = (1 - s) * image[i, j] + s * image[i, j + 1]
    lower = (1 - s) * image[i + 1, j] + s * image[i + 1, j + 1]
    value: float = (1 - t) * upper + t * lower
    return value


@jit_rows
def _sample_view(xyz: FloatImage, to_left: Pose, camera: StereoCamera, images: ViewImages) -> FloatImage:
    """Return difference, weight, grey level, shifted one and offset `(5, N)` of the points `(N, 3)` that a view sees.

    The difference is NaN where it sees none, the shifted grey level beyond the border.
    """
    rows, cols = images.disparity.shape
    rotation, translation = to_left.rotation, to_left.position
    out = np.empty((5, len(xyz)), F)
    out[0], out[3] = F(np.nan), F(np.nan)
    scale = camera.fx * camera.baseline_m
    for n in prange(len(xyz)):
        x0, y0, z0 = np.float64(xyz[n, 0]), np.float64(xyz[n, 1]), np.float64(xyz[n, 2])
        xl = rotation[0, 0] * x0 + rotation[0, 1] * y0 + rotation[0, 2] * z0 + translation[0]
        yl = rotation[1, 0] * x0 + rotation[1, 1] * y0 + rotation[1, 2] * z0 + translation[1]
        zl = rotation[2, 0] * x0 + rotation[2, 1] * y0 + rotation[2, 2] * z0 + translation[2]
        if zl < MIN_DEPTH_M:
            continue
        u, v = camera.fx * xl / zl + camera.cx, camera.fy * yl / zl + camera.cy
        if not (u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1):  # four pixels around
            continue
        j, i = int(u), int(v)
        s, t = u - j, v - i
        y, x = i + int(t > 0.5), j + int(s > 0.5)
        upper, lower, weight = images.disparity[i], images.disparity[i + 1], images.weight[y, x]
        nearest = max(max(upper[j], upper[j + 1]), max(lower[j], lower[j + 1]))
        farthest = min(min(upper[j], upper[j + 1]), min(lower[j], lower[j + 1]))
        found = _bilinear(images.disparity, i, j, t, s)
        if not (nearest - farthest < JUMP_PX and found > 0.0 and weight > 0.0):
            continue
        length = np.sqrt(xl * xl + yl * yl + zl * zl) / zl
        out[0, n] = (scale / found - zl) * length
        out[1, n] = weight
        out[2, n] = _bilinear(images.grey, i, j, t, s)
        if y + SHIFT_PX < rows and x + SHIFT_PX < cols:
            out[3, n] = images.grey[y + SHIFT_PX, x + SHIFT_PX]
        out[4, n] = np.sqrt((v - y) * (v - y) + (u - x) * (u - x))
    return out

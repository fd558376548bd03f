"""The view of one stereo pair: its points in LM, the same points as images, and its pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, FloatImage, GreyImage, IntArray, Mask, read_only
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.estimation import DisparityMap
from sfr_loc_map.mapping.disparity.validity.saturation import Saturation


def read_only_pose(pose: Transform) -> Transform:
    """Return a transform whose rotation and translation cannot be changed."""
    return Transform(read_only(pose.rotation), read_only(pose.translation))


class ViewPoints(NamedTuple):
    """N points, each on the ray of a pixel of the left image. Their total sigma is computed by `point_sigma`."""

    xyz: FloatArray32  #: `(N, 3)`, metres, LM.
    #: `(N,)`, metres, standard deviation along the ray, by which points are compared and fused. It does not include
    #: saturation and calibration (`point_sigma`).
    fusion_sigma: FloatArray32
    intensity: FloatArray32  #: `(N,)`, grey level of the left pixel.
    u: NDArray[np.uint16]  #: `(N,)`, column of the left pixel.
    v: NDArray[np.uint16]  #: `(N,)`, row of the left pixel.

    @property
    def size(self) -> int:
        """The number of points."""
        return len(self.xyz)

    def select(self, which: Mask | NDArray[np.intp]) -> ViewPoints:
        """Return the points that a mask or indices select."""
        rows = np.flatnonzero(which) if which.dtype == np.bool_ else which
        return ViewPoints._make(values.take(rows, axis=0) for values in self)

    @classmethod
    def concatenated(cls, parts: Sequence[ViewPoints]) -> ViewPoints:
        """Return the points of all parts."""
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def split(self, sizes: Sequence[int]) -> Iterator[ViewPoints]:
        """Yield the parts of concatenated points, given the number of points of each part; the memory is shared."""
        end = 0
        for size in sizes:
            start, end = end, end + size
            yield ViewPoints._make(values[start:end] for values in self)

    def to_cloud(
        self,
        sigma: FloatArray32,
        pair_index: NDArray[np.uint8],
        *,
        fused: bool,
        pair_stamps_ns: tuple[int, ...] | None = None,
    ) -> PointCloud:
        """Return the points as a cloud with the standard deviation and the pair index of each point `(N,)`.

        The arrays of the cloud are read-only views of the arrays of the points.
        """
        return PointCloud(
            xyz=read_only(self.xyz),
            sigma=read_only(sigma),
            intensity=read_only(self.intensity),
            u=read_only(self.u),
            v=read_only(self.v),
            pair=read_only(pair_index),
            fused=fused,
            pair_stamps_ns=pair_stamps_ns,
        )


class ViewImages(NamedTuple):
    """Images of a view, `(H, W)` float32 each, in which other views observe their points."""

    disparity: FloatImage  #: Pixels; NaN where invalid.
    fusion_sigma: FloatImage  #: `ViewPoints.fusion_sigma`, metres; infinite at pixels without a point.
    grey: FloatImage  #: Grey level; NaN at pixels without a point.


@dataclass(frozen=True, slots=True, eq=False)
class PairView:
    """Data of one stereo pair for registration and fusion: points, images, pose, noise and saturation."""

    points: ViewPoints
    images: ViewImages  #: The same points as images.
    T_lm_left: Transform  #: Transforms points from the left optical frame to LM. Its arrays are read-only.
    noise_grey: float  #: Standard deviation of a photometric residual, grey levels.
    saturation: Saturation  #: Saturated pixels, which increase the sigma of points.

    def with_pose(self, T_lm_left: Transform) -> PairView:
        """Return the view with its points moved to another pose."""
        xyz = (T_lm_left @ self.T_lm_left.inverse()).apply(self.points.xyz).astype(F)
        return replace(self, points=self.points._replace(xyz=xyz), T_lm_left=read_only_pose(T_lm_left))


def reproject(disparity: DisparityMap, rig: StereoRig, T_lm_left: Transform) -> PairView:
    """Return the view of a pair, given its disparity map and the pose of its left camera."""
    points, images = reproject_pixels(disparity.px, disparity.sigma_px, disparity.left, rig, T_lm_left)
    return PairView(points, images, read_only_pose(T_lm_left), disparity.noise_grey, disparity.saturation)


def reproject_pixels(
    disparity_px: FloatImage, sigma_px: FloatImage, left: GreyImage | FloatImage, rig: StereoRig, T_lm_left: Transform
) -> tuple[ViewPoints, ViewImages]:
    """Return the points of all pixels that have a disparity, and the same points as images.

    `Z = fx baseline / d`, and the ray of pixel (u, v) is `((u - cx) / fx, (v - cy) / fy, 1)` in the left optical frame.
    To first order the standard deviation along the ray is `|ray| Z^2 / (fx baseline) sigma_d`.

    The disparity `(H, W)` is NaN where invalid.
    """
    row_ends = np.cumsum(np.count_nonzero(np.isfinite(disparity_px), axis=1))
    grey = left.astype(F, copy=False)
    return _reproject(disparity_px, sigma_px, grey, rig.camera, Pose.of(T_lm_left), row_ends)


@jit_rows
def _reproject(
    disparity: FloatImage, sigma_px: FloatImage, left: FloatImage, camera: StereoCamera, pose: Pose, row_ends: IntArray
) -> tuple[ViewPoints, ViewImages]:
    """Return points row by row, and images; `row_ends` `(H,)` is the number of points up to the end of each row."""
    rows, cols = disparity.shape
    count = row_ends[-1]
    xyz = np.empty((count, 3), F)
    sigma = np.empty(count, F)
    intensity = np.empty(count, F)
    u = np.empty(count, np.uint16)
    v = np.empty(count, np.uint16)
    sigma_image = np.full((rows, cols), F(np.inf))
    grey_image = np.full((rows, cols), F(np.nan))
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
            intensity[n] = left[i, j]
            u[n] = j
            v[n] = i
            sigma_image[i, j] = sigma[n]
            grey_image[i, j] = left[i, j]
            n += 1
    return ViewPoints(xyz, sigma, intensity, u, v), ViewImages(disparity, sigma_image, grey_image)

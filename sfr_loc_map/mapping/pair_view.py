"""The points of one stereo pair with their disparity image and pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, FloatImage, Mask, read_only
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows
from sfr_loc_map.mapping.disparity.saturation import Saturation


def read_only_pose(pose: Transform) -> Transform:
    """Return a transform whose rotation and translation cannot be changed."""
    return Transform(read_only(pose.rotation), read_only(pose.translation))


class ViewPoints(NamedTuple):
    """N points, each on the ray of its left pixel, without their total sigma."""

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
    """Images of a view, `(H, W)` float32 each."""

    disparity: FloatImage  #: Pixels; NaN where invalid.
    fusion_sigma: FloatImage  #: `ViewPoints.fusion_sigma`, metres; infinite at pixels without a point.
    grey: FloatImage  #: Grey level; NaN at pixels without a point.


@dataclass(frozen=True, slots=True, eq=False)
class PairView:
    """Data of one stereo pair for registration and fusion: points, images, pose, noise and saturation."""

    points: ViewPoints
    images: ViewImages  #: The disparities, and the sigmas and grey levels of the points at their pixels.
    T_lm_left: Transform  #: Transforms points from the left optical frame to LM. Its arrays are read-only.
    noise_grey: float  #: Standard deviation of a photometric residual, grey levels.
    saturation: Saturation  #: Saturated pixels, which increase the sigma of points.

    @classmethod
    def of(
        cls,
        points: ViewPoints,
        disparity_px: FloatImage,
        T_lm_left: Transform,
        noise_grey: float,
        saturation: Saturation,
    ) -> PairView:
        """Return the view of points and of their disparity image `(H, W)`, NaN where invalid."""
        images = _images_of_points(points, disparity_px)
        return cls(points, images, read_only_pose(T_lm_left), noise_grey, saturation)

    def with_pose(self, T_lm_left: Transform) -> PairView:
        """Return the view with its points moved to another pose."""
        xyz = (T_lm_left @ self.T_lm_left.inverse()).apply(self.points.xyz).astype(F)
        return replace(self, points=self.points._replace(xyz=xyz), T_lm_left=read_only_pose(T_lm_left))


@jit_rows
def _images_of_points(points: ViewPoints, disparity_px: FloatImage) -> ViewImages:
    """Return the images of a view; at most one point per pixel."""
    fusion_sigma = np.full_like(disparity_px, F(np.inf))
    grey = np.full_like(disparity_px, F(np.nan))
    for n in prange(len(points.u)):
        fusion_sigma[points.v[n], points.u[n]] = points.fusion_sigma[n]
        grey[points.v[n], points.u[n]] = points.intensity[n]
    return ViewImages(disparity_px, fusion_sigma, grey)

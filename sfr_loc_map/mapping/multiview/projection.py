"""Observations of a view at the points of another view, and the weights of points in the fusion.

A point is observed if its projection is between four pixels with disparities that are on one surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import F, FloatArray32, FloatImage
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows, jit_rows_inline
from sfr_loc_map.mapping.disparity.surfaces import SURFACE_JUMP_PX
from sfr_loc_map.mapping.pair_view import PairView, ViewImages

FEATHER_PX = 48.0  #: Distance from the image border beyond which points have their full weight, pixels.
SHIFT_PX = 8  #: Offset along both axes at which grey levels are also compared, pixels.
MIN_OVERLAP = 1000  #: Minimum number of common points for judging poses.
MIN_DEPTH_M = 1e-3  #: Minimum depth of a projected point, metres: points behind the camera are ignored.


class Observations(NamedTuple):
    """Observations of the N points of a view by another view, the observing view; `(N,)` each.

    At points that the observing view does not observe, the differences and grey levels are NaN, and the other values
    are 0.
    """

    #: Observed range minus the range of the point, along the ray of the observing view, metres.
    difference: FloatArray32
    point_range: FloatArray32  #: Range of the point from the camera of the observing view, metres.
    fusion_sigma: FloatArray32  #: Standard deviation of the observed range along the same ray, metres.
    weight: FloatArray32  #: Weight of the observing view in the fusion, 1 / m^2.
    grey: FloatArray32  #: Grey level of the observing view at the projected point.
    #: Grey level of the observing view `SHIFT_PX` to the right of and below the nearest pixel; NaN if the shifted pixel
    #: has no point or is outside the image.
    grey_shifted: FloatArray32
    sample_distance_px: FloatArray32  #: Distance of the projected point from the nearest pixel, pixels.

    @property
    def indices(self) -> NDArray[np.intp]:
        """The indices of the observed points."""
        return np.flatnonzero(np.isfinite(self.difference))

    def difference_sigma(self, fusion_sigma: FloatArray32) -> FloatArray32:
        """Return the standard deviation of the range differences `(N,)`, metres, given the sigma of the points `(N,)`.

        The sigma of a point is along the ray of its own view, as if both cameras were at the same position (`fusion`).
        """
        return np.asarray(np.sqrt(np.square(fusion_sigma) + np.square(self.fusion_sigma)))

    def select(self, indices: NDArray[np.intp]) -> Observations:
        """Return the observations of the points with the given indices."""
        return Observations._make(values.take(indices, axis=0) for values in self)


def project_into_view(xyz: FloatArray32, T_lm_left: Transform, images: ViewImages, rig: StereoRig) -> Observations:
    """Return the observations of points `(N, 3)` in LM by a view whose left camera has the pose `T_lm_left`."""
    return _observe(xyz, Pose.of(T_lm_left.inverse()), rig.camera, images)


def point_weights(view: PairView) -> FloatArray32:
    """Return the weight of each point of a view in the fusion `(N,)`, 1 / m^2."""
    rows, columns = view.images.disparity.shape
    points = view.points
    return _point_weights(points.fusion_sigma, points.u, points.v, rows, columns)


@jit_rows_inline
def _weight(sigma: np.float32, row: int, column: int, rows: int, columns: int) -> np.float32:
    """Return the weight `feather / sigma^2` of a pixel in the fusion, 1 / m^2.

    The feather decreases towards the image border, so that the fused surface has no seam there.
    """
    border_distance = min(min(row, rows - 1 - row), min(column, columns - 1 - column)) + 1
    feather = min(F(border_distance) / F(FEATHER_PX), F(1.0))
    weight: np.float32 = feather / (sigma * sigma)
    return weight


@jit_rows
def _point_weights(
    sigma: FloatArray32, u: NDArray[np.uint16], v: NDArray[np.uint16], rows: int, columns: int
) -> FloatArray32:
    """Return the weights of points `(N,)` from their sigma and pixels."""
    weights = np.empty_like(sigma)
    for n in prange(len(sigma)):
        weights[n] = _weight(sigma[n], int(v[n]), int(u[n]), rows, columns)
    return weights


class PixelPosition(NamedTuple):
    """A position between four pixels of an image."""

    row: int  #: Row of the upper pixels.
    column: int  #: Column of the left pixels.
    below: float  #: Distance from the upper pixels, 0 to 1.
    right: float  #: Distance from the left pixels, 0 to 1.
    nearest_row: int
    nearest_column: int
    distance_px: float  #: Distance from the nearest pixel.


@jit_rows_inline
def _pixel_position(u: float, v: float) -> PixelPosition:
    """Return the position of column u and row v, which are not negative."""
    row = int(v)
    column = int(u)
    below = v - row
    right = u - column
    nearest_row = row + int(below > 0.5)
    nearest_column = column + int(right > 0.5)
    row_offset = v - nearest_row
    column_offset = u - nearest_column
    distance_px = np.sqrt(row_offset * row_offset + column_offset * column_offset)
    return PixelPosition(row, column, below, right, nearest_row, nearest_column, distance_px)


@jit_rows_inline
def _bilinear(image: FloatImage, at: PixelPosition) -> float:
    """Return the image at a position, interpolated bilinearly; NaN if one of the four pixels is NaN."""
    upper = (1 - at.right) * image[at.row, at.column] + at.right * image[at.row, at.column + 1]
    lower = (1 - at.right) * image[at.row + 1, at.column] + at.right * image[at.row + 1, at.column + 1]
    value: float = (1 - at.below) * upper + at.below * lower
    return value


@jit_rows_inline
def _is_one_surface(disparity: FloatImage, at: PixelPosition) -> bool:
    """Return whether the four pixels around a position are on one surface."""
    upper = disparity[at.row]
    lower = disparity[at.row + 1]
    j = at.column
    largest = max(max(upper[j], upper[j + 1]), max(lower[j], lower[j + 1]))
    smallest = min(min(upper[j], upper[j + 1]), min(lower[j], lower[j + 1]))
    return bool(largest - smallest < SURFACE_JUMP_PX)


@jit_rows
def _observe(xyz: FloatArray32, T_left_lm: Pose, camera: StereoCamera, images: ViewImages) -> Observations:
    """Return the observations of points `(N, 3)` in LM."""
    rows, cols = images.disparity.shape
    rotation = T_left_lm.rotation
    translation = T_left_lm.position
    count = len(xyz)
    difference = np.full(count, F(np.nan))
    point_range = np.zeros(count, F)
    fusion_sigma = np.zeros(count, F)
    weight = np.zeros(count, F)
    grey = np.full(count, F(np.nan))
    grey_shifted = np.full(count, F(np.nan))
    sample_distance_px = np.zeros(count, F)
    scale = camera.fx * camera.baseline_m
    for n in prange(count):
        x0 = np.float64(xyz[n, 0])
        y0 = np.float64(xyz[n, 1])
        z0 = np.float64(xyz[n, 2])
        x = rotation[0, 0] * x0 + rotation[0, 1] * y0 + rotation[0, 2] * z0 + translation[0]
        y = rotation[1, 0] * x0 + rotation[1, 1] * y0 + rotation[1, 2] * z0 + translation[1]
        z = rotation[2, 0] * x0 + rotation[2, 1] * y0 + rotation[2, 2] * z0 + translation[2]
        if z < MIN_DEPTH_M:
            continue
        u = camera.fx * x / z + camera.cx
        v = camera.fy * y / z + camera.cy
        has_four_pixels = u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1
        if not has_four_pixels:
            continue
        at = _pixel_position(u, v)
        disparity = _bilinear(images.disparity, at)
        have_points = disparity > 0.0  # false if one of the four disparities is NaN
        if not (_is_one_surface(images.disparity, at) and have_points):
            continue
        distance = np.sqrt(x * x + y * y + z * z)
        sigma = images.fusion_sigma[at.nearest_row, at.nearest_column]
        difference[n] = (scale / disparity - z) * (distance / z)
        point_range[n] = distance
        fusion_sigma[n] = sigma
        weight[n] = _weight(sigma, at.nearest_row, at.nearest_column, rows, cols)
        grey[n] = _bilinear(images.grey, at)
        if at.nearest_row + SHIFT_PX < rows and at.nearest_column + SHIFT_PX < cols:
            grey_shifted[n] = images.grey[at.nearest_row + SHIFT_PX, at.nearest_column + SHIFT_PX]
        sample_distance_px[n] = at.distance_px
    return Observations(difference, point_range, fusion_sigma, weight, grey, grey_shifted, sample_distance_px)

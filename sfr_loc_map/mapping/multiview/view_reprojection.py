"""Points of one stereo pair reprojected into another: where it sees them, how far, how sharp and how bright."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.jit import jit_rows, jit_rows_inline

F = np.float32

JUMP_PX = F(1.0)
"""Nothing is interpolated between disparities that differ by this or more."""
SHIFT_PX = 8
"""Grey levels are compared with those so far away along both axes as well: what a wrong pose would show."""
MIN_DEPTH_M = 1e-3


class ViewImages(NamedTuple):
    """What a view holds at each pixel, `(H, W)` float32 each.

    Attributes:
        disparity: Pixels, NaN where none.
        weight: 1 / m^2, 0 where there is no point.
        grey: Grey level, NaN where there is no point.
    """

    disparity: FloatImage
    weight: FloatImage
    grey: FloatImage


class _Samples(NamedTuple):
    """What a view says of N points, `(N,)` float32 each, as `ReprojectedPoints` describes them.

    `difference` is NaN where it says nothing; the others are then undefined.
    """

    difference: FloatImage
    weight: FloatImage
    grey: FloatImage
    grey_shifted: FloatImage
    offset_px: FloatImage

    @classmethod
    def nothing(cls, count: int) -> _Samples:
        """Return those of points that are not seen."""
        weight, grey, offset_px = (np.empty(count, F) for _ in range(3))
        return cls(np.full(count, np.nan, F), weight, grey, np.full(count, np.nan, F), offset_px)


@dataclass(frozen=True, slots=True, eq=False)
class ReprojectedPoints:
    """What another view says of the M points that it sees too, `(M,)` float32 each.

    Attributes:
        index: `(M,)`, numbers of the points in their cloud.
        difference: How much farther along the view's ray it sees them, metres.
        deviation: Standard deviation of its range, metres.
        weight: Its weight, 1 / m^2.
        grey_difference: Its grey level minus the point's; NaN where it has no point.
        grey_difference_shifted: The same at `SHIFT_PX` to the right and below.
        offset_px: Distance from its nearest sample.
    """

    index: NDArray[np.intp]
    difference: FloatImage
    deviation: FloatImage
    weight: FloatImage
    grey_difference: FloatImage
    grey_difference_shifted: FloatImage
    offset_px: FloatImage


def reproject_into_view(
    cloud: PointCloud, T_lm_left: Transform, images: ViewImages, rig: StereoRig
) -> ReprojectedPoints:
    """Return what another view says of the points that it sees too.

    Args:
        cloud: Points in LM.
        T_lm_left: Pose of the view's left camera.
        images: Of the view.
        rig: Rig of all pairs.
    """
    T_left_lm = T_lm_left.inverse()
    samples = _Samples.nothing(len(cloud))
    _sample_view(cloud.xyz, T_left_lm.rotation, T_left_lm.translation, rig.camera, images, samples)
    index = np.flatnonzero(np.isfinite(samples.difference))
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


@jit_rows_inline
def _is_inside(u: float, v: float, rows: int, cols: int) -> bool:
    """Tell whether there are four pixels around a point of the image."""
    return u >= 0 and v >= 0 and u < cols - 1 and v < rows - 1


@jit_rows_inline
def _is_smooth(disparity: FloatImage, i: int, j: int) -> bool:
    """Tell whether the four pixels from (i, j) on belong to one surface."""
    a, b, c, d = disparity[i, j], disparity[i, j + 1], disparity[i + 1, j], disparity[i + 1, j + 1]
    smooth: bool = max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < JUMP_PX
    return smooth


@jit_rows
def _sample_view(
    xyz: FloatImage,
    rotation: FloatArray,
    translation: FloatArray,
    camera: StereoCamera,
    images: ViewImages,
    out: _Samples,
) -> None:
    """Fill `out` where the view sees the points `(N, 3)`; rotation and translation take them to its left camera."""
    rows, cols = images.disparity.shape
    difference, out_weight, out_offset = out.difference, out.weight, out.offset_px
    out_grey, out_shifted = out.grey, out.grey_shifted
    scale = camera.fx * camera.baseline_m
    for n in prange(len(xyz)):
        x0, y0, z0 = np.float64(xyz[n, 0]), np.float64(xyz[n, 1]), np.float64(xyz[n, 2])
        xl = rotation[0, 0] * x0 + rotation[0, 1] * y0 + rotation[0, 2] * z0 + translation[0]
        yl = rotation[1, 0] * x0 + rotation[1, 1] * y0 + rotation[1, 2] * z0 + translation[1]
        zl = rotation[2, 0] * x0 + rotation[2, 1] * y0 + rotation[2, 2] * z0 + translation[2]
        if zl < MIN_DEPTH_M:
            continue
        u, v = camera.fx * xl / zl + camera.cx, camera.fy * yl / zl + camera.cy
        if not _is_inside(u, v, rows, cols):
            continue
        j, i = int(u), int(v)
        s, t = u - j, v - i
        y, x = i + int(t > 0.5), j + int(s > 0.5)
        found, weight = _bilinear(images.disparity, i, j, t, s), images.weight[y, x]
        if not (_is_smooth(images.disparity, i, j) and found > 0.0 and weight > 0.0):
            continue
        length = np.sqrt(xl * xl + yl * yl + zl * zl) / zl
        difference[n] = (scale / found - zl) * length
        out_weight[n] = weight
        out_grey[n] = _bilinear(images.grey, i, j, t, s)
        if y + SHIFT_PX < rows and x + SHIFT_PX < cols:
            out_shifted[n] = images.grey[y + SHIFT_PX, x + SHIFT_PX]
        out_offset[n] = np.sqrt((v - y) * (v - y) + (u - x) * (u - x))
